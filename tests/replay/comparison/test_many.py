"""Several logs, or several robot files, scored together."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import icreckon
from icreckon import Comparison, Drift, Log, summarise
from icreckon.replay.comparison.bootstrap import PairedDrift, matched_drifts, pooled_drift
from icreckon.replay.comparison.many import Case, compare_many, label_of, unique

SECOND = 10**9
ROBOT = icreckon.load_robot("auriga-alpha")
VARIANTS = ("gyro", "constant-online")


def drive(seed: int, seconds: float = 80.0) -> Log:
    """A simulated log without fixes."""
    scenario = icreckon.Scenario(duration=seconds, seed=seed, outages=((0.0, seconds),))
    return replace(icreckon.simulate(scenario, ROBOT), name=f"drive {seed}")


@pytest.fixture(scope="module")
def logs() -> list[Log]:
    return [drive(1), drive(2, 60.0)]


def paired(errors: np.ndarray, block: int = 20, names: tuple[str, ...] = ("a",)) -> PairedDrift:
    rows = np.atleast_2d(errors)
    return PairedDrift(names, rows, np.ones(rows.shape[1]), block)


# --- intervals over several logs ---------------------------------------------------------------------


def test_errors_and_distances_are_summed_over_the_logs() -> None:
    one = paired(np.random.default_rng(1).random(300))
    assert pooled_drift([one]).percent("a") == one.percent("a")
    long, short = paired(np.full(300, 1.0)), paired(np.full(100, 3.0))
    assert pooled_drift([long, short]).percent("a").value == pytest.approx(150.0)


def test_logs_that_differ_make_the_interval_wider() -> None:
    one, other = paired(np.full(300, 1.0)), paired(np.full(300, 3.0))
    for alone in (one, other):
        low, high = alone.percent("a").interval
        assert high - low == pytest.approx(0.0, abs=1e-9)
    low, high = pooled_drift([one, other]).percent("a").interval
    assert low < 180.0 < 220.0 < high


def test_a_log_shorter_than_a_block_counts_by_its_length() -> None:
    # Of each draw the short log has its share of the segments, whichever way it is cut.
    long, short = paired(np.full(95, 1.0), block=20), paired(np.full(5, 1.0), block=20)
    marked = paired(np.full(5, 21.0), block=20)
    value, interval = pooled_drift([long, marked]).percent("a")
    assert value == pytest.approx(200.0)
    assert interval[0] == pytest.approx(100.0)
    assert pooled_drift([long, short]).percent("a").interval == pytest.approx((100.0, 100.0))


@pytest.mark.parametrize(("logs", "spread"), [(12, 0.4), (2, 0.8)])
def test_pooled_intervals_cover_the_drift_of_these_logs(logs: int, spread: float) -> None:
    """Drawn are errors with a correlation in time, of logs whose own drift is given."""
    rng = np.random.default_rng(5)
    runs, inside, horizon, count = 200, 0, 10, 120
    for _ in range(runs):
        parts = []
        sizes = np.exp(spread * rng.normal(size=logs) - 0.5 * spread**2)
        for size in sizes:
            steps = np.cumsum(rng.normal(size=(2, count + horizon + 1)), axis=1)
            errors = np.hypot(*(steps[:, horizon : horizon + count] - steps[:, :count]))
            parts.append(paired(size * errors / math.sqrt(horizon)))
        low, high = pooled_drift(parts).percent("a").interval
        inside += low <= 100.0 * math.sqrt(math.pi / 2.0) * sizes.mean() <= high
    # Blocks of one log have 93 %; four standard deviations of 200 draws are 7 %.
    assert inside / runs >= 0.86


def test_a_short_log_with_long_blocks_does_not_take_the_interval_away() -> None:
    usual = [paired(np.linspace(1.0, 2.0, 600), block=60) for _ in range(10)]
    waited = paired(np.ones(1), block=2500)
    assert pooled_drift([*usual, waited]).block == 60
    assert pooled_drift([*usual, waited]).percent("a").interval is not None


def test_variants_that_a_log_lacks_are_left_out() -> None:
    both = paired(np.ones((2, 50)), names=("a", "b"))
    assert pooled_drift([both, paired(np.ones(50), names=("b",))]).names == ("b",)
    assert pooled_drift([both], ["b", "c"]).names == ("b",)
    with pytest.raises(ValueError, match="no log"):
        pooled_drift([])


def segments(starts: list[float], errors: list[float]) -> Drift:
    stamps = (np.array(starts) * SECOND).astype(np.int64)
    full = np.full(len(starts), 10.0)
    return Drift(10.0, "s", stamps, full, np.array(errors), 0.0 * full, full)


def test_segments_of_two_runs_are_matched_by_their_time_in_the_log() -> None:
    # The truth is 0.3 s later in the second, which lacks a segment and begins its own a row later.
    one = segments([0.0, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0])
    other = segments([1.35, 3.35, 9.0], [20.0, 40.0, 90.0])
    first, second = matched_drifts(one, other, later=0.3)
    assert first.position_errors.tolist() == [2.0, 4.0]
    assert second.position_errors.tolist() == [20.0, 40.0]
    assert first.starts.tolist() == second.starts.tolist()
    for nothing in (segments([], []), segments([50.0], [1.0])):
        assert not len(matched_drifts(one, nothing)[0].starts)
        assert not len(matched_drifts(nothing, one)[1].starts)


def test_labels_are_unique_names_of_folders(tmp_path: Path) -> None:
    assert unique(["a", "A", "a-2", "page.html"], ["page.html"])[1:] == [
        "A-2",
        "a-2-2",
        "page.html-2",
    ]
    (tmp_path / "bag.d").mkdir()
    assert label_of(tmp_path / "bag.d") == "bag.d"
    assert label_of(tmp_path / "bag.d" / "..") == tmp_path.name
    assert label_of(Path("drives/monday.bag")) == "monday"


# --- several logs and robots ---------------------------------------------------------------------------


def test_several_logs_are_scored_together(logs: list[Log], tmp_path: Path) -> None:
    seen: dict[Case, Comparison] = {}
    paths = [*logs, tmp_path / "missing.bag"]
    found = compare_many(paths, ROBOT, VARIANTS, on_comparison=seen.__setitem__)
    json.dumps(found, allow_nan=False)
    assert [case.log for case in seen] == ["drive 1", "drive 2"]
    assert [one["log"] for one in found["failed"]] == ["missing"]
    assert "missing.bag" in found["failed"][0]["reason"]
    alone = [summarise(one, ROBOT)["variants"] for one in seen.values()]
    pooled = found["pooled"][ROBOT.name]
    assert pooled["logs"] == 2
    assert found["baseline_variant"] == "gyro"
    for name in VARIANTS:
        one = pooled["variants"][name]
        counts = [scores[name]["drift_segments_30s"] for scores in alone]
        assert one["drift_segments_30s"] == sum(counts)
        percents = [scores[name]["drift_percent_30s_mean"] for scores in alone]
        assert min(percents) <= one["drift_percent_30s_mean"] <= max(percents)
        poses = [scores[name]["nees_poses"] for scores in alone]
        means = [scores[name]["nees_pose_mean"] for scores in alone]
        expected = np.average(means, weights=poses)
        assert one["nees_pose_mean"] == pytest.approx(expected)
        assert one["nees_pose_poses"] == sum(poses)
    assert pooled["variants"]["gyro"]["drift_ratio_10s"] == pytest.approx(1.0)
    assert pooled["verdict"]["best"] in VARIANTS
    assert found["ratios"] == {}
    verdict = pooled["verdict"]
    best, baseline = verdict["best"], verdict["baseline"]
    key = f"drift_percent_{verdict['horizon']}_mean"
    less = [one["variants"][best][key] < one["variants"][baseline][key] for one in found["logs"]]
    assert (verdict["logs_with_less"], verdict["logs_scored"]) == (sum(less), 2)


def test_the_same_robot_twice_has_a_ratio_of_one(logs: list[Log]) -> None:
    found = compare_many(logs[:1], {"a": ROBOT, "b": ROBOT}, "gyro")
    one = found["ratios"]["b"]["variants"]["gyro"]
    assert found["ratios"]["b"]["to"] == "a"
    assert one["ratio_10s"] == pytest.approx(1.0)
    assert one["ratio_10s_95"] == pytest.approx([1.0, 1.0])
    assert one["segments_10s"] == found["pooled"]["a"]["variants"]["gyro"]["drift_segments_10s"]


def test_a_log_without_truth_is_listed_and_not_scored(logs: list[Log]) -> None:
    blind = replace(logs[1], truth=None, name="blind")
    found = compare_many([logs[0], blind], ROBOT, VARIANTS)
    assert [one["label"] for one in found["logs"]] == ["drive 1", "blind"]
    assert found["pooled"][ROBOT.name]["logs"] == 1
    alone = compare_many([blind], ROBOT, VARIANTS)
    assert alone["pooled"][ROBOT.name]["verdict"] is None


def test_parts_of_one_recording_are_noted(logs: list[Log]) -> None:
    middle = (logs[0].start + logs[0].end) // 2
    parts = [logs[0].between(logs[0].start, middle), logs[0].between(middle, logs[0].end)]
    found = compare_many([replace(parts[0], name="a"), replace(parts[1], name="b")], ROBOT, "gyro")
    (note,) = found["notes"]
    assert note.startswith("b begins")
    assert "--one-log" in note
