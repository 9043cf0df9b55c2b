"""An IMU that is mounted otherwise than the robot file says: gravity shows it."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from icreckon import Log, Robot, Scenario, Terrain, run, simulate
from icreckon.estimator.base.frames import rpy_to_matrix


def tilted(log: Log, roll: float, pitch: float) -> Log:
    """Copy of a log whose IMU is tilted [deg]."""
    imu = log.imu
    mount = rpy_to_matrix(np.radians(roll), np.radians(pitch), 0.0)
    rates, forces = imu.angular_velocity @ mount, imu.linear_acceleration @ mount
    return replace(log, imu=replace(imu, angular_velocity=rates, linear_acceleration=forces))


@pytest.fixture(scope="module", params=[0.0, 6.0], ids=["level", "slope"])
def drive(request: pytest.FixtureRequest, robot: Robot) -> Log:
    terrain = Terrain(slope_deg=request.param, uphill_deg=40.0)
    scenario = Scenario(duration=60.0, seed=1, fix_rate=0.0, terrain=terrain)
    return simulate(scenario, robot)


@pytest.mark.parametrize(
    ("variant", "roll", "pitch"),
    [("constant-online", 10.0, 0.0), ("inertia-online", -6.0, 8.0), ("inertia-online", 0.0, 0.0)],
)
def test_a_tilt_is_found_on_level_ground_and_on_a_slope(variant, roll, pitch, drive, robot):
    """To a degree; the slope, which turns as the robot does, is none."""
    log = tilted(drive, roll, pitch)
    found = run(log, robot, variant).health.tilt
    assert (found.roll_deg, found.pitch_deg) == pytest.approx((roll, pitch), abs=1.5)
    assert found.is_wrong == bool(roll or pitch)


def test_it_is_unknown_without_turning_or_with_a_gyro_of_one_axis(drive: Log, robot: Robot) -> None:
    start = drive.between(drive.start, drive.start + 4_000_000_000)
    assert run(start, robot, "constant-online").health.tilt is None
    of_z = msgspec.structs.replace(robot, imu=msgspec.structs.replace(robot.imu, gyro_axes="z"))
    assert run(drive, of_z, "inertia-online").health.tilt is None
