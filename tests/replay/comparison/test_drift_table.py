"""Drift by distance, its 95 % intervals, and the verdict."""

import math
from dataclasses import replace

import numpy as np
import pytest

from icreckon import PoseSeries, drift
from icreckon.replay.comparison.bootstrap import LEAST_BLOCKS, PairedDrift, paired_drift
from icreckon.replay.comparison.drift_table import horizon_labels, verdict

SECOND = 10**9


def straight(seconds: float, speed: float, bend: float = 0.0) -> PoseSeries:
    """Straight ahead at a speed, or with a yaw rate in rad/s."""
    t = np.arange(0.0, seconds, 0.1)
    if bend:
        x, y = speed / bend * np.sin(bend * t), speed / bend * (1.0 - np.cos(bend * t))
    else:
        x, y = speed * t, np.zeros_like(t)
    return PoseSeries((t * SECOND).astype(np.int64), np.column_stack([x, y, bend * t]))


def test_drift_by_distance_of_a_wrong_scale() -> None:
    truth = straight(100.0, 0.5)
    estimate = PoseSeries(truth.stamps, truth.poses * [1.02, 1.0, 1.0])
    found = drift(estimate, truth, 10.0, unit="m")
    assert found.percent_mean == pytest.approx(2.0, rel=1e-9)
    assert found.distances == pytest.approx(10.0, abs=0.06)
    assert found.durations == pytest.approx(20.0, abs=0.11)
    # They begin once a second, as long as 10 m are left.
    assert len(found.starts) == pytest.approx(80, abs=1)
    assert len(drift(estimate, truth, 51.0, unit="m").starts) == 0


def test_drift_by_distance_agrees_with_that_by_time_at_constant_speed() -> None:
    truth, estimate = straight(100.0, 0.5), straight(100.0, 0.5, bend=0.01)
    by_time, by_distance = drift(estimate, truth, 20.0), drift(estimate, truth, 10.0, unit="m")
    assert by_distance.percent_mean == pytest.approx(by_time.percent_mean, rel=0.01)
    assert by_distance.yaw_deg_per_m == pytest.approx(math.degrees(0.2) / 10.0, rel=0.01)


def test_segments_stay_within_and_do_not_cross_holes() -> None:
    truth = straight(100.0, 0.5)
    within = [(10 * SECOND, 40 * SECOND), (60 * SECOND, 75 * SECOND)]
    found = drift(truth, truth, 10.0, within=within, unit="m")
    assert (found.starts >= 10 * SECOND).all()
    assert (found.starts <= 20 * SECOND).all()
    assert len(drift(truth, truth, 10.0, within=[], unit="m").starts) == 0
    holed = (truth.stamps < 50 * SECOND) | (truth.stamps > 53 * SECOND)
    series = PoseSeries(truth.stamps[holed], truth.poses[holed])
    found = drift(truth, series, 10.0, unit="m")
    ends = found.starts + (found.durations * SECOND).astype(np.int64)
    assert not ((found.starts < 51 * SECOND) & (ends > 52 * SECOND)).any()
    assert len(found.starts) > 40
    single = PoseSeries(truth.stamps[:1], truth.poses[:1])
    assert math.isnan(drift(truth, single, 10.0, unit="m").percent_mean)


def wandering(rng: np.random.Generator, count: int, horizon: int) -> np.ndarray:
    """Errors of segments a second apart that share what makes them drift, mean sqrt(pi / 2)."""
    steps = np.cumsum(rng.normal(size=(2, count + horizon + 1)), axis=1)
    return np.hypot(*(steps[:, horizon : horizon + count] - steps[:, :count])) / math.sqrt(horizon)


