"""The filter fed in order: what each measurement does to it, and how it moves on between them."""

from __future__ import annotations

import math

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.base.records import NEVER
from icreckon.estimator.filter.checkpoint import FilterMemory
from icreckon.estimator.filter.clones import Marks
from icreckon.estimator.filter.ekf import IMU_KEPT, POSE_KEPT, STANDING_KEPT
from icreckon.estimator.filter.gate import REJECTED, Gate
from icreckon.estimator.filter.health import Health
from icreckon.estimator.filter.initial_state import assumptions, considered_states
from icreckon.estimator.filter.joint import Joint
from icreckon.estimator.filter.look_ahead import (
    Foretold,
    component,
    pose_ahead,
    pose_now,
    twist_ahead,
)
from icreckon.estimator.filter.reacquisition import RefusedFix, relocation
from icreckon.estimator.filter.step_engine import StepEngine
from icreckon.estimator.filter.update import (
    Judge,
    surprise_of,
    update,
    update_jointly,
    update_pair,
)
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    Mark,
    Measurement,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    Vector3,
    ZeroVelocity,
)
from icreckon.estimator.motion.motion_model import TwistModel
from icreckon.estimator.motion.propagation import step_on_se2
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.sensors.held_tracks import HeldTrackSpeeds
from icreckon.estimator.sensors.imu_clock import ImuClock
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.sensor_models import (
    STANDSTILL_VARIANCE,
    SensorModels,
    TrackChange,
    twist_component,
)
from icreckon.estimator.sensors.standstill import StandstillDetector


