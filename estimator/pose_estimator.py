"""The streaming pose estimator: typed measurements in, one at a time; pose, twist and ICRs out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator import state as s
from estimator.admission import Admission, require_three
from estimator.ekf import IcrEkf, ProcessNoise, TwistModel
from estimator.errors import EstimatorError
from estimator.frames import Floats, paper_to_rep103, wrap_angle
from estimator.gating import Gate
from estimator.health import Health
from estimator.kinematics import IndexValues, icrs_from_indices
from estimator.log import NANOSECOND
from estimator.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    Measurement,
    PositionFix,
    TrackSpeeds,
)
from estimator.robot import Robot
from estimator.settings import Settings
from estimator.slip import slip_sigma
from estimator.standstill import StandstillDetector
from estimator.track_speeds import HeldTrackSpeeds
from estimator.variants import (
    DEFAULT_ADAPTATION,
    find_variant,
    initial_indices,
    motion_model,
    parameter_sigmas,
    slip_of,
)

# What a standing robot's velocity is known to be zero within [m/s, m/s, rad/s].
STANDSTILL_SIGMA = (1e-3, 1e-3, 1e-4)
# What a twist measurement does not move: the pose, which is to be continuous.
POSE_KEPT = (s.X, s.Y, s.YAW)
# What the IMU does not move either: it sees the track scale only through what else is wrong with the
# yaw rate, and would call it all scale. Fixes and body velocities show it for what it is.
IMU_KEPT = (*POSE_KEPT, s.TRACK_SCALE)
# How fast a robot may turn whose tracks are at rest, unless it is known to stand [rad/s].
PUSHED_W = 0.3
# Track speeds this many times beyond the fastest are no track speeds.
ABSURD_SPEED = 10.0
# The random walk of the parameters runs at its full rate from this difference of track speeds on [m/s].
FULL_TURNING = 0.1
# Share of the change of the track speeds that may be wrong because it comes late.
ACCELERATION_DOUBT = 0.2
# How fast the robot may begin to move sideways in a gap, as a share of how fast forward.
SIDEWAYS_IN_GAP = 0.1


class IcrPoints(NamedTuple):
    """ICRs of the left and the right track in base_link: (x forward, y left) [m]."""

    left: tuple[float, float]
    right: tuple[float, float]


class Snapshot(NamedTuple):
    """An estimate at one time: what `PoseEstimator`'s properties of the same names say."""

    stamp: int
    state: Floats
    covariance: Floats
    twist: Floats
    twist_covariance: Floats
    indices: IndexValues


