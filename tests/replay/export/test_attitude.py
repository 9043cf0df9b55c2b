"""Roll and pitch of exported odometry are those of the ground."""

from dataclasses import replace

import numpy as np
import pytest

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import rpy_to_matrix
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.run import run
from icreckon.replay.export.attitude import attitude_of
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import run_scenario
from icreckon.simulation.truth.terrain import Terrain


def up_of(quaternion: np.ndarray) -> np.ndarray:
    """Direction of the robot's z axis in odom."""
    x, y, z, w = quaternion
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def test_roll_and_pitch_are_those_of_the_ground(robot: Robot) -> None:
    """On a plane of 6 degrees, within three own sigma and a degree."""
    terrain = Terrain(slope_deg=6.0, uphill_deg=40.0)
    scenario = Scenario(duration=60.0, seed=2, trajectory="random", terrain=terrain)
    drive = run_scenario(scenario, robot)
    one = run(drive.log, robot, "inertia-online")
    attitude = attitude_of(one)
    times = (one.stamps - drive.log.start) * NANOSECOND
    true = drive.motion.attitudes_at(times)
    late = times > 30.0
    tilts = []
    for quaternion, (roll, pitch, _), yaw in zip(
        attitude.quaternions[late], true[late], one.trajectory.poses[late, 2], strict=True
    ):
        expected = rpy_to_matrix(roll, pitch, yaw)[:, 2]
        tilts.append(np.degrees(np.arccos(np.clip(up_of(quaternion) @ expected, -1.0, 1.0))))
    assert np.median(tilts) < 1.0
    assert np.sqrt(attitude.variances[late]).max() < np.radians(2.0)
    assert np.linalg.norm(attitude.quaternions, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.3, 0.0), (0.0, -0.2), (0.25, 0.4)])
def test_gravity_gives_the_attitude_back(tilt: tuple[float, float], robot: Robot) -> None:
    """Gravity along the axes of a robot with this roll and pitch."""
    one = run(run_scenario(Scenario(duration=2.0), robot).log, robot, "gyro")
    (roll, pitch), states = tilt, one.states.copy()
    down = -9.80665 * rpy_to_matrix(roll, pitch, 0.7).T[:, 2]
    states[:, s.GRAVITY] = down[:2]
    one.trajectory.poses[:, 2] = 0.7
    quaternion = attitude_of(replace(one, states=states)).quaternions[-1]
    assert up_of(quaternion) == pytest.approx(rpy_to_matrix(roll, pitch, 0.7)[:, 2], abs=1e-3)


def test_level_ground_has_none(robot: Robot) -> None:
    one = run(run_scenario(Scenario(duration=2.0), robot).log, robot, "gyro")
    sigmas = one.state_sigmas.copy()
    sigmas[:, s.GRAVITY] = 0.0
    attitude = attitude_of(replace(one, state_sigmas=sigmas))
    assert not attitude.quaternions[:, :2].any()
    assert (attitude.variances == 1e6).all()