@pytest.mark.parametrize(("count", "horizon"), [(170, 30), (600, 30), (1000, 10)])
def test_intervals_cover_the_truth_as_often_as_they_say(count: int, horizon: int) -> None:
    rng = np.random.default_rng(3)
    runs, inside, paired_inside = 200, 0, 0
    for _ in range(runs):
        errors = np.array([wandering(rng, count, horizon) for _ in range(2)])
        block = math.ceil(min(2 * horizon, max(horizon, count / 5)))
        one = PairedDrift(("a", "b"), errors, np.ones(count), block)
        low, high = one.percent("a").interval
        inside += low <= 100.0 * math.sqrt(math.pi / 2.0) <= high
        low, high = one.ratio("a", "b").interval
        paired_inside += low <= 1.0 <= high
    # 95 % is meant; block bootstraps of few blocks are known to fall somewhat short of it. Four standard
    # deviations of 200 draws at 92 % are 8 %.
    assert 0.84 <= inside / runs <= 0.995
    assert 0.84 <= paired_inside / runs <= 0.995


def test_pairing_makes_ratios_surer_than_what_they_compare() -> None:
    rng = np.random.default_rng(1)
    errors = wandering(rng, 500, 10)
    both = PairedDrift(("a", "b"), np.array([errors, 0.5 * errors]), np.ones(500), 20)
    ratio = both.ratio("b", "a")
    assert ratio.value == pytest.approx(0.5)
    assert ratio.interval == pytest.approx((0.5, 0.5))
    low, high = both.percent("a").interval
    assert high - low > 0.1 * both.percent("a").value


def test_a_short_log_gets_no_interval() -> None:
    errors = np.ones((1, 50))
    short = PairedDrift(("a",), errors, np.ones(50), 25)
    assert short.blocks < LEAST_BLOCKS
    assert short.percent("a") == (100.0, None)
    nothing = PairedDrift(("a",), errors[:, :0], np.ones(0), 1)
    assert math.isnan(nothing.percent("a").value)
    assert nothing.percent("a").interval is None


def test_pairing_keeps_the_segments_that_all_have_and_in_which_it_moved() -> None:
    truth = straight(120.0, 0.5)
    standing = truth.poses.copy()
    standing[600:] = standing[600]
    truth = PoseSeries(truth.stamps, standing)
    late = PoseSeries(truth.stamps[200:], truth.poses[200:])
    drifts = {"a": drift(truth, truth, 10.0), "b": drift(late, truth, 10.0)}
    paired = paired_drift(drifts)
    assert len(paired.distances) == pytest.approx(40, abs=2)
    assert paired.errors.shape == (2, len(paired.distances))
    assert paired.block == pytest.approx(10, abs=1)


def pairs(errors: dict[str, float]) -> dict[str, PairedDrift]:
    rng = np.random.default_rng(2)
    rows = [value * (1.0 + 0.1 * rng.normal(size=300)) for value in errors.values()]
    one = PairedDrift(tuple(errors), np.array(rows), np.full(300, 10.0), 20)
    return dict.fromkeys(horizon_labels(), one)


def test_the_verdict_says_who_drifts_least_and_who_may_be_as_good() -> None:
    drifts = pairs({"differential": 2.0, "constant-online": 1.0, "a": 0.5, "b": 0.5001})
    found = verdict(drifts, "constant-online")
    assert found["best"] in {"a", "b"}
    assert found["horizon"] == "30s"
    assert found["ratio"] == pytest.approx(0.5, abs=0.01)
    low, high = found["ratio_95"]
    assert 0.45 < low < 0.5 < high < 0.55
    assert found["not_shown_worse"] == [next(iter({"a", "b"} - {found["best"]}))]
    # Smoothed runs are no rivals.
    drifts = pairs({"constant-online": 1.0, "constant-online-smoothed": 0.1})
    assert verdict(drifts, "constant-online")["best"] == "constant-online"


def test_a_horizon_without_interval_gives_way_to_one_that_has_it() -> None:
    drifts = pairs({"constant-online": 1.0, "a": 0.5})
    short = replace(drifts["30s"], block=250)
    assert verdict(drifts | {"30s": short}, "constant-online")["horizon"] == "10s"
    found = verdict(dict.fromkeys(drifts, short), "constant-online")
    assert (found["horizon"], found["ratio_95"]) == ("30s", None)
    assert found["not_shown_worse"] == ["constant-online"]
    empty = PairedDrift(("a",), np.ones((1, 0)), np.ones(0), 1)
    assert verdict(dict.fromkeys(drifts, empty), "a") is None
