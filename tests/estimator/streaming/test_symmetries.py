"""Symmetries of the streaming estimator: other epochs, frames, mounts, and the mirror image."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from fed_estimators import feed_all, known, short_log
from icreckon import Log, PoseEstimator, Scenario, Terrain, changed_robot, load_robot, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.base.frames import compose, rpy_to_matrix
from icreckon.estimator.log.series import FixSeries, ImuSeries, TrackSpeedSeries

ALPHA = load_robot("auriga-alpha")
EPOCH = 1_700_000_000_123_456_789


def shifted(log, by):
    parts = {
        name: replace(getattr(log, name), stamps=getattr(log, name).stamps + by)
        for name in ("tracks", "imu", "fixes")
    }
    return replace(log, truth=None, **parts)


@pytest.mark.parametrize("by", [1000, -EPOCH, 987_654_321_987_654_321])
def test_the_epoch_of_the_stamps_does_not_matter(by):
    log = short_log(duration=8.0)
    a = known(feed_all(PoseEstimator(ALPHA), log))
    b = known(feed_all(PoseEstimator(ALPHA), shifted(log, by)))
    assert b == (a[0] + by, *a[1:])


def mirrored_robot(robot):
    vehicle, imu, i = robot.vehicle, robot.imu, robot.indices
    forward, left, up = vehicle.centre_of_mass
    roll, pitch, yaw = imu.rotation_rpy_deg
    icr = robot.constant_icr
    return msgspec.structs.replace(
        robot,
        vehicle=msgspec.structs.replace(vehicle, centre_of_mass=(forward, -left, up)),
        indices=msgspec.structs.replace(i, H=1.0 / i.H, epsilon0=-i.epsilon0, eta1=-i.eta1),
        constant_icr=msgspec.structs.replace(icr, x_ICRl=-icr.x_ICRr, x_ICRr=-icr.x_ICRl),
        imu=msgspec.structs.replace(
            imu,
            rotation_rpy_deg=(-roll, pitch, -yaw),
            position=(imu.position[0], -imu.position[1], imu.position[2]),
        ),
    )


def mirrored_log(log):
    across = np.array([1.0, -1.0, 1.0])
    return Log(
        log.name,
        TrackSpeedSeries(log.tracks.stamps, log.tracks.speeds[:, ::-1]),
        ImuSeries(
            log.imu.stamps, -across * log.imu.angular_velocity, across * log.imu.linear_acceleration
        ),
        FixSeries(log.fixes.stamps, log.fixes.poses * [1.0, -1.0, -1.0], log.fixes.variances),
    )


@pytest.mark.parametrize("variant", ["gyro", "full-linear", "inertia-online"])
def test_mirrored_robot_drives_the_mirrored_way(variant):
    mount = {"imu.rotation_rpy_deg": (8.0, -5.0, 30.0), "imu.position": (0.2, 0.1, 0.3)}
    robot = changed_robot(ALPHA, mount)
    scenario = Scenario(
        duration=20.0, trajectory="aggressive", seed=6, track_rate=25.0, imu_rate=50.0,
        terrain=Terrain(slope_deg=6.0, uphill_deg=40.0),
    )  # fmt: skip
    log = simulate(scenario, robot)
    a = feed_all(PoseEstimator(robot, variant), log)
    b = feed_all(PoseEstimator(mirrored_robot(robot), variant), mirrored_log(log))
    signs = np.array([1.0, -1.0, -1.0])
    assert b.pose == pytest.approx(signs * a.pose, abs=1e-9)
    assert b.twist == pytest.approx(signs * a.twist, abs=1e-9)
    assert b.pose_covariance == pytest.approx(np.outer(signs, signs) * a.pose_covariance, abs=1e-9)
    of_linear = variant == "full-linear"
    one, other = ("right_l", "right_r") if of_linear else ("epsilon0", "epsilon0")
    assert b.parameters[one] == pytest.approx(-a.parameters[other], abs=1e-9)
    assert b.state[s.GRAVITY] == pytest.approx(a.state[s.GRAVITY] * [1.0, -1.0], abs=1e-9)
    assert variant == "gyro" or np.hypot(*a.state[s.GRAVITY]) > 0.4
    assert b.biases["gyro_bias"] == pytest.approx(-a.biases["gyro_bias"], abs=1e-9)


def test_start_elsewhere_moves_the_whole_run():
    log = short_log(duration=10.0, fix_rate=0.0)
    start = (3.0, -4.0, 2.0)
    here = feed_all(PoseEstimator(ALPHA), log)
    there = feed_all(PoseEstimator(ALPHA, start=start), log)
    assert there.pose == pytest.approx(compose(start, here.pose), abs=1e-9)
    turn = rpy_to_matrix(0.0, 0.0, 2.0)
    assert there.pose_covariance == pytest.approx(turn @ here.pose_covariance @ turn.T, abs=1e-12)
    assert there.twist == pytest.approx(here.twist, abs=1e-12)


def assert_same_state(robot, log, other, its_log):
    expected = feed_all(PoseEstimator(robot), log).state
    assert feed_all(PoseEstimator(other), its_log).state == pytest.approx(expected, abs=1e-9)


MOUNTS = [(180.0, 0.0, 0.0), (0.0, 10.0, -40.0), (-25.0, 15.0, 170.0), (90.0, 0.0, 90.0)]


@pytest.mark.parametrize("rpy", MOUNTS)
def test_mount_of_the_imu_does_not_matter(rpy):
    log = short_log(duration=8.0)
    turned = changed_robot(ALPHA, {"imu.rotation_rpy_deg": rpy})
    # From the body's axes to the IMU's: rows times R are R^T times columns.
    R = rpy_to_matrix(*np.radians(rpy))
    imu = ImuSeries(log.imu.stamps, log.imu.angular_velocity @ R, log.imu.linear_acceleration @ R)
    assert_same_state(ALPHA, log, turned, replace(log, imu=imu))


@pytest.mark.parametrize("rpy", MOUNTS[:3])
def test_gyro_that_reads_z_alone_reads_the_yaw_rate_over_the_tilt(rpy):
    log = short_log(duration=8.0)
    flat = log.imu.angular_velocity * [0.0, 0.0, 1.0]
    upright = replace(log, imu=ImuSeries(log.imu.stamps, flat))
    tilted_robot = changed_robot(ALPHA, {"imu.rotation_rpy_deg": rpy, "imu.gyro_axes": "z"})
    R = rpy_to_matrix(*np.radians(rpy))
    z_alone = (flat @ R) * [0.0, 0.0, 1.0]
    tilted = replace(log, imu=ImuSeries(log.imu.stamps, z_alone))
    assert_same_state(ALPHA, upright, tilted_robot, tilted)


def test_known_scale_of_the_gyro_is_taken_out():
    log = short_log(duration=8.0)
    scaled = replace(log.imu, angular_velocity=0.98 * log.imu.angular_velocity)
    robot = changed_robot(ALPHA, {"imu.gyro_scale": 0.98})
    assert_same_state(ALPHA, log, robot, replace(log, imu=scaled))
