"""The filter's model along a motion that is known: transition, noise, and what each sensor shows.

Along a known motion the covariance of the best linear estimate follows from the model alone, without a
measurement. `analysis.observability` and `analysis.cramer_rao` ask what it comes to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.filter.initial_state import assumptions
from icreckon.estimator.filter.process_noise import change_density
from icreckon.estimator.log.measurements import STANDSTILL_SIGMA, Vector3
from icreckon.estimator.motion.motion_model import TwistModel
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.reference.filter import process_noise
from icreckon.estimator.reference.imu import StepTwist, accelerometer, gyro
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.sensors.held_tracks import TrackRecord, take_tracks
from icreckon.estimator.sensors.imu_noise import noise_of_file
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.sensors.standstill import StandstillRecord
from icreckon.estimator.sensors.step_inputs import step_inputs, track_change


@dataclass(frozen=True)
class Sensors:
    """The sensors beside the tracks, and how good those are of which no robot file knows.

    Attributes:
        gyro: whether there is one.
        accelerometer: whether there are two, forward and to the left.
        position_sigma: of the coordinates of a position fix [m]; None for no fixes.
        heading_sigma: of the yaw of a fix [rad]; None for fixes without heading.
        velocity_sigma: of the components of a body velocity [m/s]; None for no such sensor.
        fix_interval: time between fixes [s].
        velocity_interval: time between body velocities [s].
    """

    gyro: bool = False
    accelerometer: bool = False
    position_sigma: float | None = None
    heading_sigma: float | None = None
    velocity_sigma: float | None = None
    fix_interval: float = 1.0
    velocity_interval: float = 0.1


class Shown(NamedTuple):
    """What one scalar measurement shows.

    Attributes:
        row: (SIZE,) derivative of the measurement by the state.
        variance: of its noise.
        kept: states that it does not move in the filter.
        stand_in: state that it moves in their place, `IcrEkf.update_scalar`.
    """

    row: Floats
    variance: float
    kept: tuple[int, ...] = ()
    stand_in: int | None = None


class LinearisedStep(NamedTuple):
    """One step of the model.

    Attributes:
        fast_slip: (3, 3) covariance of the fast slip that is drawn as the step begins.
        during: what the IMU shows of the step.
        transition: (SIZE, SIZE) derivative of the state after the step by that before; the fast slip
            stays.
        noise: (SIZE, SIZE) covariance of what disturbs the step, fast slip aside.
        after: what fixes and body velocity show at its end.
    """

    fast_slip: Floats
    during: list[Shown]
    transition: Floats
    noise: Floats
    after: list[Shown]


class LinearisedModel:
    """The filter's model of one robot and variant, linearised step by step along a known motion.

    Track speeds and IMU are in step, and a robot stands where both tracks are exactly zero. Steps must
    be begun and asked for in order: sensors look at how the track speeds change, and a motion model may
    remember how the robot has moved.

    Args:
        robot: the robot.
        variant: the filter variant.
        sensors: what there is beside the tracks.
        dt: length of a step [s].
        settings: of the pose estimator.
        as_filter: whether derivatives by the parameters are smoothed in time, as those of the filter, or
            are those of the moment.

    Attributes:
        start: (SIZE,) the state that the variant starts from.
        sigmas: (SIZE,) its standard deviations at the start; zero where nothing is estimated.
    """

    def __init__(
        self,
        robot: Robot,
        variant: Variant,
        sensors: Sensors,
        dt: float,
        settings: Settings | None = None,
        *,
        as_filter: bool = False,
    ) -> None:
        settings = settings or Settings()
        self._as_filter = as_filter
        model, self.start, self.sigmas, self._disturbances = assumptions(robot, variant, settings)
        self._ekf = IcrEkf(model)
        self._imu_constants = SensorModels(robot).constants
        self._tracks, self._inputs = TrackRecord(), input_settings(robot, settings)
        take_tracks(self._tracks, 0, 0.0, 0.0, self._inputs)
        self._sensors, self._dt, self._count = sensors, dt, 0

    def begin(self, x: Floats, left: float, right: float) -> None:
        """The next step begins.

        Args:
            x: (SIZE,) the true state as it begins.
            left: speed of the left track as measured over it [m/s].
            right: of the right track [m/s].
        """
        self._ekf.x = np.array(x, dtype=float)
        self._ekf.begin_step(self._dt, left, right)
        if self._as_filter:
            self._ekf.smooth_regressors(self._dt, left, right)

    def twist_model(self, x: Floats, left: float, right: float) -> TwistModel:
        """The body velocity and its derivatives at a state.

        Args:
            x: (SIZE,) the state.
            left: speed of the left track as measured [m/s].
            right: of the right track [m/s].
        """
        self._ekf.x = np.array(x, dtype=float)
        return self._ekf.twist_model(left, right)

    def step(
        self, x: Floats, left: float, right: float, after: Floats | None = None
    ) -> LinearisedStep:
        """The step that was begun.

        Args:
            x: (SIZE,) the true state as it begins, with the fast slip of the step.
            left: speed of the left track as measured over it [m/s].
            right: of the right track [m/s].
            after: (SIZE,) the true state at its end; None where it hardly differs.
        """
        tracks, dt = self._tracks, self._dt
        start = round(self._count * dt / NANOSECOND)
        self._count += 1
        end = round(self._count * dt / NANOSECOND)
        take_tracks(tracks, end, left, right, self._inputs)
        model = self.twist_model(x, left, right)
        eta = self._ekf.model.steering_efficiency(x[s.PARAMETERS])
        sigma = self._disturbances.slip_sigma(tracks, eta, pushed=False)
        inputs = step_inputs(tracks, StandstillRecord(), start, end, self._inputs)
        density = self._disturbances.fast_slip_density(inputs, model.by_speeds, sigma)
        smooth = tracks.smooth_left, tracks.smooth_right
        noise = process_noise(self._disturbances, smooth, sigma)
        during = self._during(x, model, sigma, start)
        self._ekf.x = np.array(x, dtype=float)
        self._ekf.predict_motion(dt, left, right, noise)
        F, Q = self._ekf.F, self._ekf.Q
        return LinearisedStep(
            density / dt,
            during,
            F,
            Q,
            self._after(x if after is None else after, left, right),
        )

    def _during(self, x: Floats, model: TwistModel, sigma: Vector3, now: int) -> list[Shown]:
        tracks, sensors = self._tracks, self._sensors
        shown = []
        stopped = tracks.left == 0.0 == tracks.right
        if stopped and sensors.gyro:
            kept = self._ekf.fixed_for_gyro
            shown += [Shown(model.jacobian[i], STANDSTILL_SIGMA[i] ** 2, kept) for i in range(3)]
        change = track_change(step_inputs(tracks, StandstillRecord(), now, now, self._inputs))
        at = StepTwist(model, x, self._dt, change, noise_of_file(self._inputs))
        if sensors.gyro:
            found = gyro(0.0, at)
            kept = self._ekf.fixed_for_gyro
            shown.append(Shown(found.H[0], found.R.item(), kept, s.SLIP_W))
        for axis in range(2 if sensors.accelerometer else 0):
            rough = change_density(sigma[axis], self._disturbances.slip.time_constant)
            found = accelerometer(self._imu_constants, axis, 0.0, at, x, rough)
            shown.append(Shown(found.H[0], found.R.item(), self._ekf.fixed_for_imu))
        return shown

    def _after(self, x: Floats, left: float, right: float) -> list[Shown]:
        sensors, shown = self._sensors, []
        if self._is_due(sensors.fix_interval):
            for state, sigma in (
                (s.X, sensors.position_sigma),
                (s.Y, sensors.position_sigma),
                (s.YAW, sensors.heading_sigma),
            ):
                if sigma is not None:
                    shown.append(Shown(np.eye(s.SIZE)[state], sigma**2))
        if sensors.velocity_sigma is not None and self._is_due(sensors.velocity_interval):
            rows = self.twist_model(x, left, right).jacobian
            shown += [Shown(rows[axis], sensors.velocity_sigma**2) for axis in (0, 1)]
        return shown

    def _is_due(self, interval: float) -> bool:
        return self._count % max(1, round(interval / self._dt)) == 0


def renewed(P: Floats, fast_slip: Floats) -> Floats:
    """The covariance (SIZE, SIZE) as a step begins, with a new fast slip of covariance (3, 3)."""
    P = P.copy()
    P[s.FAST_SLIP, :] = 0.0
    P[:, s.FAST_SLIP] = 0.0
    P[s.FAST_SLIP, s.FAST_SLIP] = fast_slip
    return P


def informed(P: Floats, shown: list[Shown], *, ruled: bool = False) -> Floats:
    """The covariance (SIZE, SIZE) after measurements, each used as well as can be.

    Args:
        P: (SIZE, SIZE) the covariance before.
        shown: the measurements.
        ruled: whether they keep what they do not move in the filter (Schmidt-Kalman; Joseph form).
    """
    for row, variance, of_filter, stand_in in shown:
        kept = of_filter if ruled else ()
        cross = P @ row
        expected = row @ cross + variance
        gain = cross / expected
        missing = row[list(kept)] @ gain[list(kept)]
        gain[list(kept)] = 0.0
        if stand_in is not None:
            gain[stand_in] += missing / row[stand_in]
        half = np.outer(gain, cross - 0.5 * expected * gain)
        P = P - half - half.T
    return P


def stepped(P: Floats, step: LinearisedStep, *, ruled: bool = False) -> Floats:
    """The covariance (SIZE, SIZE) after one more step.

    Args:
        P: before it.
        step: the step.
        ruled: whether the IMU keeps the states that it does not move in the filter; if not, this is the
            best linear estimate.
    """
    P = informed(renewed(P, step.fast_slip), step.during, ruled=ruled)
    return informed(step.transition @ P @ step.transition.T + step.noise, step.after)
