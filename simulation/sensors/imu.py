"""Gyro and accelerometer readings of a true motion.

A reading is T u + n + b, cut off at the range: the true quantity u in the IMU's axes, a triad T with
errors of scale and alignment, white noise n and a bias b. Noise is a density (per root second). If an
IMU samples twice as often, each sample's noise is larger by the root of two, and the noise of their
integral stays. Every parameter has its own random numbers, so that changing one changes no other error.

A bias is the sum of three parts: the turn-on bias (of the gyro about that of the robot file), a random
walk (rate or acceleration random walk, K), and the bias instability B. A data sheet reads B off the Allan
deviation of the sensor, whose floor is sqrt(2 ln 2 / pi) B = 0.664 B for flicker noise (IEEE Std
952-1997, annex C). Flicker noise has no finite model. As usual a first-order Gauss-Markov process of
correlation time T approximates it, scaled so that its Allan deviation peaks at that floor. With
x = tau / T its Allan variance is

    sigma_b² (2 / x) (1 - (3 - 4 e^-x + e^-2x) / (2 x))

(the same annex, with q_c² T = 2 sigma_b²). It peaks at tau = 1.89 T, where the Allan deviation is
0.617 sigma_b, so sigma_b = 0.664 B / 0.617 = 1.076 B.
"""

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.log.series import ImuSeries
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.base.sampling import to_stamps
from icreckon.simulation.truth.true_motion import TrueMotion, gauss_markov

# Floor of the Allan deviation over bias instability, for flicker noise.
INSTABILITY_FLOOR = float(np.sqrt(2.0 * np.log(2.0) / np.pi))
# Peak of a Gauss-Markov process' Allan deviation over its standard deviation.
MARKOV_PEAK = 0.617364


class InertialErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of a gyro (unit: rad/s) or an accelerometer (unit: m/s²).

    Attributes:
        noise_density: white noise of each axis, N [unit/√Hz].
        bias_sigma: standard deviation of each axis' bias at turn-on [unit].
        bias_instability: B of the data sheet; the Allan deviation has its floor at 0.664 B [unit].
        bias_instability_time: correlation time of the process that approximates it [s]; the floor is
            at 1.89 times this.
        bias_walk: random walk of the bias, K [unit/√s].
        scale_sigma: standard deviation of each axis' relative error of scale [-].
        misalignment_sigma: standard deviation of each of the six small angles by which an axis leans
            towards another one [rad].
        range: largest reading of an axis; beyond, it saturates [unit].
    """

    noise_density: float = 0.0
    bias_sigma: float = 0.0
    bias_instability: float = 0.0
    bias_instability_time: float = 100.0
    bias_walk: float = 0.0
    scale_sigma: float = 0.0
    misalignment_sigma: float = 0.0
    range: float = np.inf


@dataclass(frozen=True)
class Imu:
    """IMU readings, and the part of them that is bias."""

    series: ImuSeries  # the samples
    gyro_bias: Floats  # (n, 3) in the IMU's axes [rad/s]
    accelerometer_bias: Floats  # (n, 3) in the IMU's axes [m/s²]


def perfect_imu(
    motion: TrueMotion, times: Floats, rate: float, robot: Robot
) -> tuple[Floats, Floats]:
    """IMU readings without errors, for its place and mounting in the robot file.

    Both are means over the interval that ends at each of `times` (n,) [s], with a `rate` in Hz, as the
    filter takes them. The gyro reads `gyro_scale` times the rate.

    Returns:
        Angular velocities (n, 3) times `gyro_scale` [rad/s], and specific forces (n, 3) [m/s²].
    """
    # Rows times a matrix: v^T R is (R^T v)^T, from base_link to the IMU's axes.
    to_imu, window = robot.imu_rotation, 1.0 / rate
    middles = np.maximum(times - 0.5 * window, 0.0)
    rates = angular_velocities(motion, middles, window) @ to_imu
    forces = specific_forces(motion, middles, window, robot.imu.position) @ to_imu
    return robot.imu.gyro_scale * rates, forces


def with_inertial_errors(
    perfect: tuple[Floats, Floats],
    times: Floats,
    rate: float,
    robot: Robot,
    gyro: InertialErrors,
    accelerometer: InertialErrors,
    gyro_rng: Generator,
    accelerometer_rng: Generator,
) -> Imu:
    """Add IMU errors to error-free readings; x and y of "z" gyros become zero.

    The `perfect` readings are those of `perfect_imu`, at `times` (n,) [s], with a `rate` in Hz. Gyro
    and accelerometer have a generator each, which draws their errors.
    """
    rates, forces = perfect
    # The bias of the robot file is about the vertical of base_link.
    usual_bias = robot.imu.gyro_bias * robot.imu_rotation[2]
    angular_velocity, gyro_bias = _with_errors(rates, rate, gyro, gyro_rng, usual_bias)
    force, force_bias = _with_errors(forces, rate, accelerometer, accelerometer_rng, np.zeros(3))
    if robot.imu.gyro_axes == "z":
        angular_velocity[:, :2] = 0.0
    return Imu(ImuSeries(to_stamps(times), angular_velocity, force), gyro_bias, force_bias)


def angular_velocities(motion: TrueMotion, times: Floats, window: float) -> Floats:
    """Angular velocity (n, 3) of base_link in its own axes [rad/s], at times (n,) [s].

    It is averaged over an interval, the `window` [s] about each time. About z it is the true yaw rate.
    About x and y it is the rotation of the ground under the robot, which turns gravity G in axes that
    follow the body but not its turns about z: dG_x/dt = -G_z omega_y and dG_y/dt = G_z omega_x. On a
    plane G is constant, however the robot turns on it.
    """
    start, end = motion.window(times, window)
    w = (motion.turns_at(end) - motion.turns_at(start)) / (end - start)
    rates = np.stack([np.zeros_like(w), np.zeros_like(w), w], axis=-1)
    if motion.gravity is not None:
        before, now, after = (
            _unturned_gravity(motion, motion.gravity, instants) for instants in (start, times, end)
        )
        change = (after - before)[:, :2] / (end - start)[:, None] / now[:, 2:]
        x_change, y_change = change.T
        unturned_rates = np.stack([y_change, -x_change], axis=-1)
        rates[:, :2] = rotate(unturned_rates, -motion.turns_at(times))
    return rates


def specific_forces(
    motion: TrueMotion, times: Floats, window: float, position: tuple[float, float, float]
) -> Floats:
    """Specific force (n, 3) in base_link's axes at a point fixed to it [m/s²].

    Acceleration of base_link, dv/dt + omega x v, plus domega/dt x r + omega x (omega x r), less the
    acceleration of gravity. `position` is r in base_link [m]; accelerations at `times` (n,) [s] are
    averaged over the interval `window` [s].
    """
    a_x, a_y, w_rate = motion.accelerations_at(times, window).T
    omega = angular_velocities(motion, times, window)
    v_x, v_y, _ = motion.twists_at(times).T
    acceleration = np.stack([a_x, a_y, omega[:, 0] * v_y - omega[:, 1] * v_x], axis=-1)
    omega_rate = np.stack([np.zeros_like(w_rate), np.zeros_like(w_rate), w_rate], axis=-1)
    gravity = np.array([0.0, 0.0, -GRAVITY])
    if motion.gravity is not None:
        start, end = motion.window(times, window)
        before = angular_velocities(motion, start, window)
        after = angular_velocities(motion, end, window)
        omega_rate[:, :2] = (after - before)[:, :2] / (end - start)[:, None]
        gravity = _unturned_gravity(motion, motion.gravity, times)
        gravity[:, :2] = rotate(gravity[:, :2], -motion.turns_at(times))
    r = np.array(position)
    # omega x (omega x r), by the rule for double cross products.
    inward = omega * (omega @ r)[:, None] - r * (omega**2).sum(axis=1)[:, None]
    return np.asarray(acceleration + np.cross(omega_rate, r) + inward - gravity)


def _unturned_gravity(motion: TrueMotion, gravity: Floats, times: Floats) -> Floats:
    """Gravity (n, 3) in axes that follow the body but not its turns about z [m/s²]."""
    grid = np.arange(len(gravity)) / motion.rate
    turns = motion.poses[:, 2] if motion.turns is None else motion.turns
    unturned = np.column_stack([rotate(gravity[:, :2], turns), gravity[:, 2]])
    return np.stack([np.interp(times, grid, column) for column in unturned.T], axis=-1)


def _with_errors(
    true: Floats, rate: float, errors: InertialErrors, rng: Generator, usual_bias: Floats
) -> tuple[Floats, Floats]:
    """Readings (n, 3) of true values (n, 3) in the sensor's axes, and bias [unit].

    Samples have a `rate` [Hz]; the turn-on bias is drawn about the usual one (3,).
    """
    constants, instabilities = rng.spawn(2)
    count = len(true)
    turn_on_bias = usual_bias + errors.bias_sigma * rng.standard_normal(3)
    white_draws, walk_draws = np.moveaxis(rng.standard_normal((count, 2, 3)), 1, 0)
    bias = np.zeros((count, 3))
    if errors.bias_instability > 0.0:
        unit = gauss_markov(count, 1.0 / rate, errors.bias_instability_time, instabilities)
        bias += INSTABILITY_FLOOR / MARKOV_PEAK * errors.bias_instability * unit
    scale = 1.0 + errors.scale_sigma * constants.standard_normal(3)
    misalignment = errors.misalignment_sigma * constants.standard_normal((3, 3))
    triad = np.where(np.eye(3, dtype=bool), np.diag(scale), misalignment)
    walk_steps = errors.bias_walk / np.sqrt(rate) * walk_draws[1:]
    bias += np.cumsum(np.vstack([turn_on_bias, walk_steps]), axis=0)
    reading = errors.noise_density * np.sqrt(rate) * white_draws + bias
    # T u, column by column: a matrix product would sum in another order, and so round differently.
    for column, true_axis in zip(triad.T, true.T, strict=True):
        reading += true_axis[:, None] * column
    return np.clip(reading, -errors.range, errors.range), bias
