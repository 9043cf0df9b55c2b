"""Filter: predict, gate, update, record, one measurement at a time.

A step goes from one IMU sample to the next. The IMU measures the twist of the step, not the pose at its
end. So the twist is predicted and updated at the start of the step, and then moves the pose.
"""

from functools import partial
from typing import Any

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.records import NEVER, assign, copied, or_none, shared_record
from icreckon.estimator.engine.lane_filter import LaneSteps
from icreckon.estimator.engine.lane_functions import BEGIN, PROPAGATE, REFUSED
from icreckon.estimator.faults.repeating_fixes import repeats
from icreckon.estimator.faults.scattering_fixes import ScatterRecord
from icreckon.estimator.filter import filter_record, slip_factor
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.clones import Clones
from icreckon.estimator.filter.ekf import Ekf, update
from icreckon.estimator.filter.fault_table import rejected_sensor
from icreckon.estimator.filter.gate import FORCED, GATED, SKIPPED, GateRecord, gates_of
from icreckon.estimator.filter.health import (
    ADMITTED,
    REACQUIRED,
    REJECTED,
    Health,
    Judged,
    add_findings,
)
from icreckon.estimator.filter.initial_state import assumptions, considered_states
from icreckon.estimator.filter.process_noise import slip_times, twist_covariance
from icreckon.estimator.filter.reacquisition import add_rejected, relocate
from icreckon.estimator.filter.samples import RunRows, SampleArrays
from icreckon.estimator.log.input_checks import NOT_FINITE, STREAMS, Admission, Event
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
from icreckon.estimator.motion.propagation import gauss_markov, step_on_se2
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings, wander_of
from icreckon.estimator.robot.variants import Variant, state_names
from icreckon.estimator.sensors import imu_clock, measurement_models, predictions
from icreckon.estimator.sensors.held_tracks import is_hole, speeds_at
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.measurement_models import FixModel, Quantity
from icreckon.estimator.sensors.predictions import Prediction
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.sensors.standstill import QuietReadings
from icreckon.estimator.sensors.step_inputs import step_inputs
from icreckon.estimator.streaming.outputs import Snapshot
from icreckon.estimator.streaming.own_faults import OwnFaults