class Reckoning:
    """The filter and all that it goes by; measurements must come in order and have been admitted.

    Args:
        robot: the robot.
        variant: the filter variant.
        settings: everything that is no property of the robot.
        start: pose at the first track speeds: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].
        engine: makes the filter's algebra.

    Attributes:
        ekf: the filter.
        stamp: time of the estimate [ns]; None before the first track speeds or fix.
        stands: whether the robot was found standing at the newest IMU sample.
        health: what became of the measurements.
        parameter_sigmas: (8,) standard deviations of the parameters at the start.

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
        # Whether the fast slip of the next step is drawn, and the pose has not got there yet.
        self._step_under_way = False
        for_inputs = input_settings(robot, settings)
        self._tracks = HeldTrackSpeeds(settings=for_inputs)
        self._imu = ImuClock(hold=settings.hold)
        self._refused_fixes: tuple[RefusedFix, ...] = ()
        # Stamp of the newest zero velocity that was used.
        self._stood_at: int | None = None
        self._gates = {
            "gyro": Gate(1, settings.gates),
            "accelerometer": Gate(1, settings.gates),
            "position": Gate(2, settings.gates),
            "heading": Gate(1, settings.gates),
            "body velocity": Gate(2, settings.gates),
            "pose": Gate(3, settings.gates),
            "zero velocity": Gate(3, settings.gates),
        }
        self._standstill = StandstillDetector(for_inputs, settings.standstill.bias_margin)
        self._at_once = engine.make_step(
            self.ekf,
            self._disturbances,
            self._sensors,
            self._gates["gyro"],
            self._gates["accelerometer"],
        )

    @property
    def imu_interval(self) -> float:
        """Time between the newest two IMU samples [s]."""
        return self._imu.interval

    # --- what it knows ---------------------------------------------------------------------------

    def memory(self) -> FilterMemory:
        """All that it goes by."""
        return FilterMemory(
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
            self.ekf.marks,
            self.ekf.model.memory,
            None if self.ekf.regressors is None else self.ekf.regressors.copy(),
            self._refused_fixes,
            self._stood_at,
        )

    def recall(self, memory: FilterMemory) -> None:
        """Go by what it went by then."""
        self.stamp = memory.stamp
        self.ekf.x = memory.state.copy()
        self.ekf.P = memory.covariance.copy()
        self.ekf.marks = memory.marks
        self.ekf.model.recall(memory.model)
        regressors = memory.regressors
        self.ekf.regressors = None if regressors is None else regressors.copy()
        self._refused_fixes = memory.refused_fixes
        self._stood_at = memory.stood_at
        self._step_under_way = memory.step_under_way
        self.stands = memory.stands
        self._tracks.recall(memory.tracks)
        self._standstill.recall(memory.standstill)
        self._imu.recall(memory.imu)
        for name, count in memory.rejected_in_a_row.items():
            self._gates[name].rejected_in_a_row = count
        self.health = memory.health.copy()

    @property
    def marks(self) -> Marks:
        """The motion since each mark."""
        return self.ekf.marks or Marks.none()

    def take_over(self, memory: FilterMemory, off: float) -> None:
        """Take over what was learnt: parameters, biases and scales, with their covariance.

        Args:
            memory: what a filter of the same robot and variant knew.
            off: how long ago that was [s]; the biases have walked since.
        """
        learnt = s.LEARNT
        self.ekf.x[learnt] = memory.state[learnt]
        self.ekf.P[learnt, learnt] = memory.covariance[learnt, learnt]
        self.ekf.P += np.diag(self._disturbances.bias_walk**2 * off)

    def model(self) -> TwistModel:
        """Body velocity and its derivatives now."""
        return self.ekf.twist_model(*self.track_speeds)

    @property
    def track_speeds(self) -> tuple[float, float]:
        """Speeds of the left and the right track that it goes by now [m/s]."""
        return self._tracks.speeds_at(self.stamp)

    def slip_sigma(self, *, pushed: bool | None = None) -> Vector3:
        """Standard deviation of the slip at the present track speeds [m/s, m/s, rad/s].

        Args:
            pushed: whether the robot may be turning with its tracks at rest; None to find out.
        """
        ekf = self.ekf
        eta = ekf.model.steering_efficiency(ekf.x[s.PARAMETERS])
        may_be = self._may_be_pushed() if pushed is None else pushed
        return self._disturbances.slip_sigma(self._tracks, eta, pushed=may_be)

    # --- what it is told -------------------------------------------------------------------------

    def take(self, measurement: Measurement | Mark) -> bool:
        """Take one measurement or mark, not older than the one before; whether it was used."""
        match measurement:
            case TrackSpeeds():
                return self._take_track_speeds(measurement)
            case ImuSample():
                return self._take_imu(measurement)
            case PositionFix():
                return self._take_position(measurement)
            case HeadingFix():
                return self._take_heading(measurement)
            case BodyVelocity():
                return self._take_body_velocity(measurement)
            case PoseFix():
                return self._take_pose(measurement)
            case ZeroVelocity():
                return self._take_zero_velocity(measurement)
            case Mark():
                return self._take_mark(measurement)

    def _take_track_speeds(self, m: TrackSpeeds) -> bool:
        tracks = self._tracks
        if tracks.stamp == NEVER:
            self.stamp = m.stamp
        else:
            # The old speeds have nothing to say beyond their own stamp, unless they are all there is
            # to bridge a hole with, up to where the new ones begin to speak.
            hole = tracks.is_hole(m.stamp)
            until = m.stamp - int(tracks.interval / NANOSECOND) if hole else tracks.stamp
            self._advance(until)
            self.health.track_gaps += hole
        begins = tracks.stamp == NEVER
        self.health.stuck_tracks += tracks.take(m.stamp, m.left, m.right)
        if begins:
            # The robot may be on its way already, and its slip with it.
            for axis, sigma in enumerate(self.slip_sigma(pushed=False)):
                self.ekf.reopen(s.SLIP_X + axis, variance=sigma * sigma)
        if not self._imu.is_alive(m.stamp):
            self._advance(m.stamp)
        self._standstill.track_speeds(m.stamp, m.left, m.right)
        self.health.sensor("tracks").used += 1
        return True

    def _take_imu(self, m: ImuSample) -> bool:
        began = self._tracks.stamp != NEVER
        self._imu.tick(m.stamp, used=began)
        if not began:
            # Not a robot at rest, but one of which nothing is known yet.
            self.health.sensor("imu").reject("before the first track speeds")
            return False
        if self._is_hole(m.stamp):
            # It tells how the robot turns now, and nothing of the hole before.
            self._advance(m.stamp - int(self._imu.interval / NANOSECOND))
        ekf = self.ekf
        rate = self._sensors.yaw_rate(m)
        bias_sigma = math.sqrt(ekf.P[s.GYRO_BIAS, s.GYRO_BIAS])
        self.stands = self._standstill.yaw_rate(
            m.stamp, rate, float(ekf.x[s.GYRO_BIAS]), bias_sigma
        )
        at_once = self._take_imu_at_once(m, rate)
        if at_once is not None:
            return at_once
        self._begin_step(m.stamp)
        if self.stands:
            self._update_standstill()
        model, linearised_at = self.model(), ekf.x.copy()
        change = self._track_change()
        used = update(
            ekf,
            self._judge("gyro", m.stamp),
            self._sensors.gyro(rate, self._imu.interval, model, ekf.x, change),
            reopen=s.SLIP_W,
            kept=IMU_KEPT,
        )
        force = m.linear_acceleration
        if force is not None and self._settings.use_accelerometer and not self.stands:
            self._update_accelerometer(m.stamp, force, model, linearised_at, change)
        ekf.keep_inside_bounds()
        self._advance(m.stamp)
        return used

    def _is_hole(self, stamp: int) -> bool:
        """Whether nothing was reckoned with for longer than `Settings.hold` before a stamp [ns]."""
        return self.stamp is not None and (stamp - self.stamp) * NANOSECOND > self._settings.hold

    def _take_imu_at_once(self, m: ImuSample, rate: float) -> bool | None:
        """What follows in `_take_imu`, compiled; None where it must be done one thing at a time."""
        step, start = self._at_once, self.stamp
        if step is None or self._step_under_way or start is None or start >= m.stamp:
            return None
        force = m.linear_acceleration if self._settings.use_accelerometer else None
        verdicts = step.take(
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
        """A standing robot's twist is zero."""
        self.health.standstill_updates += 1
        model, linearised_at = self.model(), self.ekf.x.copy()
        for axis, variance in enumerate(STANDSTILL_VARIANCE):
            reading = twist_component(axis, 0.0, variance, model, linearised_at, self.ekf.x)
            self.ekf.update_scalar(*reading, kept=IMU_KEPT)

    def _update_accelerometer(
        self,
        stamp: int,
        force: Vector3,
        model: TwistModel,
        linearised_at: Floats,
        change: TrackChange,
    ) -> None:
        rough = self._disturbances.sideways_density(self.slip_sigma())
        reading = self._sensors.accelerometer(
            force, self._imu.interval, model, linearised_at, self.ekf.x, change, rough
        )
        judge = self._judge("accelerometer", stamp)
        update(self.ekf, judge, reading, reopen=s.ACCELEROMETER_BIAS, kept=IMU_KEPT)

    def _take_position(self, m: PositionFix) -> bool:
        foretold, measured = self._pose_at(m.stamp), (m.x, m.y)
        believed = (foretold.values.item(0), foretold.values.item(1))
        refused = (*self._refused_fixes, RefusedFix(*measured, m.variance, *believed))
        judge = self._judge("position", m.stamp)
        surprise = surprise_of(self.ekf, measured, m.variance, foretold)
        lost = judge.gate.gives_up and surprise.nis > judge.gate.threshold
        found = relocation(refused) if lost else None
        if found is None:
            used = update_pair(self.ekf, judge, measured, m.variance, foretold, reopen=s.X, kept=())
        else:
            # The path is right in itself, but lies elsewhere: the heading is wrong, too.
            self.ekf.replace_pose(*found.pose(self.ekf.x[s.POSE]))
            used = judge.judge(surprise) != REJECTED
        self._refused_fixes = () if used else refused
        return used

    def _take_heading(self, m: HeadingFix) -> bool:
        foretold, x = self._pose_at(m.stamp), self.ekf.x
        reading = component(s.YAW, m.yaw, m.variance, foretold, x, x)
        reading = reading._replace(residual=float(wrap_angle(reading.residual)))
        judge = self._judge("heading", m.stamp)
        used = update(self.ekf, judge, reading, reopen=s.YAW, kept=())
        self.ekf.keep_inside_bounds()
        return used

    def _take_pose(self, m: PoseFix) -> bool:
        foretold, x = self._pose_at(m.stamp), self.ekf.x
        residual = np.array((m.x, m.y, m.yaw)) - foretold.values
        residual[2] = wrap_angle(residual[2])
        joint = Joint.of(residual, np.array(m.covariance), foretold, x)
        judge = self._judge("pose", m.stamp)
        used = update_jointly(self.ekf, judge, joint, reopen=s.X, kept=())
        if used:
            # Where these lie is of no interest any more: the heading was measured, too.
            self._refused_fixes = ()
        return used

    def _take_zero_velocity(self, m: ZeroVelocity) -> bool:
        # At the estimate's own stamp it is about the next step, too: the one before is done with.
        over = self.stamp == m.stamp and self._tracks.stamp != NEVER
        waits = over or self._waits_for_imu(m.stamp)
        if not waits:
            self._begin_step(m.stamp)
        before, self._stood_at = self._stood_at, m.stamp
        foretold = self._twist_at(m.stamp, waits=waits)
        noise = np.diag(np.square(m.sigma))
        joint = Joint.of(-foretold.values, noise, foretold, self.ekf.x)
        judge = self._judge("zero velocity", m.stamp)
        used = update_jointly(self.ekf, judge, joint, reopen=s.SLIP_X, kept=STANDING_KEPT)
        if not used:
            self._stood_at = before
        elif waits:
            self.ekf.renew_fast_slip(foretold.covariance)
        if not waits:
            self._advance(m.stamp)
        return used

    def _take_body_velocity(self, m: BodyVelocity) -> bool:
        waits = self._waits_for_imu(m.stamp)
        foretold = self._twist_at(m.stamp, waits=waits)
        judge, velocity = self._judge("body velocity", m.stamp), (m.v_x, m.v_y)
        used = update_pair(
            self.ekf, judge, velocity, m.variance, foretold, reopen=s.SLIP_X, kept=POSE_KEPT
        )
        if not waits:
            self._advance(m.stamp)
        return used

    def _take_mark(self, m: Mark) -> bool:
        # The estimate stands at the newest step before the mark; from there on the robot has moved
        # as it did in that step, as far as is known, and the next step will say the rest.
        elapsed = 0.0 if self.stamp is None else (self.stamp - m.stamp) * NANOSECOND
        model = self.model()
        motion, _, by_motion = step_on_se2(0.0, (model.twist * elapsed).tolist())
        by_state = np.array(by_motion) @ model.jacobian * elapsed
        self.ekf.marks = self.marks.begun(m.stamp, np.array(motion), by_state, self.ekf.P)
        return True

    # --- how it works ----------------------------------------------------------------------------

    def _judge(self, sensor: str, stamp: int) -> Judge:
        """Of a sensor's measurement at a stamp [ns]."""
        return Judge(stamp, self._gates[sensor], self.health.sensor(sensor))

    def _may_be_pushed(self) -> bool:
        """Whether it may be turning with its tracks at rest."""
        tracks = self._tracks
        return (
            max(abs(tracks.left), abs(tracks.right)) < self._settings.standstill.track_speed
            and not self.stands
            and self.stamp is not None
            and (self._stood_at is None or self._stood_at < self.stamp)
            and self._imu.is_alive(self.stamp)
        )

    def _waits_for_imu(self, stamp: int) -> bool:
        """Whether a stamp [ns] lies in a step that the next IMU sample is to end."""
        if self.stamp is None or self._tracks.stamp == NEVER:
            return False
        return stamp > self.stamp and self._imu.is_due_after(stamp)

    def _pose_at(self, stamp: int) -> Foretold:
        """The pose at a stamp [ns], to which the filter advances unless the IMU will tell the way."""
        if self._waits_for_imu(stamp) and self.stamp is not None:
            model, elapsed = self.model(), (stamp - self.stamp) * NANOSECOND
            density = self._fast_slip_density(stamp, model)
            return pose_ahead(self.ekf.x, model, density, elapsed)
        self._advance(stamp)
        return pose_now(self.ekf.x)

    def _twist_at(self, stamp: int, *, waits: bool) -> Foretold:
        """The twist at a stamp [ns], to which a step begins unless that waits for the IMU to end it."""
        if not waits:
            self._begin_step(stamp)
        model = self.model()
        if not waits:
            return Foretold(model.twist, model.jacobian, np.zeros((3, 3)))
        density = self._fast_slip_density(stamp, model)
        return twist_ahead(self.ekf.x, model, density, self._imu.interval)

    def _fast_slip_density(self, stamp: int, model: TwistModel) -> Floats:
        """(3, 3) density of the fast slip from the estimate's stamp to a later one [ns]."""
        start = stamp if self.stamp is None else self.stamp
        return self._disturbances.fast_slip_density(
            self._tracks, model.by_speeds, self.slip_sigma(), start, stamp
        )

    def _track_change(self) -> TrackChange:
        tracks = self._tracks
        variance = self._disturbances.track_density(tracks) / tracks.interval
        age = 0.0 if self.stamp is None else tracks.age(self.stamp)
        return TrackChange(tracks.acceleration, tracks.acceleration_window, variance, age)

    def _advance(self, stamp: int) -> None:
        """Propagate to a stamp [ns]; one that is not later changes nothing."""
        self._begin_step(stamp)
        if self.stamp is None or self.stamp >= stamp:
            return
        dt = (stamp - self.stamp) * NANOSECOND
        noise = self._disturbances.of_step(self._tracks, self.slip_sigma())
        left, right = self._tracks.mean_speeds(self.stamp, stamp)
        self.ekf.predict_motion(dt, left, right, noise)
        self.stamp = stamp
        self._step_under_way = False

    def _begin_step(self, stamp: int) -> None:
        """Draw a new fast slip for the step to a stamp [ns], unless one is under way."""
        if self.stamp is None:
            self.stamp = stamp
        if stamp <= self.stamp or self._step_under_way:
            return
        self.ekf.x[s.FAST_SLIP] = 0.0
        # The density is white, so it is its integral over the step that matters.
        dt = (stamp - self.stamp) * NANOSECOND
        self.ekf.begin_step(dt, *self._tracks.mean_speeds(self.stamp, stamp))
        model = self.ekf.smooth_regressors(dt, *self.track_speeds)
        self.ekf.renew_fast_slip(self._fast_slip_density(stamp, model) / dt)
        self._step_under_way = True
