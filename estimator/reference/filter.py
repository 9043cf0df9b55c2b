"""Events of the textbook filter: track speeds, IMU samples, position fixes.

A step goes from one IMU sample to the next. The IMU measures the twist of the step, not the pose at its
end. So the twist is predicted and updated at the start of the step, and then moves the pose.
"""

import math
from collections.abc import Sequence

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.filter.filter_record import (
    FilterRecord,
    may_be_pushed,
    take_silence,
    take_track_speeds,
)
from icreckon.estimator.filter.gate import CHI_SQUARE_1E4, LONGEST_COUNTED
from icreckon.estimator.filter.initial_state import assumptions
from icreckon.estimator.filter.process_noise import (
    UNKNOWN_YAW,
    Disturbances,
    change_density,
    lasting_slip,
    share_of_walk,
    slip_times,
    travel_speed,
)
from icreckon.estimator.log.measurements import (
    ImuSample,
    Measurement,
    PositionFix,
    TrackSpeeds,
    Vector3,
)
from icreckon.estimator.motion.motion_model import TwistModel
from icreckon.estimator.motion.propagation import downward_gravity, gauss_markov
from icreckon.estimator.reference.ekf import IcrEkf, ProcessNoise
from icreckon.estimator.reference.imu import StepTwist, accelerometer, gyro
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.sensors import imu_clock, predictions
from icreckon.estimator.sensors.held_tracks import mean_speeds
from icreckon.estimator.sensors.imu_noise import measure_noise, measured_noise, noise_of_step
from icreckon.estimator.sensors.imu_tilt import add_rates
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.sensor_models import STANDSTILL_VARIANCE, SensorModels
from icreckon.estimator.sensors.standstill import QuietReadings
from icreckon.estimator.sensors.step_inputs import StepInputs, step_inputs, track_change