class PoseEstimator:
    """Dead reckoning of a tracked or skid-steer robot from track speeds, IMU and occasional fixes.

    Feed measurements in the order of their stamps; read the estimate at any time. Poses are those of
    `base_link` in `odom`, twists are in `base_link` (REP-103).

    As REP-105 asks of `odom`, the pose is continuous: what says how fast the robot moves (tracks, IMU,
    body velocity) corrects the twist and then moves the pose by it, and only fixes make it jump. So the
    estimate stands at the newest IMU sample; track speeds wait for the IMU to say how much of them is
    slip, unless there is none.

    Args:
        robot: the robot, see `load_robot`.
        variant: name of a filter variant, see `estimator.variants.VARIANTS`.
        settings: everything that is no property of the robot.
        start: pose at the first track speeds: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].

    Raises:
        EstimatorError: there is no such variant, or a friction variant's robot has no stationary
            motions on its ground.
    """

    def __init__(
        self,
        robot: Robot,
        variant: str = "inertia-online",
        *,
        settings: Settings | None = None,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.robot = robot
        self.variant = find_variant(variant)
        self.settings = settings if settings is not None else Settings()
        self.health = Health()
        imu = robot.imu
        self._ekf = IcrEkf(
            motion_model(
                robot,
                self.variant,
                self.settings.form,
                slip_in_inertia=self.settings.inertia == "imu",
            )
        )
        self._slip = self.settings.slip or slip_of(robot, self.variant)
        adaptation = self.settings.adaptation or DEFAULT_ADAPTATION[self.variant.model]
        sigmas = parameter_sigmas(robot, self.variant, adaptation)

        ekf = self._ekf
        ekf.x[s.POSE] = start
        ekf.x[s.PARAMETERS] = initial_indices(robot, self.variant).as_array()
        spread = np.zeros(s.SIZE)
        spread[s.POSE] = start_sigma
        spread[s.PARAMETERS] = sigmas
        spread[s.GYRO_BIAS] = imu.gyro_bias_sigma
        spread[s.ACCELEROMETER_BIAS] = imu.accelerometer_bias_sigma
        spread[s.TRACK_SCALE] = robot.tracks.scale_sigma
        spread[s.GYRO_SCALE] = imu.gyro_scale_sigma
        ekf.P = np.diag(spread**2)
        self._bias_walk = np.zeros(s.SIZE)
        self._bias_walk[s.GYRO_BIAS] = imu.gyro_bias_walk
        self._bias_walk[s.ACCELEROMETER_BIAS] = imu.accelerometer_bias_walk
        self._parameter_walk = np.zeros(s.SIZE)
        self._parameter_walk[s.PARAMETERS] = sigmas * adaptation.walk

        self._stamp: int | None = None
        # Whether the fast slip of the next step is drawn, and the pose has not got there yet.
        self._step_under_way = False
        self._admission = Admission(self.settings.late, self.settings.longest_gap)
        self._tracks = HeldTrackSpeeds(
            self.settings.hold, self.settings.gap_acceleration, robot.vehicle.max_track_speed
        )
        self._imu_interval = 0.01
        gates = self.settings.gates
        self._gates = {
            "gyro": Gate(1, gates),
            "accelerometer": Gate(1, gates),
            "position": Gate(2, gates),
            "heading": Gate(1, gates),
            "body velocity x": Gate(1, gates),
            "body velocity y": Gate(1, gates),
        }
        self._standstill = StandstillDetector(self.settings.standstill, imu.gyro_noise_density)
        self._stands = False

    # --- what it says -------------------------------------------------------------------------

    @property
    def stamp(self) -> int | None:
        """Time of the estimate [ns]; None before the first track speeds or fix."""
        return self._stamp

    @property
    def pose(self) -> Floats:
        """(3,) x, y [m], yaw [rad] of base_link in odom; yaw counts full turns."""
        return self._ekf.x[s.POSE].copy()

    @property
    def pose_covariance(self) -> Floats:
        """(3, 3) covariance of `pose` in the axes of odom."""
        return self._ekf.P[s.POSE, s.POSE].copy()

    @property
    def twist(self) -> Floats:
        """(3,) v_x forward, v_y left [m/s], w counter-clockwise [rad/s] of base_link."""
        return self._model().twist.copy()

    @property
    def twist_covariance(self) -> Floats:
        """(3, 3) covariance of `twist`."""
        jacobian = self._model().jacobian
        return np.asarray(jacobian @ self._ekf.P @ jacobian.T)

    @property
    def indices(self) -> IndexValues:
        """Sliding, eccentricity and steering efficiency of the present motion."""
        return self._model().motion.indices

    @property
    def icrs(self) -> IcrPoints:
        """ICRs of the tracks in base_link by (28) to (30), of the present motion."""
        icrs = icrs_from_indices(self.indices, self.robot.vehicle.track_gauge)
        left = paper_to_rep103(icrs.x_ICRl, icrs.y_ICR)
        right = paper_to_rep103(icrs.x_ICRr, icrs.y_ICR)
        return IcrPoints(left, right)

    @property
    def parameters(self) -> dict[str, float]:
        """The eight parameters by name, as estimated; units of the gains as in docs/model.md."""
        return dict(zip(s.PARAMETER_NAMES, self._ekf.x[s.PARAMETERS].tolist(), strict=True))

    @property
    def biases(self) -> dict[str, float]:
        """Biases and scales by their names in `estimator.state`."""
        names = s.STATE_NAMES[s.GYRO_BIAS : s.GYRO_SCALE + 1]
        return dict(zip(names, self._ekf.x[s.GYRO_BIAS : s.GYRO_SCALE + 1].tolist(), strict=True))

    @property
    def state(self) -> Floats:
        """(SIZE,) copy of the filter's state, see `estimator.state`."""
        return self._ekf.x.copy()

    @property
    def covariance(self) -> Floats:
        """(SIZE, SIZE) copy of the filter's covariance."""
        return self._ekf.P.copy()

    def snapshot(self) -> Snapshot:
        """State, twist and indices at once, for the price of one evaluation of the model.

        Raises:
            EstimatorError: nothing was fed yet.
        """
        if self._stamp is None:
            raise EstimatorError("there is no estimate before the first measurement")
        model = self._model()
        return Snapshot(
            self._stamp,
            self._ekf.x.copy(),
            self._ekf.P.copy(),
            model.twist.copy(),
            model.jacobian @ self._ekf.P @ model.jacobian.T,
            model.motion.indices,
        )

    @property
    def stands(self) -> bool:
        """Whether the robot was found standing at the newest IMU sample."""
        return self._stands

    # --- what it is told ------------------------------------------------------------------------

    def feed(self, measurement: Measurement) -> bool:
        """Take one measurement.

        A measurement that cannot be right (not finite, bad variance, duplicate or backward stamp) and
        one that the gates reject leave the estimate as it was but for the passing of time, and are
        counted in `health`.

        Returns:
            Whether the measurement was used.

        Raises:
            EstimatorError: the object is no measurement.
        """
        match measurement:
            case TrackSpeeds():
                return self._feed_track_speeds(measurement)
            case ImuSample():
                return self._feed_imu(measurement)
            case PositionFix():
                return self._feed_position(measurement)
            case HeadingFix():
                return self._feed_heading(measurement)
            case BodyVelocity():
                return self._feed_body_velocity(measurement)
        raise EstimatorError(
            f"no measurement: {measurement!r}; feed TrackSpeeds, ImuSample, PositionFix, HeadingFix "
            "or BodyVelocity"
        )

    def _feed_track_speeds(self, m: TrackSpeeds) -> bool:
        if not self._admissible("tracks", m.stamp, (m.left, m.right)):
            return False
        if max(abs(m.left), abs(m.right)) > ABSURD_SPEED * self.robot.vehicle.max_track_speed:
            self.health.sensor("tracks").rejected["absurdly fast"] += 1
            return False
        tracks = self._tracks
        if tracks.stamp is None:
            self._stamp = m.stamp
        else:
            # The old speeds have nothing to say beyond their own stamp, unless they are all there is
            # to bridge a hole with, up to where the new ones begin to speak.
            hole = tracks.is_hole(m.stamp)
            until = m.stamp - int(tracks.interval / NANOSECOND) if hole else tracks.stamp
            self._advance(until)
        tracks.take(m.stamp, m.left, m.right)
        if not self._imu_is_alive(m.stamp):
            self._advance(m.stamp)
        self._standstill.track_speeds(m.stamp, m.left, m.right)
        self.health.sensor("tracks").used += 1
        return True

    def _feed_imu(self, m: ImuSample) -> bool:
        rates, force = m.angular_velocity, m.linear_acceleration
        require_three("angular_velocity", rates)
        if force is not None:
            require_three("linear_acceleration", force)
        before = self._admission.newest.get("imu")
        if not self._admissible("imu", m.stamp, (*rates, *(() if force is None else force))):
            return False
        if self._tracks.stamp is None:
            # Not a robot at rest, but one of which nothing is known yet.
            self.health.sensor("imu").rejected["before the first track speeds"] += 1
            return False
        if before is not None:
            self._imu_interval = min((m.stamp - before) * NANOSECOND, self.settings.hold)
        ekf = self._ekf
        reading = self._yaw_rate_reading(m)
        bias_sigma = math.sqrt(ekf.P[s.GYRO_BIAS, s.GYRO_BIAS])
        self._stands = self._standstill.yaw_rate(
            m.stamp, reading, float(ekf.x[s.GYRO_BIAS]), bias_sigma
        )
        self._begin_step(m.stamp)
        if self._stands:
            self._update_standstill()
        model, linearised_at = self._model(), ekf.x.copy()
        used = self._update_gyro(reading, model)
        if force is not None and self.settings.use_accelerometer and not self._stands:
            self._update_accelerometer(force, model, linearised_at)
        ekf.keep_inside_bounds()
        self._advance(m.stamp)
        return used

    def _update_standstill(self) -> None:
        """A standing robot's twist is zero."""
        self.health.standstill_updates += 1
        model, linearised_at = self._model(), self._ekf.x.copy()
        for axis, sigma in enumerate(STANDSTILL_SIGMA):
            row = model.jacobian[axis]
            moved = float(row @ (self._ekf.x - linearised_at))
            residual = -float(model.twist[axis]) - moved
            self._ekf.update_scalar(residual, row, sigma**2, kept=IMU_KEPT)

    def _update_gyro(self, reading: float, model: TwistModel) -> bool:
        """Yaw rate times scale, plus bias."""
        rate, scale = float(model.twist[2]), 1.0 + float(self._ekf.x[s.GYRO_SCALE])
        row = scale * model.jacobian[2]
        row[s.GYRO_BIAS] += 1.0
        row[s.GYRO_SCALE] += rate
        residual = reading - scale * rate - float(self._ekf.x[s.GYRO_BIAS])
        variance = self.robot.imu.gyro_noise_density**2 / self._imu_interval
        # The newest track speeds are averages of the time before, so they come late.
        late = float(model.by_speeds[2] @ self._tracks.acceleration) * self._track_age()
        gate = self._gates["gyro"]
        return self._update("gyro", gate, residual, row, variance + late**2, (s.SLIP_W,), IMU_KEPT)

    def _update_accelerometer(
        self, force: tuple[float, float, float], model: TwistModel, linearised_at: Floats
    ) -> None:
        """Specific force to the left: dv_y/dt + w v_x at the IMU's place, plus bias.

        The forward one says little: it is the change of the track speeds, which are better known.
        """
        imu, ekf = self.robot.imu, self._ekf
        v_x, _, w = model.twist.tolist()
        by_v_x, _, by_w = model.jacobian
        l_x, l_y, _ = imu.position
        # What the kinematics change by, from the change of the track speeds.
        dv_y, dw = (model.by_speeds[1:] @ self._tracks.acceleration).tolist()
        measured = float(self.robot.imu_rotation[1] @ np.array(force))
        bias = float(linearised_at[s.ACCELEROMETER_BIAS])
        predicted = dv_y + w * v_x + dw * l_x - w * w * l_y + bias
        row = v_x * by_w + w * by_v_x - 2.0 * w * l_y * by_w
        row[s.ACCELEROMETER_BIAS] += 1.0
        # The slip's own change over the sample, what comes late of the derivative, and its noise.
        rough = 2.0 * float(self._slip_sigma()[1]) ** 2 / self._slip.time_constant
        white = (imu.accelerometer_noise_density**2 + rough) / self._imu_interval
        late = ACCELERATION_DOUBT * math.hypot(dv_y, dw * l_x)
        by_change = model.by_speeds[1] + l_x * model.by_speeds[2]
        sample_variance = self._track_density() / self._tracks.interval
        change = (
            sample_variance * float(by_change @ by_change) / self._tracks.acceleration_window**2
        )
        self._update(
            "accelerometer",
            self._gates["accelerometer"],
            measured - predicted - float(row @ (ekf.x - linearised_at)),
            row,
            white + late**2 + change,
            reopen=(s.ACCELEROMETER_BIAS,),
            kept=IMU_KEPT,
        )

    def _feed_position(self, m: PositionFix) -> bool:
        if not self._admissible("position", m.stamp, (m.x, m.y), m.variance):
            return False
        self._advance(m.stamp)
        ekf, gate, health = self._ekf, self._gates["position"], self.health.sensor("position")
        residual = np.array([m.x, m.y]) - ekf.x[:2]
        spread = ekf.P[:2, :2] + m.variance * np.eye(2)
        nis = float(residual @ np.linalg.solve(spread, residual))
        if not gate.admits(nis):
            if not gate.must_reacquire:
                health.rejected["gate"] += 1
                return False
            gate.reacquired()
            ekf.P[:2, :2] += np.eye(2) * float(residual @ residual)
        else:
            health.nis_sum += nis
            health.degrees += 2
        health.used += 1
        for axis, value in enumerate((m.x, m.y)):
            row = np.zeros(s.SIZE)
            row[axis] = 1.0
            ekf.update_scalar(value - float(ekf.x[axis]), row, m.variance)
        ekf.keep_inside_bounds()
        return True

    def _feed_heading(self, m: HeadingFix) -> bool:
        if not self._admissible("heading", m.stamp, (m.yaw,), m.variance):
            return False
        self._advance(m.stamp)
        row = np.zeros(s.SIZE)
        row[s.YAW] = 1.0
        residual = float(wrap_angle(m.yaw - self._ekf.x[s.YAW]))
        used = self._update(
            "heading", self._gates["heading"], residual, row, m.variance, (s.YAW,), ()
        )
        self._ekf.keep_inside_bounds()
        return used

    def _feed_body_velocity(self, m: BodyVelocity) -> bool:
        if not self._admissible("body velocity", m.stamp, (m.v_x, m.v_y), m.variance):
            return False
        self._begin_step(m.stamp)
        model, linearised_at = self._model(), self._ekf.x.copy()
        used = True
        for axis, value in enumerate((m.v_x, m.v_y)):
            row = model.jacobian[axis]
            moved = float(row @ (self._ekf.x - linearised_at))
            used &= self._update(
                "body velocity",
                self._gates[f"body velocity {'xy'[axis]}"],
                value - float(model.twist[axis]) - moved,
                row,
                m.variance,
                reopen=(s.SLIP_X + axis,),
                kept=POSE_KEPT,
            )
        self._ekf.keep_inside_bounds()
        self._advance(m.stamp)
        return used

    # --- how it works ---------------------------------------------------------------------------

    def _update(
        self,
        sensor: str,
        gate: Gate,
        residual: float,
        row: Floats,
        variance: float,
        reopen: tuple[int, ...],
        kept: tuple[int, ...],
    ) -> bool:
        """A gated scalar update; when re-acquiring, the states in `reopen` are made uncertain first."""
        health = self.health.sensor(sensor)
        nis = self._ekf.innovation(residual, row, variance).nis
        if not gate.admits(nis):
            if not gate.must_reacquire:
                health.rejected["gate"] += 1
                return False
            gate.reacquired()
            for index in reopen:
                self._ekf.P[index, index] += residual**2
        else:
            health.nis_sum += nis
            health.degrees += 1
        self._ekf.update_scalar(residual, row, variance, kept=kept)
        health.used += 1
        return True

    def _admissible(
        self, stream: str, stamp: int, values: Sequence[float], variance: float = 1.0
    ) -> bool:
        """Whether a measurement can be right by itself; if not, it is counted."""
        reason = self._admission.objection(stream, stamp, self._stamp, values, variance)
        if reason is not None:
            self.health.sensor(stream).rejected[reason] += 1
        return reason is None

    def _imu_is_alive(self, stamp: int) -> bool:
        """Whether an IMU sample may be expected that tells how the robot moved up to this stamp."""
        newest = self._admission.newest.get("imu")
        return newest is not None and (stamp - newest) * NANOSECOND <= self.settings.hold

    def _advance(self, stamp: int) -> None:
        """Propagate to a stamp [ns]; one that is not later changes nothing."""
        self._begin_step(stamp)
        if self._stamp is None or self._stamp >= stamp:
            return
        dt = (stamp - self._stamp) * NANOSECOND
        walk = self._bias_walk + self._parameter_walk * self._turning()
        noise = ProcessNoise(self._slip_sigma(), self._slip.time_constant, walk)
        left, right = self._tracks.mean_speeds(self._stamp, stamp)
        self._ekf.predict_motion(dt, left, right, noise)
        self._stamp = stamp
        self._step_under_way = False

    def _begin_step(self, stamp: int) -> None:
        """Draw a new fast slip for the step to a stamp [ns], unless one is under way."""
        if self._stamp is None:
            self._stamp = stamp
        if stamp <= self._stamp or self._step_under_way:
            return
        self._ekf.x[s.FAST_SLIP] = 0.0
        # The density is white, so it is its integral over the step that matters.
        dt = (stamp - self._stamp) * NANOSECOND
        self._ekf.renew_fast_slip(self._fast_slip_density(self._stamp, stamp) / dt)
        self._step_under_way = True

    def _fast_slip_density(self, start: int, end: int) -> Floats:
        """(3, 3) density of the fast slip between two stamps [ns].

        It is the error of the track speeds, the white part of the slip, and what the track speeds may
        have changed by while they are too old to be trusted.
        """
        by_speeds = self._model().by_speeds
        density = self._track_density() * (by_speeds @ by_speeds.T)
        sigma_w = float(self._slip_sigma()[2])
        density[2, 2] += 2.0 * self._slip.white_time * sigma_w**2
        share = np.array([1.0, SIDEWAYS_IN_GAP, 2.0 / self.robot.vehicle.track_gauge])
        density += np.diag(self._tracks.gap_density(start, end) * share**2)
        return np.asarray(density)

    def _track_density(self) -> float:
        """Density of the error of each track's speed [m²/s]."""
        return 0.0 if self._tracks.stopped else self.robot.tracks.speed_noise_density**2

    def _track_age(self) -> float:
        """Age of the newest track speeds [s]."""
        return 0.0 if self._stamp is None else self._tracks.age(self._stamp)

    def _model(self) -> TwistModel:
        return self._ekf.twist_model(*self._tracks.speeds_at(self._stamp))

    def _turning(self) -> float:
        """How much of the parameters the motion can show, from 0 (straight, standing) to 1."""
        return min(1.0, abs(self._tracks.right - self._tracks.left) / FULL_TURNING)

    def _slip_sigma(self) -> Floats:
        """(3,) standard deviation of the slip at the present track speeds."""
        gauge = self.robot.vehicle.track_gauge * max(1.0, float(self._ekf.x[s.ETA0]))
        left, right = self._tracks.left, self._tracks.right
        sigma = slip_sigma(left, right, self._slip, gauge)
        resting = max(abs(left), abs(right)) < self.settings.standstill.track_speed
        if (
            resting
            and not self._stands
            and self._stamp is not None
            and self._imu_is_alive(self._stamp)
        ):
            sigma[2] = PUSHED_W
        return sigma

    def _yaw_rate_reading(self, m: ImuSample) -> float:
        """Rate about base_link's z axis as the gyros say [rad/s]."""
        imu, rotation = self.robot.imu, self.robot.imu_rotation
        if imu.gyro_axes == "z":
            return float(m.angular_velocity[2] / (rotation[2, 2] * imu.gyro_scale))
        return float(rotation[2] @ np.array(m.angular_velocity)) / imu.gyro_scale
