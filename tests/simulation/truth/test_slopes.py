"""Gyro and accelerometer on ground that is not level."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icreckon.estimator.base.frames import rpy_to_matrix
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.simulation.base.sampling import sample_times
from icreckon.simulation.sensors.imu import InertialErrors, angular_velocities, specific_forces
from icreckon.simulation.truth.true_motion import TrueMotion, integrate_twists
from sensor_readings import read_imu

ALPHA = load_robot("auriga-alpha")
SILENT = InertialErrors()
RATE = 200.0
DOWN = np.array([0.0, 0.0, -GRAVITY])


def moved(twists: np.ndarray, gravity: np.ndarray | None) -> TrueMotion:
    """A motion of given twists (m, 3) and acceleration of gravity (m, 3) in base_link's axes."""
    none = np.zeros((len(twists), 2))
    poses = integrate_twists(twists, 1.0 / RATE)
    return TrueMotion(RATE, poses, twists, none, none, None, "made", gravity)


def on_a_plane(twists: np.ndarray, roll: float, pitch: float) -> TrueMotion:
    """On a plane; roll and pitch are the robot's at yaw zero."""
    in_plane = rpy_to_matrix(roll, pitch, 0.0).T @ DOWN
    yaw = integrate_twists(twists, 1.0 / RATE)[:, 2]
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y, z = in_plane
    gravity = np.stack([cos * x + sin * y, cos * y - sin * x, np.full_like(yaw, z)], axis=-1)
    return moved(twists, gravity)


@pytest.mark.parametrize(("roll", "pitch"), [(0.2, 0.0), (0.0, -0.3), (0.15, 0.25)])
def test_at_rest_on_a_slope_the_accelerometer_shows_it(roll: float, pitch: float) -> None:
    motion = on_a_plane(np.zeros((401, 3)), roll, pitch)
    rng = np.random.default_rng
    imu = read_imu(motion, sample_times(2.0, 100.0), 100.0, ALPHA, SILENT, SILENT, rng(0), rng(1))
    # Nose down (pitch > 0), gravity pulls forward and the accelerometer reads backward.
    expected = GRAVITY * np.array(
        [-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)]
    )
    assert np.allclose(imu.series.linear_acceleration, expected @ ALPHA.imu_rotation, atol=1e-12)
    assert np.allclose(imu.series.angular_velocity, 0.0, atol=1e-12)


@settings(max_examples=30)
@given(
    roll=st.floats(-0.7, 0.7),
    pitch=st.floats(-0.7, 0.7),
    w=st.floats(-3.0, 3.0),
    v=st.floats(-2, 2),
)
def test_a_circle_on_a_plane_has_no_rates_of_roll_and_pitch(roll, pitch, w, v):
    motion = on_a_plane(np.tile([v, 0.0, w], (1001, 1)), roll, pitch)
    times = sample_times(5.0, 130.0)
    assert np.allclose(angular_velocities(motion, times, 1.0 / 130.0), [0.0, 0.0, w], atol=1e-10)
    # In the plane's axes nothing is new but the pull along the slope: gravity of constant size turns.
    forces = specific_forces(motion, times, 1.0 / 130.0, (0.0, 0.0, 0.0))
    flat = specific_forces(moved(motion.twists, None), times, 1.0 / 130.0, (0.0, 0.0, 0.0))
    yaw = motion.poses_at(times)[:, 2]
    x, y, z = rpy_to_matrix(roll, pitch, 0.0).T @ DOWN
    cos, sin = np.cos(yaw), np.sin(yaw)
    pull = np.stack([cos * x + sin * y, cos * y - sin * x, np.full_like(yaw, z)], axis=-1)
    assert np.allclose(forces, flat + DOWN - pull, atol=1e-9)


def test_over_a_crest_the_robot_pitches_and_weighs_less() -> None:
    speed, radius = 2.0, 10.0
    t = np.arange(0.0, 5.0 + 0.5 / RATE, 1.0 / RATE)
    # Nose up before the top, nose down after it.
    pitch = speed / radius * (t - 2.5)
    gravity = GRAVITY * np.stack([np.sin(pitch), np.zeros_like(t), -np.cos(pitch)], axis=-1)
    motion = moved(np.tile([speed, 0.0, 0.0], (len(t), 1)), gravity)
    times = np.arange(0.5, 4.5, 0.05)
    rates = angular_velocities(motion, times, 0.01)
    # Linear interpolation of gravity between grid points errs by (pitch rate x step)² / 8.
    assert np.allclose(rates, [0.0, speed / radius, 0.0], atol=1e-5)
    forces = specific_forces(motion, times, 0.01, (0.0, 0.0, 0.0))
    at = speed / radius * (times - 2.5)
    assert np.allclose(forces[:, 0], -GRAVITY * np.sin(at), atol=1e-4)
    assert np.allclose(forces[:, 2], GRAVITY * np.cos(at) - speed**2 / radius, atol=1e-4)
    # A metre above the ground the circle is larger by a metre.
    above = specific_forces(motion, times, 0.01, (0.0, 0.0, 1.0))
    inward = (radius + 1.0) * (speed / radius) ** 2
    assert np.allclose(above[:, 2], GRAVITY * np.cos(at) - inward, atol=1e-3)
