"""Gyro and accelerometer on ground that is not level."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icreckon.estimator.base.frames import rpy_to_matrix
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.simulation.base.sampling import sample_times
from icreckon.simulation.sensors.imu import (
    InertialErrors,
    angular_velocities,
    specific_forces,
)
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


def varied_twists(seconds: float = 20.0) -> np.ndarray:
    t = np.arange(0.0, seconds + 0.5 / RATE, 1.0 / RATE)
    return np.stack([0.5 + 0.3 * np.sin(t), 0.05 * np.cos(0.7 * t), 1.5 * np.sin(0.4 * t)], axis=-1)


def test_level_ground_is_the_same_with_and_without_gravity_stated() -> None:
    twists = varied_twists()
    times = sample_times(20.0, 100.0)
    place = (0.3, -0.2, 0.5)
    level = moved(twists, np.tile(DOWN, (len(twists), 1)))
    for read in (
        lambda motion: specific_forces(motion, times, 0.01, place),
        lambda motion: angular_velocities(motion, times, 0.01),
    ):
        assert np.allclose(read(level), read(moved(twists, None)), atol=1e-12)


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
def test_a_circle_on_a_plane_has_no_rates_of_roll_and_pitch(
    roll: float, pitch: float, w: float, v: float
) -> None:
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


def attitudes(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (m, 3, 3) from body to world of a robot that rolls, pitches and turns, and w (m,)."""
    roll, pitch = 0.2 * np.sin(0.9 * t + 0.3), 0.25 * np.cos(0.7 * t)
    yaw = 0.8 * t + 0.4 * np.sin(0.5 * t)
    rotations = np.array([rpy_to_matrix(*angles) for angles in zip(roll, pitch, yaw, strict=True)])
    pitch_rate, yaw_rate = -0.175 * np.sin(0.7 * t), 0.8 + 0.2 * np.cos(0.5 * t)
    return rotations, -np.sin(roll) * pitch_rate + np.cos(roll) * np.cos(pitch) * yaw_rate


def body_rates(t: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Angular velocity (m, 3) in body axes, from how the rotations change."""
    before, now, after = (attitudes(t + change)[0] for change in (-step, 0.0, step))
    skew = np.einsum("nji,njk->nik", now, (after - before) / (2.0 * step))
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=-1)


def test_rates_and_forces_of_a_rolling_pitching_turning_robot() -> None:
    t = np.arange(0.0, 10.0 + 0.5 / RATE, 1.0 / RATE)
    rotations, w = attitudes(t)
    gravity = np.einsum("nji,j->ni", rotations, DOWN)
    v = np.stack([0.5 + 0.3 * np.sin(t), 0.1 * np.cos(t)], axis=-1)
    motion = moved(np.column_stack([v, w]), gravity)
    times = np.arange(0.5, 9.5, 0.05)
    omega = body_rates(times)
    assert np.allclose(angular_velocities(motion, times, 0.01), omega, atol=1e-4)

    # The acceleration of a place on the robot, in the world's axes, by differences of its velocity.
    place, step = np.array([0.3, -0.2, 0.5]), 1e-4

    def velocity(at: np.ndarray) -> np.ndarray:
        flat = np.stack([0.5 + 0.3 * np.sin(at), 0.1 * np.cos(at), np.zeros_like(at)], axis=-1)
        return np.einsum("nij,nj->ni", attitudes(at)[0], flat + np.cross(body_rates(at), place))

    world = (velocity(times + step) - velocity(times - step)) / (2.0 * step)
    expected = np.einsum("nji,nj->ni", attitudes(times)[0], world - DOWN)
    forces = specific_forces(motion, times, 0.01, tuple(place))
    assert np.allclose(forces, expected, atol=2e-3)
