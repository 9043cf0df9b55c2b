"""Columns of a run and its errors against the truth, as a data frame needs them."""

from dataclasses import replace

import numpy as np
import pytest

import icreckon
from icreckon import Comparison, PoseSeries, compare, pose_nees
from icreckon.replay.comparison.fixes import OF_FIXES

ROBOT = icreckon.load_robot("auriga-alpha")
VARIANT = "constant-online"


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    scenario = icreckon.Scenario(trajectory="slalom", duration=30.0, seed=3, fix_rate=0.0)
    return compare(icreckon.simulate(scenario, ROBOT), ROBOT, [VARIANT])


def with_truth(comparison: Comparison, **changes: object) -> Comparison:
    truth = replace(comparison.log.truth, **changes)
    return replace(comparison, log=replace(comparison.log, truth=truth))


def test_a_row_for_each_pair_of_track_speeds(comparison: Comparison) -> None:
    pd = pytest.importorskip("pandas", reason="pip install pandas (in the extra test)")
    frame = pd.DataFrame(icreckon.columns_of(comparison, ROBOT, VARIANT))
    assert len(frame) == len(comparison.log.tracks.stamps)
    assert np.allclose(frame.t_s, (frame.stamp_ns - comparison.log.start) * 1e-9)
    off = np.hypot(frame.x_m - frame.true_x_m, frame.y_m - frame.true_y_m)
    assert np.allclose(off, frame.position_error_m)
    assert frame.yaw_error_rad.abs().max() < 0.2


def test_errors_are_those_of_the_scores(comparison: Comparison) -> None:
    found = icreckon.columns_of(comparison, ROBOT, VARIANT)
    run = comparison.runs[VARIANT]
    at_rows = PoseSeries(
        run.stamps, np.stack([found[f"true_{name}"] for name in ("x_m", "y_m", "yaw_rad")], axis=-1)
    )
    expected = pose_nees(run.trajectory, at_rows)
    known = found["nees_pose"][np.isfinite(found["nees_pose"])]
    np.testing.assert_allclose(known, expected, rtol=1e-9)
    assert 0.1 < known.mean() < 30.0


def test_a_hole_of_the_truth_has_no_errors(comparison: Comparison) -> None:
    truth = comparison.log.truth
    seconds = (truth.poses.stamps - comparison.log.start) * 1e-9
    kept = (seconds < 10.0) | (seconds > 20.0)
    poses = PoseSeries(truth.poses.stamps[kept], truth.poses.poses[kept])
    found = icreckon.columns_of(with_truth(comparison, poses=poses), ROBOT, VARIANT)
    hole = (found["t_s"] > 10.6) & (found["t_s"] < 19.4)
    for name in ("true_x_m", "true_yaw_rad", "position_error_m", "yaw_error_rad", "nees_pose"):
        assert np.isnan(found[name][hole]).all(), name
        if name != "nees_pose":  # the start is known, and its covariance singular
            assert np.isfinite(found[name][found["t_s"] < 9.4]).all(), name


@pytest.mark.parametrize(
    ("changes", "has_yaw"),
    [
        ({"source": "mine", "headings": False, "twists": None, "tracks": None}, False),
        ({"source": OF_FIXES}, True),
    ],
)
def test_a_truth_without_headings_or_of_fixes_has_no_nees(comparison, changes, has_yaw) -> None:
    found = icreckon.columns_of(with_truth(comparison, **changes), ROBOT, VARIANT)
    assert np.isfinite(found["position_error_m"]).all()
    assert np.isfinite(found["yaw_error_rad"]).any() == has_yaw
    assert np.isnan(found["nees_pose"]).all()


def test_without_a_truth_or_a_run(comparison: Comparison) -> None:
    bare = replace(comparison, log=replace(comparison.log, truth=None))
    alone = icreckon.columns_of(bare, ROBOT, VARIANT)
    assert set(alone) == set(icreckon.run_columns(comparison.runs[VARIANT], ROBOT))
    with pytest.raises(icreckon.ReplayError, match="no run 'gyro'; there are constant-online"):
        icreckon.columns_of(comparison, ROBOT, "gyro")
