"""Filter: predict, gate, update, record, one measurement at a time.

A step goes from one IMU sample to the next. The IMU measures the twist of the step, not the pose at its
end. So the twist is predicted and updated at the start of the step, and then moves the pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.records import NEVER, assign, copied, or_none
from icreckon.estimator.faults.repeating_fixes import repeats
from icreckon.estimator.faults.scattering_fixes import Scatter
from icreckon.estimator.filter import slip_factor
from icreckon.estimator.filter.checkpoint import FilterCheckpoint, FilterMemory, of_record
from icreckon.estimator.filter.clones import Clones
from icreckon.estimator.filter.filter_record import FilterRecord, may_be_pushed, take_track_speeds
from icreckon.estimator.filter.gate import GateRecord, gates_of
from icreckon.estimator.filter.health import (
    Health,
    Judged,
    SensorHealth,
    add_estimates,
    add_fix_faults,
    add_gyro_faults,
    noise_health,
    slip_health,
)
from icreckon.estimator.filter.initial_state import assumptions, considered_states
from icreckon.estimator.filter.reacquisition import MOST, RejectedFix, beside_wander, relocation
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
from icreckon.estimator.robot.settings import Settings, wander_of
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.sensors import imu_clock, predictions
from icreckon.estimator.sensors.held_tracks import (
    is_hole,
    mean_speeds,
    speeds_at,
    take_motion,
)
from icreckon.estimator.sensors.imu_noise import (
    measure_noise,
    measured_noise,
    noise_of_step,
)
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.measurement_models import (
    ACCELEROMETERS,
    MODELS,
    Accelerometer,
    Gyro,
    Linearised,
    MeasurementModel,
    Quantity,
    StepTwist,
    innovation_components,
)
from icreckon.estimator.sensors.predictions import Prediction
from icreckon.estimator.sensors.sensor_models import STANDSTILL_VARIANCE, SensorModels
from icreckon.estimator.sensors.standstill import QuietReadings, bias_change, tracks_rest
from icreckon.estimator.sensors.step_inputs import StepInputs, step_inputs, track_change
from icreckon.estimator.sensors.wheel_speeds import by_wheels


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
        parameter_sigmas: (9,) initial standard deviations of the parameters.
        by_parts: take no whole steps, as with a mark; they are rounded otherwise.

    Raises:
        EstimatorError: `Settings.considered` has a name that the variant has not.
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
        self.by_parts = False
        self._wander = wander_of(robot, settings)
        if self._wander.sigma:
            self.ekf.add_wander(self._wander.sigma)

        # Counts of all but the gates, which count themselves.
        self._counts = Health()
        self._settings = settings
        self._uses_force = settings.use_accelerometer and variant.accelerometers
        self._sensors = SensorModels(robot)
        self._prior = robot.imu
        self._gyro, fixed = Gyro(self.ekf.fixed_for_gyro), self.ekf.fixed_for_imu
        self._accelerometers = [Accelerometer(self._sensors, fixed, axis) for axis in range(2)]
        self._record = engine.make_record(FilterRecord(input_settings(robot, settings)))
        self._tracks, self._imu = self._record.tracks, self._record.imu
        self._readings = QuietReadings()
        # Position fixes since one was used.
        self._rejected_fixes: tuple[RejectedFix, ...] = ()
        self._scatter = Scatter()
        of_imu = {name: getattr(self._record, name) for name in (self._gyro.name, *ACCELEROMETERS)}
        self._gates = gates_of(innovation_components(), settings.gates, of_imu, engine.make_record)
        self._fix_gates = [gate for name, gate in self._gates.items() if name not in of_imu]
        self._at_once = engine.make_step(
            self.ekf, self._disturbances, robot, settings, self._record, self._readings
        )

    @property
    def stamp(self) -> int | None:
        """Time of the estimate [ns]; None before the first track speeds or fix."""
        return or_none(self._record.stamp)

    @property
    def stands(self) -> bool:
        """True if the robot was found standing at the newest IMU sample."""
        return bool(self._record.stands)

    @property
    def health(self) -> Health:
        """Copy of the counts of the measurements, with measured noise and slip."""
        health, record = self._judged_counts(), self._record
        health.noise = noise_health(record.noise, tracks_rest(record.still), record.settings)
        health.slip = slip_health(self._tracks, record.still, float(record.slip_factor))
        add_gyro_faults(health, self._tracks)
        add_fix_faults(health, record.positions, record.poses, self._scatter)
        add_estimates(health, self.ekf.x, self.ekf.P, self._prior)
        return health

    def _judged_counts(self) -> Health:
        """Copy of the counts, those of the gates included."""
        health = self._counts.copy()
        judged = {name: gate.health() for name, gate in self._gates.items() if gate.counts.judged}
        health.sensors.update(judged)
        return health

    def newest_judged(self) -> list[tuple[str, Judged]]:
        """Newest innovation of each sensor with a gate."""
        found = ((name, gate.newest) for name, gate in self._gates.items())
        return [(name, newest) for name, newest in found if newest is not None]

    @property
    def imu_interval(self) -> float:
        """Time between the newest two IMU samples [s]."""
        return self._imu.interval

    # --- checkpoints -----------------------------------------------------------------------------

    def checkpoint(self) -> FilterCheckpoint:
        """Copy the state of the filter and of its inputs."""
        ekf, gates = self.ekf, self._gates.items()
        return FilterCheckpoint(
            **of_record(self._record),
            state=ekf.x.copy(),
            covariance=ekf.P.copy(),
            standstill=self._readings.memory(self._record.still),
            rejected_for={name: gate.counts.rejected_for for name, gate in gates},
            health=self._judged_counts(),
            clones=ekf.clones,
            model=ekf.model.memory,
            regressors=None if ekf.regressors is None else ekf.regressors.copy(),
            rejected_fixes=self._rejected_fixes,
            scatter=self._scatter,
        )

    def memory(self) -> FilterMemory:
        """Copy all that measurements change."""
        ekf, record = self.ekf, self._record
        return FilterMemory(
            ekf.x.copy(),
            ekf.P.copy(),
            None if ekf.regressors is None else ekf.regressors.copy(),
            ekf.model.memory,
            ekf.clones,
            copied(record),
            self._readings.memory(record.still),
            tuple(copied(gate.counts) if gate.counts.judged else None for gate in self._fix_gates),
            self._counts.copy(),
            self._rejected_fixes,
            self._scatter,
        )

    def recall(self, memory: FilterMemory) -> None:
        """Restore a copy."""
        ekf = self.ekf
        ekf.x, ekf.P, ekf.clones = memory.state.copy(), memory.covariance.copy(), memory.clones
        ekf.regressors = None if memory.regressors is None else memory.regressors.copy()
        ekf.model.recall(memory.model)
        assign(self._record, memory.record)
        self._readings.recall(self._record.still, memory.standstill)
        for gate, counts in zip(self._fix_gates, memory.gates, strict=True):
            assign(gate.counts, counts or GateRecord())
        self._counts, self._rejected_fixes = memory.counts.copy(), memory.rejected_fixes
        self._scatter = memory.scatter

    def restore(self, checkpoint: FilterCheckpoint) -> None:
        """Restore a checkpoint."""
        checkpoint.fill(self._record)
        self._readings.recall(self._record.still, checkpoint.standstill)
        self.ekf.x = checkpoint.state.copy()
        self.ekf.P = checkpoint.covariance.copy()
        self.ekf.clones = checkpoint.clones
        self.ekf.model.recall(checkpoint.model)
        regressors = checkpoint.regressors
        self.ekf.regressors = None if regressors is None else regressors.copy()
        self._rejected_fixes, self._scatter = checkpoint.rejected_fixes, checkpoint.scatter
        sensors = checkpoint.health.sensors
        for name, gate in self._gates.items():
            gate.restore(sensors.get(name, SensorHealth()), 0.0)
        for name, time in checkpoint.rejected_for.items():
            self._gates[name].counts.rejected_for = time
        self._counts = checkpoint.health.copy()

    def warm_start(self, checkpoint: FilterCheckpoint, off: float) -> None:
        """Start with parameters, biases and scales of a checkpoint.

        Args:
            checkpoint: of a filter of the same robot and variant.
            off: time since the checkpoint, over which the biases walk [s].
        """
        learnt = s.LEARNT
        self.ekf.x[learnt] = checkpoint.state[learnt]
        self.ekf.P[learnt, learnt] = checkpoint.covariance[learnt, learnt]
        self.ekf.P[: s.SIZE, : s.SIZE] += np.diag(self._disturbances.bias_walk**2 * off)

    # --- outputs ---------------------------------------------------------------------------------

    @property
    def clones(self) -> Clones:
        """Stochastic clones, with the motion since each mark."""
        return self.ekf.clones or Clones.none(len(self.ekf.x))

    def model(self) -> TwistModel:
        """Body velocity and its derivatives now."""
        return self.ekf.twist_model(*self.track_speeds)

    @property
    def track_speeds(self) -> tuple[float, float]:
        """Present speeds of the left and the right track [m/s]."""
        record = self._record
        return speeds_at(self._tracks, record.stamp, record.settings.hold_ns)

    def slip_sigma(self, *, pushed: bool | None = None) -> Vector3:
        """Standard deviation of the slip at the present track speeds [m/s, m/s, rad/s].

        Args:
            pushed: the robot may be turning with its tracks at rest; None to decide by the inputs.
        """
        record = self._record
        eta = self.ekf.model.steering_efficiency(self.ekf.x[s.PARAMETERS])
        if pushed is None:
            pushed = not record.stands and may_be_pushed(record)
        factor = record.slip_factor
        return self._disturbances.slip_sigma(self._tracks, eta, pushed=pushed, factor=factor)

    # --- inputs ----------------------------------------------------------------------------------

    def take(self, event: Event) -> bool:
        """Update with one measurement or mark, not older than the one before.

        Returns:
            True if it was used.
        """
        match event:
            case ImuSample():
                return self._take_imu(event)
            case TrackSpeeds():
                return self._take_track_speeds(event)
            case Mark():
                return self._take_mark(event)
            case _:
                return self._take_fix(event)

    def _take_track_speeds(self, m: TrackSpeeds) -> bool:
        record, tracks, step = self._record, self._tracks, self._at_once
        hold, begins = self._settings.hold, tracks.stamp == NEVER
        if begins:
            record.stamp = m.stamp
        else:
            # The old speeds hold up to their own stamp, over a gap to the start of the new interval.
            hole = is_hole(tracks, m.stamp, hold)
            self._advance(imu_clock.interval_start(tracks, m.stamp) if hole else tracks.stamp)
            self._counts.track_gaps += hole
        m = by_wheels(tracks, m, record.settings.fastest)
        if step is None:
            stuck = take_track_speeds(record, m.stamp, m.left, m.right)
        else:
            stuck = step.take_track_speeds(m.stamp, m.left, m.right)
        self._counts.stuck_tracks += stuck
        if begins:
            # The robot may be moving already, with a slip.
            for axis, sigma in enumerate(self.slip_sigma(pushed=False)):
                self.ekf.inflate(s.SLIP_X + axis, variance=sigma * sigma)
        if not imu_clock.is_alive(self._imu, m.stamp, hold):
            self._advance(m.stamp)
        self._counts.sensor("tracks").used += 1
        return True

    def _take_imu(self, m: ImuSample) -> bool:
        record, imu, step = self._record, self._imu, self._at_once
        hold = self._settings.hold
        if self._tracks.stamp == NEVER:
            # The motion is unknown, not at rest.
            imu.stamp = m.stamp
            self._counts.sensor("imu").reject("before the first track speeds")
            return False
        rate, force = self._sensors.yaw_rate(m), m.linear_acceleration
        along = (math.nan, math.nan) if force is None else self._sensors.along_ground(force)
        if (m.stamp - record.stamp) * NANOSECOND > hold:
            # The sample measures the present yaw rate, not that in the gap.
            imu_clock.take_stamp(imu, m.stamp, hold)
            self._advance(imu_clock.interval_start(imu, m.stamp))
        if step is not None and self._can_step_at_once(m.stamp):
            used = step.take_imu(m.stamp, rate, *along, uses_force=self._uses_force)
            self._counts.standstill_updates += record.stands
            return used
        imu_clock.take_stamp(imu, m.stamp, hold)
        ekf = self.ekf
        rate = take_motion(record.tracks, m.stamp, rate, *along, record.settings)
        measure_noise(record.noise, m.stamp, rate, *along, hold)
        spread = measured_noise(record.noise.gyro)
        mean = self._readings.mean(record.still, m.stamp, rate, spread, record.settings)
        noise = noise_of_step(record.noise, record.still, record.settings)
        # A mean that is not a number is that of a moving robot.
        record.stands = mean == mean
        # Predict the twist of the step.
        self._begin_step(m.stamp)
        if record.stands:
            self._update_standstill(mean, noise.gyro)
        inputs = self._inputs(m.stamp)
        at = StepTwist(self.model(), ekf.x.copy(), imu.interval, track_change(inputs), noise)
        # Gate, update and record.
        # A gyro that fails has no rate.
        used = rate == rate and self._update(
            self._gyro, self._gyro.linearise(rate, at), m.stamp, imu.interval
        )
        # Without track speeds the force has no prediction.
        if self._uses_force and along[0] == along[0] and not inputs.unknown:
            sigma = self.slip_sigma()
            for axis, model in enumerate(self._accelerometers):
                density = self._disturbances.change_density(sigma[axis])
                found = model.linearise(along[axis], at, ekf.x, density)
                self._update(model, found, m.stamp, imu.interval)
        ekf.keep_inside_bounds(by_imu=True)
        # Propagate the pose by the updated twist.
        self._advance(m.stamp)
        return used

    def _can_step_at_once(self, stamp: int) -> bool:
        """Return True if nothing is to follow each part of a whole step to a stamp [ns]."""
        record, ekf = self._record, self.ekf
        is_whole = NEVER != record.stamp < stamp and not record.step_under_way
        return is_whole and not (self.by_parts or ekf.clones or ekf.observer)

    def _update_standstill(self, mean: float, density: float) -> None:
        """Update with the zero twist of a standing robot, and a changed bias.

        Args:
            mean: mean of the quiet yaw rates [rad/s].
            density: noise density of the gyro [rad²/s].
        """
        self._counts.standstill_updates += 1
        ekf, still = self.ekf, self._record.still
        variance = ekf.P.item(s.GYRO_BIAS, s.GYRO_BIAS)
        variance += density / self._settings.standstill.duration
        change = mean - ekf.x.item(s.GYRO_BIAS)
        slip_factor.doubt(ekf, *bias_change(change, variance, still.rest_time, still.drive_time))
        model, R = self.model(), np.diag(STANDSTILL_VARIANCE)
        fixed = self.ekf.fixed_for_gyro
        correct(self.ekf, -model.twist, model.jacobian, R, fixed=fixed, correlated=False)

    def _take_fix(self, m: Measurement) -> bool:
        """Update with a measurement of the pose or the twist, by its model of `MODELS`."""
        model, ekf, record = MODELS[type(m)], self.ekf, self._record
        if repeats(record.positions, record.poses, m, 0.5 * sum(self.track_speeds)):
            self._rejected_fixes = ()
            return False
        # Predict. A zero velocity at the end of a step is about the next one.
        at_end = record.stamp == m.stamp and self._tracks.stamp != NEVER
        ahead = self._waits_for_imu(m.stamp) or (model.standing and at_end)
        if not ahead and model.predicts == "pose":
            self._advance(m.stamp)
        elif not ahead:
            self._begin_step(m.stamp)
        stood_at = record.stood_at
        if model.standing:
            record.stood_at = m.stamp
        predicted = self._predict(model.predicts, m.stamp, ahead=ahead)
        wandered = self._let_wander(m.stamp) if model.predicts == "pose" else 0.0

        # Gate, update and record; relocate after rejected position fixes.
        if isinstance(m, PositionFix):
            fix, x_before = (m.stamp, m.x, m.y, m.variance), ekf.x.copy()
            x, y, _ = at = predictions.point_on_robot(predicted, m.forward, m.left).values.tolist()
            if not ekf.wanders:
                m = replace(m, variance=self._scatter.of_fix(m.variance))
            before = self._rejected_fixes[-1].variance + wandered if self._rejected_fixes else 0.0
            self._rejected_fixes += (RejectedFix(m.x, m.y, max(m.variance, before), x, y),)
            self._rejected_fixes = self._rejected_fixes[-MOST:]
            if ekf.wanders:
                predicted = predictions.with_wander(predicted, ekf.x)
        gate, found = self._gates[model.name], model.linearise(m, predicted)
        interval, recover = gate.interval_to(m.stamp), None
        yaw = predicted.values.item(s.YAW) if model.is_place else 0.0
        if model.is_place:
            slip_factor.let_slip_last(ekf, yaw, interval)
        if isinstance(m, PositionFix):
            recover = self._relocate
            slip_factor.follow_departure(ekf, record, gate, (m.x, m.y), found, yaw, interval)
        used = self._update(model, found, m.stamp, interval, recover)
        if used:
            ekf.keep_inside_bounds()

        if isinstance(m, PositionFix):
            slip_factor.follow_fix(record, gate.counts, (m.x, m.y), yaw)
            if not ekf.wanders:
                now = predictions.point_on_robot(
                    self._predict("pose", m.stamp, ahead=ahead), m.forward, m.left
                )
                moved = at, now.values.tolist(), ekf.x - x_before
                self._scatter = slip_factor.follow_scatter(
                    ekf, self._scatter, gate.counts, fix, *moved, admitted=used
                )
        if used and isinstance(m, PositionFix | PoseFix):
            self._rejected_fixes = ()
            self._scatter = Scatter() if isinstance(m, PoseFix) else self._scatter
        if model.standing and not used:
            record.stood_at = stood_at
        elif model.standing and ahead:
            # The fast slip of the last step is over.
            ekf.renew_fast_slip(predicted.R)
        if not ahead:
            self._advance(m.stamp)
        return used

    def _take_mark(self, m: Mark) -> bool:
        # The estimate is that of the newest step before the mark. Until the mark the motion is assumed
        # constant; the next step corrects it.
        elapsed = (self._start(m.stamp) - m.stamp) * NANOSECOND
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
        interval: float,
        recover: Callable[[], bool] | None = None,
    ) -> bool:
        """Gate, update and record a measurement at a stamp [ns]; True if it was used."""
        gate, fastest = self._gates[model.name], self._record.settings.fastest
        return update(
            self.ekf, model, gate, linearised, stamp, interval, fastest=fastest, recover=recover
        )

    def _relocate(self) -> bool:
        """Align the path with the rejected position fixes; False if they do not fit.

        The path has the right shape but the wrong place: the heading is wrong, too.
        """
        found = relocation(self._rejected_fixes)
        if found is not None:
            pose, P = found.pose(self.ekf.x[s.POSE])
            self.ekf.replace_pose(pose, beside_wander(P, self._wander.sigma))
        return found is not None

    def _let_wander(self, stamp: int) -> float:
        """Propagate the wander to a stamp [ns]; return its process noise [m²]."""
        record, wander = self._record, self._wander
        if not wander.sigma:
            return 0.0
        elapsed = 0 if record.wander_stamp == NEVER else stamp - record.wander_stamp
        record.wander_stamp, decay = stamp, math.exp(-elapsed * NANOSECOND / wander.time)
        variance = wander.sigma**2 * (1.0 - decay * decay)
        self.ekf.let_wander(decay, variance)
        return variance

    def _waits_for_imu(self, stamp: int) -> bool:
        """Return True if a stamp [ns] lies in a step that the next IMU sample will end."""
        record = self._record
        began = record.stamp != NEVER and self._tracks.stamp != NEVER
        return began and stamp > record.stamp and imu_clock.is_due_after(self._imu, stamp)

    def _predict(self, quantity: Quantity, stamp: int, *, ahead: bool) -> Prediction:
        """Predict the pose or the twist, now or ahead at a stamp [ns]."""
        x = self.ekf.x
        if quantity == "pose" and not ahead:
            return predictions.pose_now(x)
        model = self.model()
        if not ahead:
            return predictions.twist_now(model)
        density = self._fast_slip_density(stamp, model)
        if quantity == "twist":
            return predictions.twist_ahead(x, model, density, self.imu_interval)
        return predictions.pose_ahead(x, model, density, (stamp - self._start(stamp)) * NANOSECOND)

    def pose_ahead(self, stamp: int) -> Prediction:
        """Predict the pose at a later stamp [ns]."""
        return self._predict("pose", stamp, ahead=True)

    def _fast_slip_density(self, stamp: int, model: TwistModel) -> Floats:
        """Density (3, 3) of the fast slip from the estimate's stamp to a later one [ns]."""
        inputs, sigma = self._inputs(stamp), self.slip_sigma()
        return self._disturbances.fast_slip_density(inputs, model.by_speeds, sigma)

    def _inputs(self, stamp: int) -> StepInputs:
        """Inputs of a step from the estimate's stamp to a later one [ns]."""
        record = self._record
        return step_inputs(self._tracks, record.still, self._start(stamp), stamp, record.settings)

    def _start(self, stamp: int) -> int:
        """Stamp of the estimate [ns]; before the first it starts at a given stamp."""
        return stamp if self._record.stamp == NEVER else self._record.stamp

    def _advance(self, stamp: int) -> None:
        """Propagate to a stamp [ns], if it is later than the estimate."""
        record, step = self._record, self._at_once
        if NEVER != record.stamp >= stamp:
            return
        if step is not None and self._can_step_at_once(stamp):
            step.move(stamp)
            return
        self._begin_step(stamp)
        if record.stamp >= stamp:
            return
        sigma, factor = self.slip_sigma(), record.slip_factor
        turn = self._inputs(stamp).turn_density
        noise = self._disturbances.of_step(self._tracks, sigma, factor=factor, turn_density=turn)
        self.ekf.predict_motion(*self._mean_motion(stamp), noise)
        record.stamp = stamp
        record.step_under_way = False

    def _begin_step(self, stamp: int) -> None:
        """Begin a step to a stamp [ns] with a new fast slip, unless one is under way."""
        record = self._record
        record.stamp = self._start(stamp)
        if stamp <= record.stamp or record.step_under_way:
            return
        self.ekf.x[s.FAST_SLIP] = 0.0
        # The fast slip is the mean of a white process over the step.
        dt, left, right = self._mean_motion(stamp)
        self.ekf.begin_step(dt, left, right)
        model = self.ekf.smooth_regressors(dt, *self.track_speeds)
        self.ekf.renew_fast_slip(self._fast_slip_density(stamp, model) / dt)
        record.step_under_way = True

    def _mean_motion(self, stamp: int) -> tuple[float, float, float]:
        """Length of a step to a stamp [ns], and mean track speeds [s, m/s, m/s]."""
        record = self._record
        start, hold_ns = record.stamp, record.settings.hold_ns
        left, right = mean_speeds(self._tracks, start, stamp, hold_ns)
        return (stamp - start) * NANOSECOND, left, right
