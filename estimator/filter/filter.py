"""Filter: predict, gate, update, record, one measurement at a time.

A step goes from one IMU sample to the next. The IMU measures the twist of the step, not the pose at its
end. So the twist is predicted and updated at the start of the step, and then moves the pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.records import NEVER
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.clones import Clones
from icreckon.estimator.filter.gate import Gate
from icreckon.estimator.filter.health import Health
from icreckon.estimator.filter.initial_state import assumptions, considered_states
from icreckon.estimator.filter.reacquisition import RejectedFix, relocation
from icreckon.estimator.filter.step_engine import StepEngine
from icreckon.estimator.filter.update import correct, update
from icreckon.estimator.log.input_checks import Event
from icreckon.estimator.log.measurements import (
    ImuSample,
    Mark,
    Measurement,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    Vector3,
)
from icreckon.estimator.motion.motion_model import TwistModel
from icreckon.estimator.motion.propagation import step_on_se2
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.sensors.held_tracks import HeldTrackSpeeds
from icreckon.estimator.sensors.imu_clock import ImuClock
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.measurement_models import (
    IMU_FIXED,
    MODELS,
    Accelerometer,
    Gyro,
    Linearised,
    MeasurementModel,
    Quantity,
    StepTwist,
    innovation_components,
)
from icreckon.estimator.sensors.predictions import (
    Prediction,
    pose_ahead,
    pose_now,
    twist_ahead,
    twist_now,
)
from icreckon.estimator.sensors.sensor_models import (
    STANDSTILL_VARIANCE,
    SensorModels,
)
from icreckon.estimator.sensors.standstill import StandstillDetector, stands
from icreckon.estimator.sensors.step_inputs import StepInputs, step_inputs, track_change


class Reckoning:
    """Filter of one robot and variant; its input are admitted measurements in order.

    Args:
        robot: the robot.
        variant: the filter variant.
        settings: settings that are no property of the robot.
        start: pose at the first track speeds: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].
        engine: factory of the filter's algebra.

    Attributes:
        ekf: the extended Kalman filter.
        stamp: time of the estimate [ns]; None before the first track speeds or fix.
        stands: the robot was found standing at the newest IMU sample.
        health: counts of the measurements.
        parameter_sigmas: (8,) initial standard deviations of the parameters.

    Raises:
        EstimatorError: a friction variant's robot has no contact with the ground, or
            `Settings.considered` has a name that the variant has not.
    """

    def __init__(
        self,
        robot: Robot,
        variant: Variant,
        settings: Settings,
        start: tuple[float, float, float],
        start_sigma: tuple[float, float, float],
        engine: StepEngine,
    ) -> None:
        model, state, sigmas, self._disturbances = assumptions(robot, variant, settings)
        self.parameter_sigmas = sigmas[s.PARAMETERS].copy()
        sigmas[s.POSE] = start_sigma
        self.ekf = engine.make_ekf(model)
        self.ekf.x = state
        self.ekf.x[s.POSE] = start
        self.ekf.P = np.diag(sigmas**2)
        self.ekf.considered = considered_states(variant, settings)

        self.stamp: int | None = None
        self.stands = False
        self.health = Health()
        self._settings = settings
        self._sensors = SensorModels(robot)
        self._gyro, self._accelerometer = Gyro(self._sensors), Accelerometer(self._sensors)
        # The fast slip of the next step has begun, and the pose is still at its start.
        self._step_under_way = False
        for_inputs = input_settings(robot, settings)
        self._tracks = HeldTrackSpeeds(settings=for_inputs)
        self._imu = ImuClock(hold=settings.hold)
        # Position fixes since one was used.
        self._rejected_fixes: tuple[RejectedFix, ...] = ()
        # Stamp of the newest zero velocity that was used.
        self._stood_at: int | None = None
        self._gates = {
            name: Gate(len(components), settings.gates)
            for name, components in innovation_components().items()
        }
        self._standstill = StandstillDetector(for_inputs)
        self._at_once = engine.make_step(
            self.ekf,
            self._disturbances,
            robot,
            settings,
            self._gates["gyro"],
            self._gates["accelerometer"],
        )

    @property
    def imu_interval(self) -> float:
        """Time between the newest two IMU samples [s]."""
        return self._imu.interval

    # --- checkpoints -----------------------------------------------------------------------------

    def checkpoint(self) -> FilterCheckpoint:
        """Copy the state of the filter and of its inputs."""
        return FilterCheckpoint(
            self.stamp,
            self.ekf.x.copy(),
            self.ekf.P.copy(),
            self._step_under_way,
            self.stands,
            self._tracks.memory(),
            self._standstill.memory(),
            self._imu.memory(),
            {name: gate.rejected_in_a_row for name, gate in self._gates.items()},
            self.health.copy(),
            self.ekf.clones,
            self.ekf.model.memory,
            None if self.ekf.regressors is None else self.ekf.regressors.copy(),
            self._rejected_fixes,
            self._stood_at,
        )

    def restore(self, checkpoint: FilterCheckpoint) -> None:
        """Restore a checkpoint."""
        self.stamp = checkpoint.stamp
        self.ekf.x = checkpoint.state.copy()
        self.ekf.P = checkpoint.covariance.copy()
        self.ekf.clones = checkpoint.clones
        self.ekf.model.recall(checkpoint.model)
        regressors = checkpoint.regressors
        self.ekf.regressors = None if regressors is None else regressors.copy()
        self._rejected_fixes = checkpoint.rejected_fixes
        self._stood_at = checkpoint.stood_at
        self._step_under_way = checkpoint.step_under_way
        self.stands = checkpoint.stands
        self._tracks.recall(checkpoint.tracks)
        self._standstill.recall(checkpoint.standstill)
        self._imu.recall(checkpoint.imu)
        for gate in self._gates.values():
            gate.rejected_in_a_row = 0
        for name, count in checkpoint.rejected_in_a_row.items():
            self._gates[name].rejected_in_a_row = count
        self.health = checkpoint.health.copy()

    def warm_start(self, checkpoint: FilterCheckpoint, off: float) -> None:
        """Start with parameters, biases and scales of a checkpoint.

        Args:
            checkpoint: of a filter of the same robot and variant.
            off: time since the checkpoint, over which the biases walk [s].
        """
        learnt = s.LEARNT
        self.ekf.x[learnt] = checkpoint.state[learnt]
        self.ekf.P[learnt, learnt] = checkpoint.covariance[learnt, learnt]
        self.ekf.P += np.diag(self._disturbances.bias_walk**2 * off)

    # --- outputs ---------------------------------------------------------------------------------

    @property
    def clones(self) -> Clones:
        """Stochastic clones, with the motion since each mark."""
        return self.ekf.clones or Clones.none()

    def model(self) -> TwistModel:
        """Body velocity and its derivatives now."""
        return self.ekf.twist_model(*self.track_speeds)

    @property
    def track_speeds(self) -> tuple[float, float]:
        """Present speeds of the left and the right track [m/s]."""
        return self._tracks.speeds_at(self.stamp)

    def slip_sigma(self, *, pushed: bool | None = None) -> Vector3:
        """Standard deviation of the slip at the present track speeds [m/s, m/s, rad/s].

        Args:
            pushed: the robot may be turning with its tracks at rest; None to decide by the inputs.
        """
        ekf = self.ekf
        eta = ekf.model.steering_efficiency(ekf.x[s.PARAMETERS])
        may_be = self._may_be_pushed() if pushed is None else pushed
        return self._disturbances.slip_sigma(self._tracks, eta, pushed=may_be)

    # --- inputs ----------------------------------------------------------------------------------

    def take(self, event: Event) -> bool:
        """Update with one measurement or mark, not older than the one before.

        Returns:
            True if it was used.
        """
        match event:
            case TrackSpeeds():
                return self._take_track_speeds(event)
            case ImuSample():
                return self._take_imu(event)
            case Mark():
                return self._take_mark(event)
            case _:
                return self._take_fix(event)

    def _take_track_speeds(self, m: TrackSpeeds) -> bool:
        tracks = self._tracks
        if tracks.stamp == NEVER:
            self.stamp = m.stamp
        else:
            # The old speeds hold up to their own stamp. A gap is bridged with them, up to the start of
            # the interval that the new ones average.
            hole = tracks.is_hole(m.stamp)
            until = m.stamp - int(tracks.interval / NANOSECOND) if hole else tracks.stamp
            self._advance(until)
            self.health.track_gaps += hole
        begins = tracks.stamp == NEVER
        self.health.stuck_tracks += tracks.take(m.stamp, m.left, m.right)
        if begins:
            # The robot may be moving already, with a slip.
            for axis, sigma in enumerate(self.slip_sigma(pushed=False)):
                self.ekf.inflate(s.SLIP_X + axis, variance=sigma * sigma)
        if not self._imu.is_alive(m.stamp):
            self._advance(m.stamp)
        self._standstill.track_speeds(m.stamp, m.left, m.right)
        self.health.sensor("tracks").used += 1
        return True

    def _take_imu(self, m: ImuSample) -> bool:
        began = self._tracks.stamp != NEVER
        self._imu.tick(m.stamp, used=began)
        if not began:
            # The motion is unknown, not at rest.
            self.health.sensor("imu").reject("before the first track speeds")
            return False
        if self._is_hole(m.stamp):
            # The sample measures the present yaw rate, not that in the gap.
            self._advance(m.stamp - int(self._imu.interval / NANOSECOND))
        ekf = self.ekf
        rate = self._sensors.yaw_rate(m)
        mean = self._standstill.yaw_rate(m.stamp, rate)
        # A mean that is not a number is that of a moving robot.
        self.stands = mean == mean and self._stands(mean)
        at_once = self._take_imu_at_once(m, rate)
        if at_once is not None:
            return at_once
        # Predict the twist of the step.
        self._begin_step(m.stamp)
        if self.stands:
            self._update_standstill()
        at = StepTwist(
            self.model(), ekf.x.copy(), self._imu.interval, track_change(self._inputs(m.stamp))
        )
        # Gate, update and record.
        used = self._update(self._gyro, self._gyro.linearise(rate, at), m.stamp)
        force = m.linear_acceleration
        if force is not None and self._settings.use_accelerometer and not self.stands:
            leftward = self._sensors.to_the_left(force)
            density = self._disturbances.sideways_density(self.slip_sigma())
            found = self._accelerometer.linearise(leftward, at, ekf.x, density)
            self._update(self._accelerometer, found, m.stamp)
        ekf.keep_inside_bounds()
        # Propagate the pose by the updated twist.
        self._advance(m.stamp)
        return used

    def _stands(self, mean: float) -> bool:
        """Return True if the mean of quiet yaw rates [rad/s] is that of a standing robot."""
        bias, variance = self.ekf.x.item(s.GYRO_BIAS), self.ekf.P.item(s.GYRO_BIAS, s.GYRO_BIAS)
        return stands(mean, bias, math.sqrt(variance), self._settings.standstill.bias_margin)

    def _is_hole(self, stamp: int) -> bool:
        """Return True if a stamp [ns] follows a gap longer than `Settings.hold`."""
        return self.stamp is not None and (stamp - self.stamp) * NANOSECOND > self._settings.hold

    def _take_imu_at_once(self, m: ImuSample, rate: float) -> bool | None:
        """Do the rest of `_take_imu` by the compiled step; None if it cannot be done so."""
        step, start = self._at_once, self.stamp
        if step is None or self._step_under_way or start is None or start >= m.stamp:
            return None
        force = m.linear_acceleration if self._settings.use_accelerometer else None
        verdicts = step.imu_step(
            self._tracks,
            start,
            m.stamp,
            stands=self.stands,
            pushed=self._may_be_pushed(),
            interval=self._imu.interval,
            rate=rate,
            force=None if force is None else self._sensors.to_the_left(force),
        )
        if verdicts is None:
            return None
        self.stamp = m.stamp
        if self.stands:
            self.health.standstill_updates += 1
        gates, health = self._gates, self.health
        (verdict, residual, variance, nis), of_accelerometer = verdicts
        gates["gyro"].count(verdict)
        judged = m.stamp, verdict, (residual,), ((variance,),)
        used = health.sensor("gyro").judged(verdict, nis, 1, judged)
        if of_accelerometer is not None:
            verdict, residual, variance, nis = of_accelerometer
            gates["accelerometer"].count(verdict)
            judged = m.stamp, verdict, (residual,), ((variance,),)
            health.sensor("accelerometer").judged(verdict, nis, 1, judged)
        return used

    def _update_standstill(self) -> None:
        """Update with the zero twist of a standing robot."""
        self.health.standstill_updates += 1
        model, R = self.model(), np.diag(STANDSTILL_VARIANCE)
        correct(self.ekf, -model.twist, model.jacobian, R, fixed=IMU_FIXED, correlated=False)

    def _take_fix(self, m: Measurement) -> bool:
        """Update with a measurement of the pose or the twist, by its model of `MODELS`."""
        model, ekf = MODELS[type(m)], self.ekf
        # Predict. A zero velocity at the end of a step is about the next one.
        at_end = self.stamp == m.stamp and self._tracks.stamp != NEVER
        ahead = self._waits_for_imu(m.stamp) or (model.standing and at_end)
        if not ahead and model.predicts == "pose":
            self._advance(m.stamp)
        elif not ahead:
            self._begin_step(m.stamp)
        stood_at = self._stood_at
        if model.standing:
            self._stood_at = m.stamp
        predicted = self._predict(model.predicts, m.stamp, ahead=ahead)

        # Gate, update and record; relocate after rejected position fixes.
        if isinstance(m, PositionFix):
            x, y, _ = predicted.values.tolist()
            self._rejected_fixes += (RejectedFix(m.x, m.y, m.variance, x, y),)
        recover = self._relocate if isinstance(m, PositionFix) else None
        used = self._update(model, model.linearise(m, predicted), m.stamp, recover)
        if used:
            ekf.keep_inside_bounds()

        if used and isinstance(m, PositionFix | PoseFix):
            self._rejected_fixes = ()
        if model.standing and not used:
            self._stood_at = stood_at
        elif model.standing and ahead:
            # The fast slip of the last step is over.
            ekf.renew_fast_slip(predicted.R)
        if not ahead:
            self._advance(m.stamp)
        return used

    def _take_mark(self, m: Mark) -> bool:
        # The estimate is that of the newest step before the mark. Until the mark the motion is assumed
        # constant; the next step corrects it.
        elapsed = 0.0 if self.stamp is None else (self.stamp - m.stamp) * NANOSECOND
        model = self.model()
        motion, _, by_motion = step_on_se2(0.0, (model.twist * elapsed).tolist())
        by_state = np.array(by_motion) @ model.jacobian * elapsed
        self.ekf.clones = self.clones.begun(m.stamp, np.array(motion), by_state, self.ekf.P)
        return True

    # --- steps -----------------------------------------------------------------------------------

    def _update(
        self,
        model: MeasurementModel,
        linearised: Linearised,
        stamp: int,
        recover: Callable[[], bool] | None = None,
    ) -> bool:
        """Gate, update and record a measurement at a stamp [ns]; True if it was used."""
        gate = self._gates[model.name]
        return update(self.ekf, model, gate, linearised, stamp, self.health, recover=recover)

    def _relocate(self) -> bool:
        """Align the path with the rejected position fixes; False if they do not fit.

        The path has the right shape but the wrong place: the heading is wrong, too.
        """
        found = relocation(self._rejected_fixes)
        if found is not None:
            self.ekf.replace_pose(*found.pose(self.ekf.x[s.POSE]))
        return found is not None

    def _may_be_pushed(self) -> bool:
        """Return True if the robot may be turning with its tracks at rest."""
        tracks = self._tracks
        return (
            max(abs(tracks.left), abs(tracks.right)) < self._settings.standstill.track_speed
            and not self.stands
            and self.stamp is not None
            and (self._stood_at is None or self._stood_at < self.stamp)
            and self._imu.is_alive(self.stamp)
        )

    def _waits_for_imu(self, stamp: int) -> bool:
        """Return True if a stamp [ns] lies in a step that the next IMU sample will end."""
        if self.stamp is None or self._tracks.stamp == NEVER:
            return False
        return stamp > self.stamp and self._imu.is_due_after(stamp)

    def _predict(self, quantity: Quantity, stamp: int, *, ahead: bool) -> Prediction:
        """Predict the pose or the twist, now or ahead at a stamp [ns]."""
        x = self.ekf.x
        if quantity == "pose" and not ahead:
            return pose_now(x)
        model = self.model()
        if not ahead:
            return twist_now(model)
        density = self._fast_slip_density(stamp, model)
        if quantity == "twist":
            return twist_ahead(x, model, density, self._imu.interval)
        start = stamp if self.stamp is None else self.stamp
        return pose_ahead(x, model, density, (stamp - start) * NANOSECOND)

    def _fast_slip_density(self, stamp: int, model: TwistModel) -> Floats:
        """Density (3, 3) of the fast slip from the estimate's stamp to a later one [ns]."""
        inputs, sigma = self._inputs(stamp), self.slip_sigma()
        return self._disturbances.fast_slip_density(inputs, model.by_speeds, sigma)

    def _inputs(self, stamp: int) -> StepInputs:
        """Inputs of a step from the estimate's stamp to a later one [ns]."""
        start = stamp if self.stamp is None else self.stamp
        return step_inputs(self._tracks, start, stamp, self._tracks.settings)

    def _advance(self, stamp: int) -> None:
        """Propagate to a stamp [ns], if it is later than the estimate."""
        if self._advance_at_once(stamp):
            return
        self._begin_step(stamp)
        if self.stamp is None or self.stamp >= stamp:
            return
        dt = (stamp - self.stamp) * NANOSECOND
        noise = self._disturbances.of_step(self._tracks, self.slip_sigma())
        left, right = self._tracks.mean_speeds(self.stamp, stamp)
        self.ekf.predict_motion(dt, left, right, noise)
        self.stamp = stamp
        self._step_under_way = False

    def _advance_at_once(self, stamp: int) -> bool:
        """Propagate to a stamp [ns] by the compiled step; return False if it cannot."""
        step, start = self._at_once, self.stamp
        if step is None or self._step_under_way or start is None or start >= stamp:
            return False
        pushed = self._may_be_pushed()
        if not step.time_step(self._tracks, start, stamp, pushed=pushed):
            return False
        self.stamp = stamp
        return True

    def _begin_step(self, stamp: int) -> None:
        """Begin a step to a stamp [ns] with a new fast slip, unless one is under way."""
        if self.stamp is None:
            self.stamp = stamp
        if stamp <= self.stamp or self._step_under_way:
            return
        self.ekf.x[s.FAST_SLIP] = 0.0
        # The fast slip is the mean of a white process over the step.
        dt = (stamp - self.stamp) * NANOSECOND
        self.ekf.begin_step(dt, *self._tracks.mean_speeds(self.stamp, stamp))
        model = self.ekf.smooth_regressors(dt, *self.track_speeds)
        self.ekf.renew_fast_slip(self._fast_slip_density(stamp, model) / dt)
        self._step_under_way = True
