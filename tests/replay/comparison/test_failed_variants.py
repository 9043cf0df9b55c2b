"""A variant of a comparison that fails is an error of that variant; the others are scored."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import typer

from command_line import results_in
from icreckon import LostFilter, ReplayError, Scenario, load_robot, simulate, summarise
from icreckon.cli.common.comparing import compare_and_write
from icreckon.cli.common.console import exit_if_failed, show
from icreckon.estimator.filter.samples import COUNT, RunRows
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.comparison import compare as comparing
from icreckon.replay.comparison.compare import Comparison, compare
from icreckon.report.replay.folder import write_report
from icreckon.report.replay.page import replay_page
from icreckon.report.replay.page_text import failures
from icreckon.report.replay.tables import results_table

ROBOT = load_robot("auriga-alpha")
LOG = simulate(Scenario(duration=24.0, seed=2, outages=((10.0, 24.0),), imu_rate=50.0), ROBOT)
VARIANTS = ("constant-online", "inertia-online")
LOST = 12.0  # s
FROM = int(LOG.start + LOST * 1e9)


def nan_state(rows: RunRows, row: int) -> None:
    rows.states[row] = np.nan


def negative_variance(rows: RunRows, row: int) -> None:
    rows.sigmas[row, 3] = np.sqrt(-1e-9)


def absurd_speed(rows: RunRows, row: int) -> None:
    rows.twists[row] += 1e6


def breaks(_rows: RunRows, _row: int) -> None:
    raise np.linalg.LinAlgError("Singular matrix")


def lose(
    monkeypatch: pytest.MonkeyPatch,
    names: tuple[str, ...],
    how: Callable[[RunRows, int], None] = nan_state,
) -> None:
    """Lose the filters of these variants at 12 s."""

    class Losing(PoseEstimator):
        def feed_samples(self, *_: Any) -> tuple[int, int, int]:
            return 0, 0, 0

        @np.errstate(invalid="ignore")
        def write_row(self, rows: RunRows, stamp: int) -> bool:
            is_due = super().write_row(rows, stamp)
            if is_due and self.stamp >= FROM and self.variant.name in names:
                how(rows, int(rows.progress[COUNT]) - 1)
            return is_due

    monkeypatch.setattr("icreckon.estimator.streaming.run.PoseEstimator", Losing)


@pytest.fixture(scope="module")
def whole() -> Comparison:
    return compare(LOG, ROBOT, VARIANTS)


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        (nan_state, "estimate is not finite from 12.0 s on"),
        (negative_variance, "estimate has negative variances from 12.0 s on"),
        (absurd_speed, "estimate is absurd (beyond 1e+08 m, 1e+03 m/s or rad/s) from 12.0 s on"),
        (breaks, "stopped at 12.0 s by LinAlgError: Singular matrix"),
    ],
)
def test_a_lost_variant_is_named_and_others_are_scored(whole, monkeypatch, tmp_path, how, reason):
    lose(monkeypatch, ("inertia-online",), how)
    found = compare(LOG, ROBOT, VARIANTS)
    assert list(found.runs) == ["constant-online"]
    assert found.failed["inertia-online"].reason == reason
    states = (one.runs["constant-online"].states for one in (found, whole))
    assert np.array_equal(*states)
    results = summarise(found, ROBOT)
    assert list(results["variants"]) == ["constant-online"]
    assert results["failed"]["inertia-online"]["reason"] == reason
    assert results["failed"]["inertia-online"]["since_s"] == pytest.approx(LOST, abs=0.03)
    assert results["variants"]["constant-online"]["drift_percent_10s_mean"] > 0.0
    line = f"ERROR: inertia-online has no result: {reason}"
    assert failures(results) == [line]
    page = replay_page(results)
    assert page.index(line) < page.index('class="headline"')
    write_report(tmp_path, found, results, ROBOT, ("tum",))
    assert not (tmp_path / "inertia-online.tum").exists()
    assert (tmp_path / "constant-online.tum").exists()


def test_all_variants_lost_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    lose(monkeypatch, VARIANTS)
    with pytest.raises(ReplayError, match=r"no variant has a result: constant-online: estimate"):
        compare(LOG, ROBOT, VARIANTS)


def test_a_logged_truth_is_aligned_with_another_variant_if_the_usual_one_is_lost(monkeypatch):
    log = replace(LOG, truth=replace(LOG.truth, twists=None))
    lose(monkeypatch, ("constant-online",))
    found = compare(log, ROBOT, VARIANTS)
    assert list(found.runs) == ["inertia-online"]
    assert found.alignment is not None


def test_smoothing_that_is_lost_leaves_the_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    def smooth_run(*arguments: Any, **named: Any) -> Any:
        from icreckon.estimator.streaming.smoother import smooth

        found = smooth(*arguments, **named)
        states = found.smoothed.states * np.inf
        return found._replace(smoothed=replace(found.smoothed, states=states))

    monkeypatch.setattr(comparing, "smooth_run", smooth_run)
    with np.errstate(invalid="ignore"):
        found = compare(LOG, ROBOT, ("differential",), smooth=True)
    assert list(found.runs) == ["differential"]
    assert list(found.failed) == ["differential-smoothed"]


def test_the_command_writes_what_it_has_and_exits_with_1(monkeypatch, tmp_path, capsys):
    lose(monkeypatch, ("inertia-online",))
    origin = {"command": "replay", "configuration": {}, "inputs": {}}
    options = {"variants": [*VARIANTS], "origin": origin, "workers": 1}
    summary, _ = compare_and_write(LOG, ROBOT, tmp_path, **options)
    show(tmp_path, results_table, summary, 125, as_json=False, wide=False)
    assert {"results.json", "page.html", "figure.png"} <= {path.name for path in tmp_path.iterdir()}
    results = results_in(tmp_path)
    assert list(results["failed"]) == ["inertia-online"]
    shown = capsys.readouterr().out
    assert "inertia-online" in shown
    assert "ERROR" in shown
    with pytest.raises(typer.Exit) as left:
        exit_if_failed(failures(summary))
    assert left.value.exit_code == 1
    assert "ERROR: inertia-online has no result" in capsys.readouterr().err
    exit_if_failed([])


def test_a_failure_survives_the_way_from_a_worker_process() -> None:
    import pickle

    lost = pickle.loads(pickle.dumps(LostFilter("differential", "lost from 1.0 s on", 1.0)))  # noqa: S301
    assert (str(lost), lost.seconds) == ("differential: lost from 1.0 s on", 1.0)
