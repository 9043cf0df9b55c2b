"""Process noise: slip, errors of the track speeds, and random walks.

The functions are written for plain Python, for numba (`icreckon.estimator.tracing.jit_kernel`) and,
traced, for lanes (`icreckon.estimator.engine.model`).
"""

import math
from typing import Any

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.choices import select
from icreckon.estimator.log.measurements import Vector3
from icreckon.estimator.motion.propagation import gauss_markov
from icreckon.estimator.robot.robot_file import Robot, Slip, slip_components
from icreckon.estimator.sensors.held_tracks import TrackRecord
from icreckon.estimator.sensors.sensor_models import STANDSTILL_VARIANCE
from icreckon.estimator.sensors.step_inputs import StepInputs

PUSHED_W = 0.3  # yaw rate of a robot that is pushed with its tracks at rest [rad/s]
FULL_TURNING = 0.1  # difference of track speeds from which parameters walk in full [m/s]
GROUND_TIME = 1.0  # correlation time of the slip that other ground adds [s]
SIDEWAYS_IN_GAP = 0.1  # sideways motion that may begin in a gap, as a share of forward motion
# Variance of a yaw of which nothing is known, uniform over a whole turn [rad²].
UNKNOWN_YAW = math.pi**2 / 3.0


class Disturbances:
    """Process noise of a robot and filter variant; walks are (SIZE,), mostly zero."""

    def __init__(self, robot: Robot, slip: Slip, parameter_walk: Floats) -> None:
        self.slip = slip
        self._track_gauge = robot.vehicle.track_gauge
        self.bias_walk = np.zeros(s.SIZE)  # random walk of the biases, per √s
        self.bias_walk[s.GYRO_BIAS] = robot.imu.gyro_bias_walk
        self.bias_walk[s.ACCELEROMETER_BIASES] = robot.imu.accelerometer_bias_walk
        slope = robot.slope
        self.slope_walk = np.zeros(s.SIZE)  # random walk of gravity, per √m of travel
        self.slope_walk[s.GRAVITY] = slope.walk if slope.sigma > 0.0 else 0.0
        # Rate of forgetting [1/m]: a Gauss-Markov process in the distance, of this standard deviation.
        self.slope_forgetting = 0.5 * (slope.walk / slope.sigma) ** 2 if slope.sigma > 0.0 else 0.0
        self.parameter_walk = np.zeros(s.SIZE)  # random walk of the parameters in turns, per √s
        self.parameter_walk[s.PARAMETERS] = parameter_walk

    def slip_sigma(
        self, tracks: TrackRecord, eta: float, *, pushed: bool, factor: float = 1.0
    ) -> Vector3:
        """Standard deviation of the slip at the present track speeds, see `slip_at`.

        It depends on smoothed speeds, as the random walk of the parameters does. If it followed the noise
        of the speeds, the samples with the most information on the parameters would get the least weight.
        """
        left, right = tracks.smooth_left, tracks.smooth_right
        return slip_at(left, right, self.slip, self._track_gauge, eta, pushed, factor)

    def fast_slip_density(
        self, inputs: StepInputs, by_speeds: Floats, sigma: Vector3, dt: float
    ) -> Floats:
        """(3, 3) density of the fast slip over a step.

        It is the sum of errors of the track speeds, of their delay, of the slip of w that is white or
        begins within the step (`sigma` [m/s, m/s, rad/s]), of stale speeds, and of slides. `by_speeds`
        (3, 2) is the derivative of the twist by the track speeds, `dt` the length of the step [s].
        """
        integral = gauss_markov(dt, self.slip.time_constant).integral
        white = white_density(self.slip.white_time, integral, dt)
        sigma_w = inputs.speed_decay * sigma[2]
        return np.array(fast_slip_density(inputs, by_speeds.tolist(), white, sigma_w, dt))


def slip_at(
    left: float, right: float, slip: Any, gauge: float, eta: float, pushed: bool, factor: float
) -> Vector3:
    """Standard deviation of the slip [m/s, m/s, rad/s].

    Args:
        left: speed of the left track [m/s].
        right: speed of the right track [m/s].
        slip: a `Slip`, or a record with its fields.
        gauge: L [m].
        eta: typical steering efficiency index [-].
        pushed: the robot may be turning with its tracks at rest.
        factor: factor on the slip that the fixes have shown, see `filter.slip_factor`.
    """
    forward, sideways, turning = slip_components(left, right, slip, gauge * max(1.0, eta))
    return factor * forward, factor * sideways, select(pushed, PUSHED_W, factor * turning)


