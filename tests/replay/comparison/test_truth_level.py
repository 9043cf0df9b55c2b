"""Height, roll and pitch of runs against truths in three dimensions."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from icreckon import Log, Run, Scenario, Terrain, compare, read_log, simulate, summarise, write_log
from icreckon.estimator.log.scores import path_length
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.comparison.truth_level import levelled, spatial_scores

ROBOT, VARIANT = load_robot("warthog"), "inertia-online"


@cache
def hills() -> Log:
    terrain = Terrain(rolling_deg=6.0, slope_deg=2.0)
    scenario = Scenario(duration=60.0, seed=2, truth="friction", terrain=terrain)
    return simulate(scenario, ROBOT)


@cache
def reckoned() -> Run:
    return compare(hills(), ROBOT, [VARIANT]).runs[VARIANT]


def tilted(
    poses: PoseSeries, axis: tuple[float, float, float], mount: tuple[float, float] = (0.0, 0.0)
) -> PoseSeries:
    """Poses in a map whose vertical is off by a rotation, of axes tilted in the robot."""
    turn, own = Rotation.from_rotvec(axis), Rotation.from_rotvec([*mount, 0.0])
    heights = turn.apply(poses.positions)[:, 2]
    tilts = (turn * Rotation.from_quat(poses.quaternions) * own).as_euler("xyz")[:, :2]
    return replace(poses, spatial=np.column_stack([heights, tilts]))


def test_a_map_that_is_not_level_is_turned_to_gravity() -> None:
    truth = hills().truth
    off = tilted(truth.poses, (0.08, -0.05, 0.0))
    found, angle = levelled(off, reckoned().trajectory)
    assert angle == pytest.approx(np.hypot(0.08, 0.05), abs=0.02)
    wrong = found.spatial - truth.poses.spatial
    assert np.degrees(np.sqrt(np.mean(wrong[:, 1:] ** 2))) < 1.0
    before = spatial_scores(reckoned().trajectory, off, [(0, 2**62)])
    after = spatial_scores(reckoned().trajectory, found, [(0, 2**62)])
    assert after["rms_roll_deg"] < 0.4 * before["rms_roll_deg"]
    assert after["height_drift_percent_30s_mean"] < before["height_drift_percent_30s_mean"]


def test_a_tilt_of_its_axes_in_the_robot_is_no_error_of_the_attitude() -> None:
    truth = hills().truth
    path = reckoned().trajectory
    found = [
        spatial_scores(path, levelled(off, path)[0], [])
        for off in (truth.poses, tilted(truth.poses, (0.05, 0.02, 0.0), mount=(0.02, -0.03)))
    ]
    for axis in ("rms_roll_deg", "rms_pitch_deg"):
        assert found[1][axis] == pytest.approx(found[0][axis], rel=0.05)


def test_its_scores_are_those_of_the_errors() -> None:
    truth = hills().truth
    path = reckoned().trajectory
    # An estimate that is the truth, but for roll, pitch, and a height that grows by 1 % of the path.
    stamps = truth.poses.stamps
    travelled = path_length(truth.poses)
    wrong = np.column_stack([0.01 * travelled, np.full((len(stamps), 2), (0.02, -0.01))])
    one = replace(
        path,
        stamps=stamps,
        poses=truth.poses.poses,
        spatial=truth.poses.spatial + wrong,
        spatial_sigmas=np.ones((len(stamps), 3)),
    )
    found = spatial_scores(one, truth.poses, [(0, 2**62)])
    assert found["rms_roll_deg"] == pytest.approx(np.degrees(0.02))
    assert found["rms_pitch_deg"] == pytest.approx(np.degrees(0.01))
    assert found["height_drift_percent_30s_mean"] == pytest.approx(1.0, rel=0.02)
    assert found["final_height_error_m"] == pytest.approx(0.01 * travelled[-1])
    assert found["final_height_sigma_m"] == 1.0


def test_planar_truths_have_none() -> None:
    truth = hills().truth
    planar = replace(truth.poses, spatial=None)
    assert levelled(planar, reckoned().trajectory) == (planar, 0.0)
    assert spatial_scores(reckoned().trajectory, planar, [(0, 2**62)]) == {}


def test_a_bag_keeps_the_truth_and_a_replay_scores_it(tmp_path: Path) -> None:
    log = read_log(write_log(hills(), tmp_path / "bag", "mcap", ROBOT), ROBOT)
    written, read = hills().truth.poses.spatial, log.truth.poses.spatial
    assert read == pytest.approx(written - [written[0, 0], 0.0, 0.0], abs=1e-9)
    comparison = compare(log, ROBOT, ["gyro", VARIANT])
    results = summarise(comparison, ROBOT, series=True)
    gyro, one = (results["variants"][name] for name in ("gyro", VARIANT))
    assert one["rms_roll_deg"] < 0.5 * gyro["rms_roll_deg"]
    truth = comparison.truths[VARIANT].truth.poses
    alone = spatial_scores(comparison.runs[VARIANT].trajectory, truth, [(0, 2**62)])
    assert one["rms_pitch_deg"] == alone["rms_pitch_deg"]
    series = results["series"]
    assert len(series["truth"]["z_m"]) == len(series["variants"][VARIANT]["z_sigma_m"])
