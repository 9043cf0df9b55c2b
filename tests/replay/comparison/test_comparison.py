"""Variants side by side: here or in threads, with the same result."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import icreckon
from icreckon import Comparison, EstimatorError, Robot, Scenario, compare, simulate, summarise
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.log.series import PoseSeries, Truth
from icreckon.estimator.robot.variants import VARIANTS as ALL_VARIANTS
from icreckon.replay.base.colours import COLOURS
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.comparison.truth_alignment import in_frame_of_fixes

VARIANTS = ["constant-fixed", "inertia-online"]


def same(a: Comparison, b: Comparison) -> None:
    assert list(a.runs) == list(b.runs)
    for name, run in a.runs.items():
        np.testing.assert_array_equal(run.states, b.runs[name].states)
        np.testing.assert_array_equal(run.stamps, b.runs[name].stamps)


@pytest.mark.thorough
def test_where_the_variants_run_does_not_matter(robot: Robot) -> None:
    log = simulate(Scenario(duration=15.0, seed=4), robot)
    here = compare(log, robot, VARIANTS)
    assert list(here.runs) == VARIANTS
    same(here, compare(log, robot, VARIANTS, workers=2))


def test_a_variant_that_cannot_run_is_refused_before_anything_runs(robot: Robot) -> None:
    log = simulate(Scenario(duration=5.0), robot)
    with pytest.raises(EstimatorError, match="did you mean 'inertia-online'"):
        compare(log, robot, ["inertia-onlin"])


def test_by_default_all_variants_are_compared(robot: Robot) -> None:
    log = simulate(Scenario(duration=5.0), robot)
    assert list(compare(log, robot).runs) == list(ALL_VARIANTS)
    assert set(COLOURS) == set(ALL_VARIANTS)
    assert len(set(COLOURS.values())) == len(COLOURS)


def test_smoothed_runs_come_behind_the_others_and_are_not_compared_with_them(robot: Robot) -> None:
    log = simulate(Scenario(duration=25.0, seed=4, outages=((8.0, 24.0),)), robot)
    comparison = compare(log, robot, VARIANTS, smooth=True)
    assert list(comparison.runs) == [*VARIANTS, *(f"{name}-smoothed" for name in VARIANTS)]
    scores = summarise(comparison, robot)["variants"]
    of_filter, of_smoother = (scores[f"inertia-online{end}"] for end in ("", "-smoothed"))
    assert of_smoother["rmse_v_y_m_s"] < of_filter["rmse_v_y_m_s"]
    blind = Comparison(replace(log, truth=None), comparison.runs, None)
    assert summarise(blind, robot)["reference_variant"] == VARIANTS[-1]


@pytest.fixture(scope="module")
def log() -> icreckon.Log:
    return simulate(Scenario(duration=60.0, fix_rate=1.0), icreckon.load_robot("auriga-alpha"))


def test_one_variant_and_a_part_as_texts(log: icreckon.Log, tmp_path: Path):
    robot = icreckon.load_robot("auriga-alpha")
    found = icreckon.compare(log, robot, "gyro", fixes="0:40%")
    assert list(found.runs) == ["gyro"]
    results = icreckon.summarise(found, robot)
    icreckon.write_report(str(tmp_path), found, results, robot, formats=())
    assert (tmp_path / "page.html").exists()
    with pytest.raises(ReplayError, match="no such folder; make it first"):
        icreckon.write_report(str(tmp_path / "none"), found, results, robot)
    with pytest.raises(ReplayError, match="no part of a log"):
        icreckon.compare(log, robot, "gyro", fixes="the first half")
    with pytest.raises(EstimatorError, match=r"part\(0.0, 10.0\) takes seconds"):
        log.between(0, 10)


def test_a_run_begins_where_dead_reckoning_leads_back_from_a_late_truth(robot: Robot) -> None:
    log = simulate(Scenario(duration=60.0, seed=1, trajectory="circle", fix_rate=0.0), robot)
    poses = log.truth.poses
    later = poses.rows(poses.stamps >= log.start + 20 * 10**9)
    late = replace(log, truth=icreckon.Truth(later, source="mocap"))
    found = compare(late, robot, "inertia-online")
    path = found.runs["inertia-online"].trajectory
    assert path.poses[0, :2] == pytest.approx(poses.poses[0, :2], abs=0.2)
    assert path.poses[-1, :2] == pytest.approx(poses.poses[-1, :2], abs=0.2)
    # Nothing but the path of 20 s is uncertain.
    assert 0.001 < np.sqrt(path.pose_covariances[0, 0, 0]) < 0.5
    assert any("the truth begins 20.0 s after the log" in note for note in found.log.notes)


def test_fixes_that_are_scored_and_begin_late_start_no_run(robot: Robot) -> None:
    log = simulate(Scenario(duration=60.0, seed=1, fix_rate=1.0), robot)
    fixes = log.fixes
    late = fixes.stamps >= log.start + 5 * 10**9
    fixes = replace(
        fixes, stamps=fixes.stamps[late], poses=fixes.poses[late], variances=fixes.variances[late]
    )
    found = compare(replace(log, fixes=fixes, truth=None), robot, "inertia-online", fixes="0:40%")
    assert found.log.truth is not None
    assert not any("the truth begins" in note for note in found.log.notes)


@pytest.mark.parametrize("shift", [0.0, 2.0])
def test_fixes_in_another_frame_than_the_truth_are_noted(robot: Robot, shift: float) -> None:
    log = simulate(Scenario(duration=40.0, seed=1, fix_rate=1.0), robot)
    fixes = log.fixes
    moved = replace(fixes, poses=fixes.poses + np.array([shift, 0.0, 0.0]))
    found = compare(replace(log, fixes=moved), robot, "inertia-online")
    notes = summarise(found, robot)["log"]["notes"]
    assert any("not in the frame of the truth" in note for note in notes) == bool(shift)


@pytest.mark.parametrize("headings", [True, False])
def test_a_truth_in_another_frame_is_moved_to_that_of_the_fixes(robot, headings):
    """A total station has its own frame: errors were those of the frames, 240 m with NEES of millions."""
    log = simulate(Scenario(duration=60.0, seed=1, fix_rate=1.0), robot)
    poses = log.truth.poses.poses.copy()
    poses[:, :2] = rotate(poses[:, :2], np.full(len(poses), 1.0)) + np.array([50.0, -30.0])
    poses[:, 2] = poses[:, 2] + 1.0 if headings else np.nan
    truth = Truth(PoseSeries(log.truth.poses.stamps, poses), None, None, "total station", headings)
    found = compare(replace(log, truth=truth), robot, "inertia-online")
    (note,) = (note for note in found.log.notes if "another frame" in note)
    assert "by a turn of -57" in note
    results = summarise(found, robot)["variants"]["inertia-online"]
    assert results["final_position_error_m"] < 0.3
    assert results["rejected"].get("position", 0) == 0


def test_a_fix_without_variance_does_not_move_the_truth(robot: Robot) -> None:
    log = simulate(Scenario(duration=40.0, seed=1, fix_rate=1.0), robot)
    variances = log.fixes.variances.copy()
    variances[0] = 0.0
    same_frame = replace(log, fixes=replace(log.fixes, variances=variances))
    assert in_frame_of_fixes(same_frame).truth is log.truth