class ReferenceFilter:
    """Textbook filter of one robot and variant, without gates and monitors.

    Args:
        robot: the robot.
        variant: name of a filter variant.
        start: pose at the first track speeds: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].

    Attributes:
        ekf: state and covariance.
    """

    def __init__(
        self,
        robot: Robot,
        variant: str,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        of_variant, settings = find_variant(variant), Settings()
        model, state, sigmas, self._disturbances = assumptions(robot, of_variant, settings)
        state[s.POSE], sigmas[s.POSE] = start, start_sigma
        self.ekf = IcrEkf(model)
        self.ekf.regressors = np.zeros((3, s.REGRESSOR_COUNT))
        self.ekf.x, self.ekf.P = state, np.diag(sigmas**2)
        self._settings, self._uses_force = settings, of_variant.accelerometers
        self._sensors = SensorModels(robot)
        self._record = FilterRecord(input_settings(robot, settings))
        self._readings, self._fix_stamp = QuietReadings(), 0

    def take(self, m: Measurement) -> None:
        """Update with one measurement, not older than the one before.

        Raises:
            EstimatorError: a measurement of another kind, or an outlier.
        """
        match m:
            case TrackSpeeds():
                self._take_track_speeds(m)
            case ImuSample():
                self._take_imu(m)
            case PositionFix():
                self._take_position(m)
            case _:
                raise EstimatorError(f"the textbook filter takes no {type(m).__name__}")

    def _take_track_speeds(self, m: TrackSpeeds) -> None:
        begins = self._record.tracks.stamp < 0
        take_track_speeds(self._record, m.stamp, m.left, m.right)
        if begins:
            # The robot may be moving already, with a slip.
            self._record.stamp = m.stamp
            self.ekf.P[s.SLIP, s.SLIP] += np.diag(np.square(self._slip_sigma(pushed=False)))

    def _take_imu(self, m: ImuSample) -> None:
        record, ekf = self._record, self.ekf
        if record.tracks.stamp < 0:
            # The motion is unknown, not at rest.
            record.imu.stamp = m.stamp
            return
        rates = self._sensors.rates(np.array(m.angular_velocity))
        rate, tilt_rates = rates.item(0), rates[1:3]
        if not self._uses_force or m.linear_acceleration is None:
            # Slopes would depend on the gyros alone.
            tilt_rates *= math.nan
        force = m.linear_acceleration or (math.nan, math.nan, math.nan)
        along = self._sensors.along_ground_of(np.array(force)).tolist()
        imu_clock.take_stamp(record.imu, m.stamp, self._settings.hold)
        tilt_density = add_rates(record.tilt, record.imu.interval, rate, *tilt_rates.tolist())
        measure_noise(record.noise, m.stamp, rate, along[0], along[1], self._settings.hold)
        spread, still = measured_noise(record.noise.gyro), record.still
        silent = take_silence(record, m.stamp)
        mean = self._readings.mean(still, m.stamp, rate, spread, silent, record.settings)
        noise, record.stands = noise_of_step(record.noise, still, record.settings), mean == mean
        if record.stands:
            rate = self._readings.rates.item(still.first)
        # Predict the twist of the step: a new fast slip, and smoothed derivatives by the parameters.
        dt = (m.stamp - record.stamp) * NANOSECOND
        left, right, missing = self._mean_speeds(m.stamp)
        if dt > 0.0:
            ekf.x[s.FAST_SLIP] = 0.0
            ekf.begin_step(dt, left, right)
            ekf.renew_fast_slip(self._density(m.stamp) / dt)
        # Update with what the IMU shows of it: standstill, yaw rate, specific force.
        if record.stands:
            twist = self._twist(m.stamp)
            v_x, v_y, w = STANDSTILL_VARIANCE
            w += self._inputs(m.stamp).creep_density / record.imu.interval
            self._update(-twist.twist, twist.jacobian, (v_x, v_y, w))
        inputs, x = self._inputs(m.stamp), ekf.x.copy()
        at = StepTwist(self._twist(m.stamp), x, record.imu.interval, track_change(inputs), noise)
        # The slip stands in for parameters and gravity, which the gyro does not move: so the estimated
        # yaw rate follows it also where they are wrong.
        z, H, R = gyro(rate, at, ekf.turn)
        ekf.update_scalar(z.item(), H[0], R.item(), fixed=ekf.fixed_for_gyro, stand_in=s.SLIP_W)
        if self._uses_force and m.linear_acceleration is not None:
            sigma, slip = self._slip_sigma(), self._disturbances.slip
            for axis in range(2):
                density = change_density(sigma[axis], slip.time_constant)
                position = self._sensors.imu_position
                z, H, R = accelerometer(position, axis, along[axis], at, ekf.x, density)
                ekf.update_scalar(z.item(), H[0], R.item(), fixed=ekf.fixed_for_imu)
        ekf.keep_inside_bounds(by_imu=True)
        # Propagate the pose by the updated twist.
        if dt > 0.0:
            speeds, sigma = (inputs.smooth_left, inputs.smooth_right), self._slip_sigma()
            tilt = downward_gravity(ekf.x[s.GRAVITY].tolist()) * math.sqrt(tilt_density)
            noise_of = process_noise(self._disturbances, speeds, sigma, inputs.turn_density, tilt)
            tilting = (tilt_rates.item(0), tilt_rates.item(1))
            ekf.predict_motion(dt, left + missing, right + missing, noise_of, tilting)
            record.stamp = m.stamp

    def _take_position(self, m: PositionFix) -> None:
        """Update with a fix, at the end of a step or ahead of the next one."""
        ekf, record = self.ekf, self._record
        elapsed = (m.stamp - record.stamp) * NANOSECOND
        predicted = predictions.pose_now(ekf.x)
        if elapsed > 0.0:
            density = self._density(m.stamp)
            predicted = predictions.pose_ahead(ekf.x, self._twist(m.stamp), density, elapsed)
        # The slip that has faded since the last fix may have lasted.
        interval = (m.stamp - self._fix_stamp) * NANOSECOND if self._fix_stamp else 0.0
        self._fix_stamp, yaw = m.stamp, predicted.values.item(s.YAW)
        heading = math.cos(yaw), math.sin(yaw)
        lasted = lasting_slip(ekf.x.item(s.SLIP_X), heading, min(LONGEST_COUNTED, interval))
        states = np.ix_((s.X, s.Y, s.SLIP_X), (s.X, s.Y, s.SLIP_X))
        ekf.P[states] += np.outer(lasted, lasted)
        place = (m.forward, m.left, m.up)
        values, rows, noise = predictions.point_on_robot(predicted, ekf.x[s.GRAVITY], place)
        # What the linearised arm omits by the variance of the yaw, see `engine.fixes`.
        bent = min(ekf.P.item(s.YAW, s.YAW), UNKNOWN_YAW) * rows[:2, s.YAW]
        variance = m.variance + float(bent @ bent)
        # Only the motion ahead of the IMU correlates x and y, a little: the update omits that.
        z, H, R = (
            np.array((m.x, m.y)) - values[:2],
            rows[:2],
            noise[:2, :2] + variance * np.eye(2),
        )
        nis = float(z @ np.linalg.solve(H @ ekf.P @ H.T + R, z))
        if nis > CHI_SQUARE_1E4[2]:
            raise EstimatorError(f"the fix at {m.stamp} is an outlier: its NIS is {nis:.1f}")
        self._update(z, H, R.diagonal().tolist(), fixed=())
        ekf.keep_inside_bounds()

    def _update(
        self, z: Floats, H: Floats, R: Sequence[float], fixed: tuple[int, ...] | None = None
    ) -> None:
        """Update with each component in turn, linearised at the state before the first."""
        ekf, x = self.ekf, self.ekf.x.copy()
        fixed = ekf.fixed_for_gyro if fixed is None else fixed
        for one, h, r in zip(z.tolist(), H.copy(), R, strict=True):
            ekf.update_scalar(one - float(h @ (ekf.x - x)), h, float(r), fixed=fixed)

    def _mean_speeds(self, stamp: int) -> tuple[float, float, float]:
        record = self._record
        return mean_speeds(record.tracks, record.stamp, stamp, record.settings.hold_ns)

    def _twist(self, stamp: int) -> TwistModel:
        """Mean body velocity, and its derivatives, of the step to a stamp [ns]."""
        dt = max(0, stamp - self._record.stamp) * NANOSECOND
        x, y, w = slip_times(self._disturbances.slip.time_constant, 1.0)
        means = (gauss_markov(dt, x).mean, gauss_markov(dt, y).mean, gauss_markov(dt, w).mean)
        return self.ekf.twist_model(*self._mean_speeds(stamp)[:2], means)

    def _inputs(self, stamp: int) -> StepInputs:
        record = self._record
        return step_inputs(record.tracks, record.still, record.stamp, stamp, record.settings)

    def _slip_sigma(self, *, pushed: bool | None = None) -> Vector3:
        record, eta = self._record, self.ekf.model.steering_efficiency(self.ekf.x[s.PARAMETERS])
        if pushed is None:
            pushed = not record.stands and may_be_pushed(record)
        return self._disturbances.slip_sigma(record.tracks, eta, pushed=pushed)

    def _density(self, stamp: int) -> Floats:
        """Density (3, 3) of the fast slip."""
        by_speeds, sigma = self._twist(stamp).by_speeds, self._slip_sigma()
        dt = max(0, stamp - self._record.stamp) * NANOSECOND
        return self._disturbances.fast_slip_density(self._inputs(stamp), by_speeds, sigma, dt)


def process_noise(
    disturbances: Disturbances,
    speeds: tuple[float, float],
    sigma: Vector3,
    turn_density: float = 0.0,
    tilt_walk: float = 0.0,
) -> ProcessNoise:
    """Process noise of a step.

    The random walk of the parameters has its full rate in turns, where they are observable, and none when
    driving straight or standing. The slope changes with the distance that the tracks travel.

    Args:
        disturbances: process noise of the filter.
        speeds: smoothed speeds of the left and the right track [m/s].
        sigma: standard deviation of the slip [m/s, m/s, rad/s].
        turn_density: error density of the yaw of a robot that may turn while it rests [rad²/s].
        tilt_walk: random walk of gravity by the noise of the rates of roll and pitch [m/s²/√s].
    """
    travel = travel_speed(*speeds)
    walk = disturbances.bias_walk + disturbances.parameter_walk * share_of_walk(*speeds)
    walk += disturbances.slope_walk * math.sqrt(travel)
    walk[s.GRAVITY] = np.hypot(walk[s.GRAVITY], tilt_walk)
    walk[s.YAW] = math.sqrt(turn_density)
    times = slip_times(disturbances.slip.time_constant, 1.0)
    forgetting = disturbances.slope_forgetting * travel
    return ProcessNoise(np.array(sigma), times, walk, forgetting)