class Reckoning:
    """Filter of one robot and variant; its inputs are admitted measurements in order.

    Args:
        robot: the robot.
        variant: the filter variant.
        settings: settings that are no property of the robot.
        start: pose at the first track speeds: x, y [m], yaw [rad].
        sigma: its standard deviations [m, m, rad].

    Attributes:
        ekf: the extended Kalman filter.
        parameter_sigmas: (9,) initial standard deviations of the parameters.
        record: record of the filter; callers change only its rates (`turning`, `yaw_rates`).

    Raises:
        EstimatorError: `Settings.considered` has a name that the variant does not have.
    """

    def __init__(
        self, robot: Robot, variant: Variant, settings: Settings, start: Vector3, sigma: Vector3
    ) -> None:
        model, state, sigmas, self._disturbances = assumptions(robot, variant, settings)
        self.parameter_sigmas = sigmas[s.PARAMETERS].copy()
        state[s.POSE], sigmas[s.POSE] = start, sigma
        self.ekf = Ekf(model)
        self.ekf.x = state
        self.ekf.P = np.diag(sigmas**2)
        self.ekf.considered = considered_states(variant, settings)
        self._wander = wander_of(robot, settings)
        if self._wander.sigma:
            self.ekf.add_wander(self._wander.sigma)

        self._counts = Health()  # counts of all but the gates, which count themselves
        fastest = robot.vehicle.max_track_speed
        self.admission = Admission(settings.longest_gap, fastest, robot.imu.gyro_axes)
        self.own_faults = OwnFaults(state_names(variant), self.admission)
        self._settings = settings
        self._uses_force = settings.use_accelerometer and variant.accelerometers
        self._mounting = SensorModels(robot).mounting
        self._prior = robot.imu
        compiles = settings.engine == "compiled"
        make_record = shared_record if compiles else copied
        self.record = make_record(filter_record.FilterRecord(input_settings(robot, settings)))
        self._tracks, self._imu = self.record.tracks, self.record.imu
        self._readings = QuietReadings()
        # The gates of the IMU count in the record, the others in records of their own.
        imu_gates = {name: getattr(self.record, name) for name in measurement_models.IMU_SENSORS}
        components = measurement_models.innovation_components()
        self._gates = gates_of(components, settings.gates, imu_gates, make_record)
        self._fix_gates = {n: gate for n, gate in self._gates.items() if n not in imu_gates}
        parts = self.ekf, self._disturbances, robot, settings, self.record, self._readings
        self._steps = LaneSteps(*parts, compiles=compiles)

    @property
    def stamp(self) -> int | None:
        """Time of the estimate [ns]; None before the first track speeds or fix."""
        return or_none(self.record.stamp)

    @property
    def stands(self) -> bool:
        """True if the robot was found standing at the newest IMU sample."""
        return bool(self.record.stands)

    @property
    def health(self) -> Health:
        """Copy of the counts of the measurements, with measured noise and slip."""
        health = self._counts.copy()
        for name, gate in self._gates.items():
            if gate.counts.judged:
                gated = gate.health()
                gated.rejected |= health.sensor(name).rejected
                health.sensors[name] = gated
        add_findings(health, self.record, self.ekf.x, self.ekf.P, self._prior)
        for name, gate in self._fix_gates.items():
            if name != "position":
                health.findings += rejected_sensor(name, gate.counts.rejected_for)
        health.findings += self.own_faults.findings()
        return health

    def newest_judged(self) -> list[tuple[str, Judged]]:
        """Newest innovation of each sensor with a gate, if there was one."""
        pairs = ((name, gate.newest) for name, gate in self._gates.items())
        return [(name, newest) for name, newest in pairs if newest is not None]

    # --- checkpoints -----------------------------------------------------------------------------

    def checkpoint(self) -> FilterCheckpoint:
        """Copy everything that measurements change."""
        ekf, record, gates = self.ekf, copied(self.record), self._fix_gates.items()
        # The places of the quiet readings in the copied record become those in their copy.
        return FilterCheckpoint(
            ekf.x.copy(),
            ekf.P.copy(),
            record,
            self._readings.memory(record.still),
            {name: copied(gate.counts) for name, gate in gates if gate.counts.judged},
            self._counts.copy(),
            ekf.clones,
            ekf.model.memory.copy(),
            ekf.regressors.copy(),
            self.own_faults.memory(),
        )

    def restore(self, checkpoint: FilterCheckpoint) -> None:
        """Restore a copy; gates that it lacks start again."""
        ekf = self.ekf
        ekf.x, ekf.P = checkpoint.state.copy(), checkpoint.covariance.copy()
        ekf.clones = checkpoint.clones
        ekf.regressors = checkpoint.regressors.copy()
        ekf.model.recall(checkpoint.model.copy())
        assign(self.record, checkpoint.record)
        self._readings.recall(checkpoint.quiet)
        for gate in self._fix_gates.values():
            assign(gate.counts, GateRecord())
        for name, counts in checkpoint.gates.items():
            assign(self._fix_gates[name].counts, counts)
        self._counts = checkpoint.counts.copy()
        self.own_faults.restore(checkpoint.own_faults)

    def warm_start(self, checkpoint: FilterCheckpoint, off: float) -> None:
        """Start with parameters, biases and scales of a checkpoint that is `off` [s] old.

        States that were certain there keep the prior of this robot file.
        """
        learnt = np.arange(s.SIZE)[s.LEARNT]
        learnt = learnt[checkpoint.covariance[learnt, learnt] > 0.0]
        block = np.ix_(learnt, learnt)
        self.ekf.x[learnt] = checkpoint.state[learnt]
        self.ekf.P[block] = checkpoint.covariance[block]
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
        record = self.record
        return speeds_at(self._tracks, record.stamp, record.settings.hold_ns)

    def snapshot(self) -> Snapshot:
        """State, twist and indices; see `PoseEstimator.snapshot`."""
        model, record, n = self.model(), self.record, s.SIZE
        x, P = self.ekf.x[:n].copy(), self.ekf.P[:n, :n].copy()
        twist_P = twist_covariance(model.jacobian[:, :n], P, record.settings.fastest)
        indices = model.motion.indices
        planar = Snapshot(int(record.stamp), x, P, model.twist.copy(), twist_P, indices)
        if record.tilt.time == 0.0:
            # The rates of roll and pitch are not known.
            return planar
        biases = [s.GYRO_BIAS_X, s.GYRO_BIAS_Y]
        rates = np.array([record.tilt.roll, record.tilt.pitch]) - x[biases]
        noise = record.settings.gyro_noise_density**2 / record.imu.interval
        rates_P = P[np.ix_(biases, biases)] + noise * np.eye(2)
        return planar._replace(tilt_rates=rates, tilt_rate_covariance=rates_P)

    def write_row(self, rows: RunRows, stamp: int) -> bool:
        """Fill the next row of a run if it is due before a measurement at a stamp [ns]."""
        return self._steps.write_row(rows, stamp)

    def parameter_health(self) -> Floats:
        """Uncertainty (9, 3) of the parameters, see `ParameterHealth`."""
        now, start = np.sqrt(np.diagonal(self.ekf.P)[s.PARAMETERS]), self.parameter_sigmas
        # Change of each component of the twist (3, 9) by one initial standard deviation.
        effect = np.abs(self.model().jacobian[:, s.PARAMETERS]) * start
        # A parameter that does not move the twist is not excited, not even if there is no slip.
        with np.errstate(divide="ignore", invalid="ignore"):
            excitation = np.where(effect > 0.0, effect / np.array(self.slip_sigma())[:, None], 0.0)
        return np.column_stack([now, start, excitation.max(axis=0)])

    def slip_sigma(self, *, pushed: bool | None = None) -> Vector3:
        """Standard deviation of the slip [m/s, m/s, rad/s], by `process_noise.slip_at`."""
        record = self.record
        eta = self.ekf.model.steering_efficiency(self.ekf.x[s.PARAMETERS])
        if pushed is None:  # decided by the present inputs
            pushed = not record.stands and filter_record.may_be_pushed(record)
        factor = record.slip_factor
        return self._disturbances.slip_sigma(self._tracks, eta, pushed=pushed, factor=factor)

    # --- inputs ----------------------------------------------------------------------------------

    def take(self, event: Event) -> bool:
        """Update with a measurement or mark, no older than the last; True if it was used."""
        if self.own_faults.watched and not isinstance(event, Mark):
            event, excluded_by = self.own_faults.watch(event, self, self.ekf)
            if excluded_by is not None:
                self._counts.sensor(STREAMS[type(event)]).reject(excluded_by)
                return False
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
        """Add track speeds, after a step with the old ones where these end it."""
        take, has_wheels = self._steps.take_track_speeds, m.left_wheels or m.right_wheels
        # Compiled code takes the common case in one call, and refuses all others.
        if not has_wheels and take(m.stamp, m.left, m.right, True) != REFUSED:
            self._counts.sensor("tracks").used += 1
            return True
        record, tracks = self.record, self._tracks
        hold, is_first = self._settings.hold, tracks.stamp == NEVER
        if is_first:
            record.stamp = m.stamp
        else:
            # The old speeds hold up to their own stamp, or over a gap to the start of the new interval.
            is_gap = is_hole(tracks, m.stamp, hold)
            if is_gap or filter_record.ends_step(record):
                self._advance(imu_clock.interval_start(tracks, m.stamp) if is_gap else tracks.stamp)
            self._counts.track_gaps += is_gap
        wheels = m.left_wheels, m.right_wheels
        sides = filter_record.sides_of(record, m.stamp, (m.left, m.right), *wheels, True)
        take(m.stamp, *sides, False)
        if is_first:
            # The robot may be moving already, with a slip.
            for axis, sigma in enumerate(self.slip_sigma(pushed=False)):
                self.ekf.inflate(s.SLIP_X + axis, variance=sigma * sigma)
        if not imu_clock.is_alive(self._imu, m.stamp, hold):
            self._advance(m.stamp)
        self._counts.sensor("tracks").used += 1
        return True

    def _take_imu(self, m: ImuSample) -> bool:
        """Take the step that a sample ends, after a gap from its start; True if used."""
        result = self._steps.take_imu(m, self._mounting, self._uses_force)
        if result == REFUSED:
            if self._tracks.stamp == NEVER:
                # The motion is unknown, not at rest.
                self._imu.stamp = m.stamp
                self._counts.sensor("imu").reject("before the first track speeds")
                return False
            # The sample measures the present yaw rate, not that in the gap.
            imu_clock.take_stamp(self._imu, m.stamp, self._settings.hold)
            self._advance(imu_clock.interval_start(self._imu, m.stamp))
            result = self._steps.take_imu(m, self._mounting, self._uses_force, after_gap=True)
        self._counts.standstill_updates += self.record.stands
        return result > 0  # 1 if its yaw rate was used

    def take_samples(self, samples: SampleArrays, rows: RunRows) -> tuple[int, int, int]:
        """Update with samples, and fill rows, see `PoseEstimator.feed_samples`."""
        # Marks, an observer and faults of users need each step.
        ekf, has_own_faults = self.ekf, bool(self.own_faults.watched)
        needs_each_step = ekf.clones is not None or ekf.observer is not None or has_own_faults
        if needs_each_step or self._tracks.stamp == NEVER:
            return 0, 0, 0
        taken = self._steps.take_samples(samples, self._mounting, rows, uses_force=self._uses_force)
        self._counts.sensor("tracks").used += taken.tracks
        self._counts.standstill_updates += taken.stood
        return taken.tracks, taken.imu, taken.tracks + taken.rates_used

    def _take_fix(self, m: Measurement) -> bool:
        """Update with a measurement of the pose or the twist, by its model of `MODELS`."""
        model, record = measurement_models.MODELS[type(m)], self.record
        if model.standing and is_hole(self._tracks, m.stamp, self._settings.hold):
            # Unless it stood before, the stale speeds hold up to here: the time of stopping is unknown.
            if not record.stands:
                self._advance(m.stamp)
            filter_record.hold_track_speeds(record, m.stamp, 0.0, 0.0)
        # Predict ahead within the step that the next IMU sample will end, or move to the stamp. A zero
        # velocity at the end of a step measures the next step.
        is_at_end = record.stamp == m.stamp and self._tracks.stamp != NEVER
        ahead = self._waits_for_imu(m.stamp) or (model.standing and is_at_end)
        has_begun_step = False
        if not ahead and model.predicts != "twist":
            self._advance(m.stamp)
        elif not ahead:
            # A twist is measured within the step to its stamp: update first, then move the pose.
            has_begun_step = record.stamp != NEVER and record.stamp < m.stamp
            record.stamp = self._start(m.stamp)
            if has_begun_step:
                self._steps.move(m.stamp, BEGIN)
        if isinstance(m, PositionFix | PoseFix) and self._repeats(m):
            record.fixes.rejected.count = 0
            return False
        if isinstance(m, PositionFix):
            return self._take_position(m, ahead=ahead)
        used = self._update(m, model, ahead=ahead)
        if used and isinstance(m, PoseFix):
            record.fixes.rejected.count = 0
            assign(record.fixes.scatter, ScatterRecord())
        if has_begun_step:
            self._steps.move(m.stamp, PROPAGATE)
        return used

    def _update(self, m: Measurement, model: FixModel[Any], *, ahead: bool) -> bool:
        """Predict a measurement, now or ahead; gate it, update and record."""
        ekf, record, stood_before = self.ekf, self.record, self.record.stood_at
        if model.standing:
            record.stood_at = m.stamp
        predicted = self._predict(model.predicts, m.stamp, ahead=ahead)
        if model.predicts == "pose":
            self._let_wander(m.stamp)
        gate, unchecked = self._gates[model.name], model.linearise(m, predicted)
        sizes = len(model.components), len(ekf.x)
        innovation = measurement_models.checked(model.name, *sizes, unchecked)
        if not all(np.isfinite(part).all() for part in innovation):
            self._counts.sensor(model.name).reject(NOT_FINITE)
            return False
        interval = gate.interval_to(m.stamp)
        if model.is_place:
            slip_factor.inflate_by_lasting_slip(ekf, predicted.values.item(s.YAW), interval)
        if model.predicts == "height" and not gate.counts.judged:
            # The first height sets the state: inflate by three times its innovation and its sigma.
            ekf.inflate(s.Z, variance=(3.0 * innovation.z.item()) ** 2 + 9.0 * innovation.R.item())
        fastest = record.settings.fastest
        used = update(ekf, model, gate, innovation, m.stamp, interval, fastest=fastest)
        if used:
            ekf.keep_inside_bounds()
        if model.standing and not used:
            record.stood_at = stood_before
        elif model.standing and ahead:
            # The measurement is about the next step, which has a new fast slip.
            ekf.renew_fast_slip(predicted.R)
        return used

    def _repeats(self, m: PositionFix | PoseFix) -> bool:
        """Return True for a fix that repeats a position while driving."""
        record = self.record
        place = record.positions if isinstance(m, PositionFix) else record.poses
        speeds = speeds_at(self._tracks, m.stamp, record.settings.hold_ns)
        return repeats(place, m.stamp, m.x, m.y, 0.5 * sum(speeds))

    def _take_position(self, m: PositionFix, *, ahead: bool) -> bool:
        """Update with a position fix; after too many rejected ones relocate the pose."""
        ekf, gate, fixes = self.ekf, self._gates["position"], self.record.fixes
        wander_variance, x_before = self._let_wander(m.stamp), ekf.x.copy()
        variance = max(m.variance, fixes.scatter.variance)
        interval = gate.interval_to(m.stamp)
        take = partial(
            self._steps.take_position,
            m.stamp,
            (m.x, m.y, variance),
            (m.forward, m.left, m.up),
            ahead=ahead,
            interval=interval,
            rejected_for=gate.counts.rejected_for,
        )
        fix, is_admitted, is_lost = take(mode=GATED)
        add_rejected(fixes.rejected, (m.x, m.y, variance), fix.predicted, wander_variance)
        verdict = ADMITTED if is_admitted else REACQUIRED if fix.used or is_lost else REJECTED
        if is_lost:
            # A relocated pose contains this fix already.
            retried, _, _ = take(mode=SKIPPED if self._relocate() else FORCED)
            fix = fix._replace(updated=retried.updated, used=True)
        gate.count(m.stamp, verdict, fix.z, fix.S, interval)
        # The scatter is estimated from the variance that the receiver states.
        if not ekf.wanders:
            stated = fix._replace(variance=m.variance)
            if self._steps.follow_scatter(stated, ekf.x - x_before):
                slip_factor.inflate_by_corrections(ekf, fixes.scatter)
        if fix.used:
            fixes.rejected.count = 0
        return fix.used

    def _take_mark(self, m: Mark) -> bool:
        """Clone the pose at a mark, with constant motion until then; return True."""
        # The estimate is that of the newest step before the mark; the next step corrects the motion.
        since_mark = (self._start(m.stamp) - m.stamp) * NANOSECOND
        model = self.model()
        motion, _, by_motion = step_on_se2(0.0, (model.twist * since_mark).tolist())
        by_state = np.array(by_motion) @ model.jacobian * since_mark
        self.ekf.clones = self.clones.begun(m.stamp, np.array(motion), by_state, self.ekf.P)
        return True

    # --- steps -----------------------------------------------------------------------------------

    def _relocate(self) -> bool:
        """Align the path with the rejected position fixes; False if they do not fit."""
        pose, P = self.ekf.x[s.POSE].copy(), np.zeros((5, 5))
        fits = relocate(self.record.fixes.rejected, pose, P, self._wander.sigma)
        if fits:
            size = 5 if self.ekf.wanders else 3
            self.ekf.replace_pose(pose, P[:size, :size])
        return fits

    def _let_wander(self, stamp: int) -> float:
        """Propagate the wander to a stamp [ns]; return its process noise [m²]."""
        wander, fixes = self._wander, self.record.fixes
        if not wander.sigma:
            return 0.0
        decay, variance = filter_record.wander_after(fixes, stamp, wander.sigma, wander.time)
        self.ekf.let_wander(decay, variance)
        return variance

    def _waits_for_imu(self, stamp: int) -> bool:
        """Return True if a stamp [ns] lies in a step that the next IMU sample will end."""
        record = self.record
        has_begun = record.stamp != NEVER and self._tracks.stamp != NEVER
        return has_begun and stamp > record.stamp and imu_clock.is_due_after(self._imu, stamp)

    def _predict(self, quantity: Quantity, stamp: int, *, ahead: bool) -> Prediction:
        """Predict the pose, the height or the twist, now or ahead at a stamp [ns]."""
        x = self.ekf.x
        if quantity == "height":
            return predictions.height_now(x)
        if quantity == "pose" and not ahead:
            return predictions.pose_now(x)
        if not ahead:
            return predictions.twist_now(self.model())
        elapsed = (stamp - self._start(stamp)) * NANOSECOND
        model = self.model_over(elapsed) if quantity == "pose" else self.model()
        density = self._fast_slip_density(stamp, model)
        if quantity == "twist":
            return predictions.twist_ahead(x, model, density, self._imu.interval)
        return predictions.pose_ahead(x, model, density, elapsed)

    def model_over(self, elapsed: float) -> TwistModel:
        """Body velocity over the next seconds, with the mean of the slip, which fades."""
        times = slip_times(self._disturbances.slip.time_constant, self.record.slip_factor)
        x, y, w = (gauss_markov(elapsed, tau).mean for tau in times)
        return self.ekf.twist_model(*self.track_speeds, (x, y, w))

    def pose_ahead(self, stamp: int) -> Prediction:
        """Predict the pose at a later stamp [ns], with the present twist."""
        return self._predict("pose", stamp, ahead=True)

    def _fast_slip_density(self, stamp: int, model: TwistModel) -> Floats:
        """Density (3, 3) of the fast slip from the estimate's stamp to a later one [ns]."""
        record, start, sigma = self.record, self._start(stamp), self.slip_sigma()
        inputs = step_inputs(self._tracks, record.still, start, stamp, record.settings)
        dt = (stamp - start) * NANOSECOND
        return self._disturbances.fast_slip_density(inputs, model.by_speeds, sigma, dt)

    def _start(self, stamp: int) -> int:
        """Stamp of the estimate [ns]; before the first it starts at the given one."""
        return stamp if self.record.stamp == NEVER else self.record.stamp

    def _advance(self, stamp: int) -> None:
        """Propagate to a stamp [ns], if it is later than the estimate."""
        record = self.record
        if record.stamp == NEVER:
            record.stamp = stamp
        elif record.stamp < stamp:
            self._steps.move(stamp)