def slip_times(time_constant: float, factor: float) -> Vector3:
    """Correlation times of the slip of v_x, v_y and w [s] with a factor on the slip.

    `time_constant` [s] is of slip in bends. Slip of v_x that the factor adds lasts longer, as long as the
    robot is on that ground: its time is the mean of both, weighted by their variances. A lasting slip of
    v_y could be an error of the yaw, one of w the gyro's bias: their times do not change.
    """
    own_share = 1.0 / (factor * factor)
    mean = own_share * time_constant + (1.0 - own_share) * GROUND_TIME
    return mean, time_constant, time_constant


def lasting_slip(slip: Any, heading: tuple[Any, Any], interval: Any) -> tuple[Any, Any, Any]:
    """Errors of x, y [m] and slip [m/s] if a slip of v_x has lasted an interval [s]."""
    lasting = slip * min(1.0, interval / GROUND_TIME)
    distance = 0.5 * interval * lasting
    return heading[0] * distance, heading[1] * distance, lasting


def change_density(sigma: float, time_constant: float) -> float:
    """Density of the change of a slip of this standard deviation [m²/s³]."""
    return 2.0 * (sigma * sigma) / time_constant


def white_density(white_time: float, integral: float, dt: float) -> Any:
    """Density of the slip of w within a step, for a slow slip of unit variance [s].

    It is the sum of the white part of the slip, of `white_time` [s], and of the slow slip that begins
    within the step of `dt` [s]: its noise adds `integral` [s²] to the integral, see `GaussMarkov`.
    """
    return 2.0 * white_time + integral / select(dt > 0.0, dt, 1.0)


def fast_slip_density(
    inputs: Any, by_speeds: Any, white: float, sigma_w: float, dt: float
) -> tuple[Vector3, Vector3, Vector3]:
    """(3, 3) density of the fast slip; see `Disturbances.fast_slip_density`.

    `inputs` is a `StepInputs`, or a record with its densities; `white` is by `white_density` [s], and
    `sigma_w` the standard deviation of the slip of w [rad/s].
    """
    left, right, gap = inputs.left_density, inputs.right_density, inputs.gap_density
    x, y, w = by_speeds[0], by_speeds[1], by_speeds[2]
    xy = left * x[0] * y[0] + right * x[1] * y[1]
    xw = left * x[0] * w[0] + right * x[1] * w[1]
    yw = left * y[0] * w[0] + right * y[1] * w[1]
    xx = left * (x[0] * x[0]) + right * (x[1] * x[1])
    xx += gap + inputs.slide_x_density
    yy = left * (y[0] * y[0]) + right * (y[1] * y[1])
    yy += gap * (SIDEWAYS_IN_GAP * SIDEWAYS_IN_GAP) + inputs.slide_y_density
    ww = left * (w[0] * w[0]) + right * (w[1] * w[1])
    ww += white * (sigma_w * sigma_w) + inputs.late_density
    # A density of the mean speed is twice as large for each track. Over the step, the gap adds at most
    # `UNKNOWN_YAW` to the variance of the yaw.
    gap_density_w = 2.0 * gap * (w[0] * w[0] + w[1] * w[1])
    ww += gap_density_w * (UNKNOWN_YAW / max(UNKNOWN_YAW, gap_density_w * dt))
    return (xx, xy, xw), (xy, yy, yw), (xw, yw, ww)


def twist_covariance(jacobian: Floats, P: Floats, fastest: float) -> Floats:
    """(3, 3) covariance of the body velocity, by its Jacobian (3, n) and P (n, n).

    The covariance of a standing robot, whose slip is zero in the model, is added.
    """
    covariance = np.asarray(jacobian @ P @ jacobian.T) + np.diag(STANDSTILL_VARIANCE)
    of_x, of_y = (share_of_sigma(covariance.item(axis, axis), fastest) for axis in (0, 1))
    shares = np.array([of_x, of_y, 1.0])
    return covariance * np.outer(shares, shares)


def share_of_sigma(variance: Any, fastest: Any) -> Any:
    """Factor that bounds the sigma of v_x or v_y by the highest track speed [m/s].

    White fast slip that stands for a speed unknown for long has the error of the path, but a larger
    variance than the speed.
    """
    limit = fastest * fastest
    return fastest / math.sqrt(select(variance > limit, variance, limit))


def share_of_walk(left: float, right: float) -> float:
    """Factor on the random walk of the parameters at these track speeds [m/s]."""
    return min(1.0, abs(right - left) / FULL_TURNING)


def travel_speed(left: float, right: float) -> float:
    """Mean distance per second that the tracks travel [m/s]."""
    return 0.5 * (abs(left) + abs(right))
