"""Step in traced numbers: draw the fast slip, update by the IMU, propagate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.engine import model
from icreckon.estimator.engine.covariance import Covariance, Motion, Vector, combined, dot, shift_of
from icreckon.estimator.engine.lane import FAST, FilterShape, Lane, PlainNumbers, values_for
from icreckon.estimator.engine.layout import IMU_GATES, SLIP_SHARES, TURN
from icreckon.estimator.filter.changes import moved_values
from icreckon.estimator.motion.propagation import GaussMarkov
from icreckon.estimator.sensors.imu_noise import ImuNoise
from icreckon.estimator.sensors.measurement_models import ACCELEROMETERS
from icreckon.estimator.sensors.sensor_models import STANDSTILL_VARIANCE, TrackChange
from icreckon.estimator.sensors.step_inputs import StepInputs
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.elementary import exponential
from icreckon.estimator.tracing.kernel import Kernel
from icreckon.estimator.tracing.trace import Real, Truth, select

# Parameters, biases and gravity along the ground.
WALKING = (*range(s.PARAMETERS.start, s.TRACK_SCALE), s.GRAVITY_X, s.GRAVITY_Y)
GRAVITY = (s.GRAVITY_X, s.GRAVITY_Y)
INPUT_FORCES = ("force_x", "force_y")


class StepKind(NamedTuple):
    """Kind of a step, on which the code of its kernel depends."""

    draws: bool = True  # it begins with a new fast slip
    moves: bool = True  # time passes
    resumes: bool = False  # the fast slip is that of a step that has begun before
    may_stand: bool = False  # it finds the lanes that stand at its end
    imu: bool = True  # there is an IMU sample at its end
    accelerometer: bool = True  # update with the sample's specific force
    twist: bool = False  # compute the body velocity at its end
    innovations: bool = False  # store innovations and their covariances
    fast_slip: bool = False  # store the fast slip at its end
    in_step: bool = False  # it is a part of a step, whose other parts are other kernels

    def reporting(self) -> StepKind:
        """Add the outputs of an estimate."""
        return self._replace(twist=True, innovations=True, fast_slip=self.moves)


class TracedPose(NamedTuple):
    """Predicted pose, see `icreckon.estimator.sensors.predictions.Prediction`."""

    values: Sequence[Real]  # (3,) x, y, yaw
    rows: Sequence[Vector]  # (3,) derivatives by the states
    covariance: Sequence[Sequence[Real]]  # (3, 3) covariance of the error that is not in the state


class MovedPose(NamedTuple):
    """Move of the pose, and of the height if it is a state (k = 4), over a step."""

    step: Sequence[Real]  # (k,) x, y [m], yaw [rad], height [m] that are added
    yaws: Sequence[Real]  # (k,) their derivatives by the yaw
    M: Sequence[Sequence[Real]]  # (k, k) their derivatives by twist and climb, over the time step
    by_slip: Sequence[Sequence[Real]]  # (k, 3) their derivatives by the slip, over the time step
    rows: Sequence[Vector]  # (k,) derivatives of twist and climb by the states
    climb: model.Climb | None  # climb; None without a height
    yaw_by_pitch: Real  # yaw rate over pitch rate


def step_kernel(
    name: str, shape: FilterShape, kind: StepKind, numbers: PlainNumbers | None = None
) -> Kernel:
    """Make the kernel of a step; for `numbers` see `Lane`."""
    lane = Lane(shape, numbers, with_fast_slip=kind.resumes, innovations=kind.innovations)
    step = Step(lane, kind)
    if kind.draws:
        step.draw_fast_slip()
    if kind.may_stand:
        step.update_standstill()
    if kind.imu:
        step.update_gyro()
        if kind.accelerometer:
            for axis in range(2):
                step.update_accelerometer(axis)
        lane.cover_rounding()
        lane.keep_inside_bounds(by_imu=True)
    elif kind.may_stand:
        lane.cover_rounding()
    if kind.moves:
        step.propagate()
    if kind.twist:
        lane.store_twist()
    return lane.kernel(name, with_fast_slip=kind.fast_slip)


def twist_kernel(name: str, shape: FilterShape, numbers: PlainNumbers | None = None) -> Kernel:
    """Make the kernel that evaluates a body velocity with its derivatives."""
    lane = Lane(shape, numbers, with_fast_slip=True)
    shares = [lane.constant(name) for name in SLIP_SHARES]
    now = lane.twist_model(lane.input("left"), lane.input("right"), shares)
    lane.store_motion(now)
    return lane.kernel(name, with_fast_slip=True)


class Step:
    """Step of a lane: inputs and intermediate results that its methods use."""

    def __init__(self, lane: Lane, kind: StepKind) -> None:
        self.lane, self.kind = lane, kind
        step_input, constant = lane.input, lane.constant
        self.slip = lane.slip
        self.imu_position = constant("imu_x"), constant("imu_y")
        self.noise = ImuNoise(*(step_input(f"{gate}_density") for gate in IMU_GATES))
        self.smooth = step_input("smooth_left"), step_input("smooth_right")  # smoothed speeds [m/s]
        self.change = TrackChange(
            (step_input("acceleration_left"), step_input("acceleration_right")),
            step_input("acceleration_variance"),
        )
        self.stands, self.pushed = self._standing()
        left, right = step_input("left"), step_input("right")
        if kind.draws and lane.shape.model.memory:
            lane.advance_model(constant("dt"), left, right)
        self.model = lane.smoothed_twist(left, right, self._shares())
        # Rows (3,) of the derivatives of the twist by the parameters alone.
        self.regressors = tuple(
            {i: row[i] for i in lane.layout.parameters if i in row} for row in self.model.rows
        )

    def _standing(self) -> tuple[Truth, Truth]:
        """Lanes that this kernel finds standing, and lanes that may be pushed.

        Tracks of a pushed robot are at rest, too, but it does not stand.
        """
        lane, kind = self.lane, self.kind
        tracks_rest = lane.input("slow") > 0.5
        if kind.may_stand:
            mean = lane.input("quiet_mean")
            stands = mean == mean  # not NaN
            return stands, tracks_rest & ~stands
        if kind.imu and not kind.in_step:
            # A step with an IMU sample that cannot find standing lanes has none.
            lane.stores["stood"] = 0.0
            return False, tracks_rest
        # The kernel before, of this step or of the newest IMU sample, found the standing lanes.
        return False, tracks_rest & (lane.row("stood") < 0.5)

    def _fades(self) -> list[GaussMarkov]:
        """Gauss-Markov processes of the slip, one for each component, over the step."""
        lane = self.lane
        times = model.slip_times(self.slip.time_constant, lane.row("slip_factor"))
        return [model.gauss_markov(lane.constant("dt"), tau) for tau in times]

    def _shares(self) -> list[Real]:
        """Factors on the slip: its mean over the step is measured and moves the robot."""
        kind = self.kind
        # An IMU sample without a step shows the slip of its moment.
        is_moment = kind.imu and not (kind.moves or kind.in_step)
        return [1.0, 1.0, 1.0] if is_moment else [fade.mean for fade in self._fades()]

    def _sigma(self) -> Any:
        """Standard deviation (3,) of the slip [m/s, m/s, rad/s]."""
        lane = self.lane
        gauge = lane.constant("gauge")
        factor = lane.row("slip_factor")
        return model.slip_at(*self.smooth, self.slip, gauge, lane.eta, self.pushed, factor)

    def draw_fast_slip(self) -> None:
        """Draw a new fast slip, independent of all states."""
        lane, now = self.lane, self.model
        density = self.density(now)
        per_dt = 1.0 / lane.constant("dt")
        pairs = [(i, j) for i in range(3) for j in range(i, 3)]
        variances = [density[i][j] * per_dt for i, j in pairs]
        for (i, j), value in zip(pairs, variances, strict=True):
            lane.P.add(FAST[i], FAST[j], value)
        lane.report("renewed", variances)
        lane.P.states = sorted({*lane.P.states, *FAST})

    def _follow_regressors(self, now: model.TracedTwist, speeds: Any, shares: Any) -> None:
        """Smooth the regressors: derivatives by the parameters, and the yaw rate.

        Noise in a regressor biases the state that it multiplies (errors in variables). So regressors are
        those without slip, at the yaw rate that tracks and estimate share.
        """
        lane, x, estimated_rate = self.lane, self.lane.x.copy(), now.twist[2]
        track_rate = estimated_rate - (shares[2] * x[s.SLIP_W] + x[s.FAST_SLIP_W])
        # The smaller one of the yaw rates with and without slip; zero if their signs differ.
        smaller = select(abs(estimated_rate) < abs(track_rate), estimated_rate, track_rate)
        shared_rate = select(estimated_rate * track_rate > 0.0, smaller, 0.0)
        # Least change of the track speeds that gives the shared yaw rate without slip.
        by_left, by_right = now.by_speeds[2]
        square = by_left * by_left + by_right * by_right
        scale = (shared_rate - track_rate) / select(square > 0.0, square, 1.0)
        x[s.SLIP] = x[s.FAST_SLIP] = 0.0
        parameters = lane.layout.parameters
        left, right = speeds[0] + by_left * scale, speeds[1] + by_right * scale
        at_turn = model.twist_model(x, lane.model_inputs, left, right, shares, parameters)
        regressors = {
            f"r{axis}_{i}": value
            for axis, row in enumerate(at_turn.rows)
            for i, value in row.items()
            if i in parameters
        }
        for name, value in (*regressors.items(), (TURN, shared_rate)):
            before = lane.row(name)
            lane.stores[name] = before + lane.constant("smoothing") * (value - before)

    def predict_pose(self) -> TracedPose:
        """Predict the pose a step later, see `sensors.predictions.pose_ahead`."""
        lane = self.lane
        dt, now = lane.constant("dt"), self.model
        density = self.density(now)
        step, by_yaw, M = model.step_on_se2(lane.x[s.YAW], [part * dt for part in now.twist])
        yaws = (by_yaw[0], by_yaw[1], 0.0)
        rows: list[Vector] = []
        for i in range(3):
            row: Vector = {i: 1.0}
            row[s.YAW] = row.get(s.YAW, 0.0) + yaws[i]
            for k in range(3):
                for j, value in now.rows[k].items():
                    if j not in FAST:
                        row[j] = row.get(j, 0.0) + M[i][k] * value * dt
            rows.append(row)
        covariance = [
            [
                sum(M[i][a] * density[a][b] * M[j][b] for a in range(3) for b in range(3)) * dt
                for j in range(3)
            ]
            for i in range(3)
        ]
        return TracedPose([lane.x[i] + step[i] for i in range(3)], rows, covariance)

    def density(self, now: model.TracedTwist) -> Any:
        """Density (3, 3) of the fast slip."""
        lane = self.lane
        inputs = StepInputs._make(map(lane.input, StepInputs._fields))
        of_w, dt = inputs.speed_decay * self._sigma()[2], lane.constant("dt")
        white = model.white_density(self.slip.white_time, self._fades()[2].integral, dt)
        return model.fast_slip_density(inputs, now.by_speeds, white, of_w, dt)

    def update_standstill(self) -> None:
        """Update standing lanes with a twist of zero.

        Before it, bias and yaw become uncertain if the gyro's bias has jumped.
        """
        lane, now = self.lane, self.model
        variance = lane.P.entry(s.GYRO_BIAS, s.GYRO_BIAS)
        creep = lane.input("creep_density")
        variance = variance + (self.noise.gyro + creep) / lane.constant("standstill_duration")
        times = lane.input("rest_time"), lane.input("drive_time")
        # The mean is new once the robot has stopped, or once a change of it at rest has lasted.
        is_new = self.stands & (times[0] + times[1] >= lane.constant("standstill_duration"))
        mean = select(is_new, lane.input("quiet_mean"), lane.x[s.GYRO_BIAS])
        lane.add_doubt(*model.bias_change(mean - lane.x[s.GYRO_BIAS], variance, *times))
        before = lane.x.copy()
        creeps = 0.0, 0.0, creep / lane.constant("interval")
        for axis, (still, creeping) in enumerate(zip(STANDSTILL_VARIANCE, creeps, strict=True)):
            row = now.rows[axis]
            z = -now.twist[axis] - shift_of(row, lane.x, before)
            part = (1.0, self.regressors[axis])
            R = still + creeping
            lane.update(z, row, R, part, fixed=lane.fixed_for_gyro, only=self.stands)
        stands = trace.truth_as_number(self.stands)
        lane.stores["standstill"] = lane.row("standstill") + stands
        lane.stores["stood"] = stands
        left, right = lane.input("left"), lane.input("right")
        self.model = lane.smoothed_twist(left, right, self._shares())

    def update_gyro(self) -> None:
        """Update with the yaw rate: that of the robot times scale, plus bias."""
        lane, now = self.lane, self.model
        self.linearised_at = lane.x.copy()
        scale = 1.0 + lane.x[s.GYRO_SCALE]
        H = {i: scale * value for i, value in now.rows[2].items()}
        for state, derivative in ((s.GYRO_BIAS, 1.0), (s.GYRO_SCALE, lane.row(TURN))):
            if state in lane.P.states:
                H[state] = H.get(state, 0.0) + derivative
        rate = lane.input("rate")
        works = rate == rate  # NaN if the gyro fails
        z = select(works, rate, 0.0) - scale * now.twist[2] - lane.x[s.GYRO_BIAS]
        R = self.noise.gyro / lane.constant("interval")
        part, fixed = (scale, self.regressors[2]), lane.fixed_for_gyro
        lane.gated(
            "gyro", z, H, R, part, inflated=s.SLIP_W, fixed=fixed, stand_in=s.SLIP_W, only=works
        )

    def update_accelerometer(self, axis: int) -> None:
        """Update with the specific force forward (axis 0) or to the left (axis 1)."""
        lane, now, across = self.lane, self.model, 1 - axis
        rough = model.change_density(self._sigma()[axis], self.slip.time_constant)
        forecast = model.accelerometer_forecast(
            self.imu_position,
            axis,
            self.noise[1 + axis],
            lane.constant("interval"),
            now.twist,
            now.by_speeds,
            self.change,
            rough,
        )
        turning, sideways = (forecast.by_w, now.rows[2]), (forecast.by_across, now.rows[across])
        row = combined({}, turning, sideways)
        gravity, bias = s.GRAVITY_X + axis, s.ACCELEROMETER_BIAS_X + axis
        for state, derivative in ((gravity, -1.0), (bias, 1.0)):
            if state in lane.P.states:
                row[state] = row.get(state, 0.0) + derivative
        linearised_at = self.linearised_at
        predicted = forecast.predicted + linearised_at[bias] - linearised_at[gravity]
        force = lane.input(INPUT_FORCES[axis])  # NaN if there is none
        used = (lane.input("unknown") < 0.5) & (force == force)
        force = select(used, force, 0.0)
        z = force - predicted - shift_of(row, lane.x, linearised_at)
        lane.gated(
            ACCELEROMETERS[axis],
            z,
            row,
            forecast.variance,
            (forecast.by_w, self.regressors[2]),
            (forecast.by_across, self.regressors[across]),
            inflated=bias,
            fixed=lane.fixed_for_imu,
            only=used,
        )

    def propagate(self) -> None:
        """Propagate to the end of the step, see `reference.ekf.IcrEkf.predict_motion`."""
        lane, fades = self.lane, self._fades()
        missing, shares = lane.input("missing"), [fade.mean for fade in fades]
        speeds = lane.input("left") + missing, lane.input("right") + missing
        now = lane.smoothed_twist(*speeds, shares)
        self._follow_regressors(now, speeds, shares)
        rates = (math.nan, math.nan)
        if self.kind.accelerometer:
            rates = lane.input("roll_rate"), lane.input("pitch_rate")
        tilt = model.tilting(lane.x, *rates)
        move = self._moved_pose(now, tilt)
        dt = lane.constant("dt")
        motion = Motion(
            move.rows,
            [[part * dt for part in row] for row in move.M],
            move.yaws,
            self._transition(now, tilt, fades),
            *self._process_noise(move, tilt, fades),
        )
        with_rows = self._with_rows(now, move.climb)
        if lane.shape.reports:
            self._report_motion(motion, with_rows, fades, move.step)
        lane.P = self._propagated(motion, with_rows)
        before = lane.x.copy()
        for i, rate in zip(GRAVITY, (tilt.pitch_rate, -tilt.roll_rate), strict=True):
            along = {k: motion.faded[i][k] for k in GRAVITY}
            lane.x[i] = dot(values_for(before, along), along) + tilt.down * rate * dt
        for i, by in enumerate(move.step):
            lane.x[i] = lane.x[i] + by
        for i, fade in zip(range(s.SLIP.start, s.SLIP.stop), fades, strict=True):
            lane.x[i] = lane.x[i] * fade.decay
        self.model = now

    def _moved_pose(self, now: model.TracedTwist, tilt: model.Tilting) -> MovedPose:
        """Move by a body velocity along the sloping ground, seen from above."""
        x, dt = self.lane.x, self.lane.constant("dt")
        slope = x[s.GRAVITY_X], x[s.GRAVITY_Y]
        by_twist, yaw_by_pitch = model.horizontal_projection(slope)
        twist = [
            sum(by * part for by, part in zip(row, now.twist, strict=True)) for row in by_twist
        ]
        twist[s.YAW] = twist[s.YAW] + yaw_by_pitch * tilt.pitch_rate
        step, by_yaw, by_pose = model.step_on_se2(x[s.YAW], [part * dt for part in twist])
        M, yaws = _product(by_pose, by_twist), [*by_yaw, 0.0]
        if s.Z not in self.lane.shape.states:
            return MovedPose(step, yaws, M, M, now.rows, None, yaw_by_pitch)
        climb = model.climb(now, slope)
        return MovedPose(
            step=[*step, climb.rate * dt],
            yaws=[*yaws, 0.0],
            M=[*([*row, 0.0] for row in M), [0.0, 0.0, 0.0, 1.0]],
            by_slip=[*M, [*climb.by_twist, 0.0]],
            rows=[*now.rows, climb.times(now.rows, {i: {i: 1.0} for i in GRAVITY})],
            climb=climb,
            yaw_by_pitch=yaw_by_pitch,
        )

    def _process_noise(
        self, move: MovedPose, tilt: model.Tilting, fades: Sequence[GaussMarkov]
    ) -> tuple[dict[tuple[int, int], Real], Vector]:
        """Covariances that pose and height gain, and the variance that each state gains."""
        lane, sigma, dt = self.lane, self._sigma(), self.lane.constant("dt")
        walk = self._walks(tilt)
        # Slip of stale speeds decays with them: unknown motion has an error of its own.
        fading = [lane.input("speed_decay") * part for part in sigma]
        noise = _noise_of_pose(move.rows, move.M, move.by_slip, walk, fading, fades, dt)
        noise[s.YAW, s.YAW] = noise[s.YAW, s.YAW] + lane.input("turn_density") * dt
        own = {i: walk.get(i, 0.0) * dt for i in lane.P.states}
        if s.GRAVITY_X in own:
            by_walk = move.yaw_by_pitch * tilt.pitch_by_walk
            turned = by_walk * own[s.GRAVITY_X]
            noise[s.YAW, s.GRAVITY_X] = noise[s.YAW, s.GRAVITY_X] + turned
            noise[s.YAW, s.YAW] = noise[s.YAW, s.YAW] + by_walk * turned
        for axis, fade in enumerate(fades):
            own[s.SLIP.start + axis] = sigma[axis] * sigma[axis] * fade.final
        return noise, own

    def _transition(
        self, now: model.TracedTwist, tilt: model.Tilting, fades: Sequence[GaussMarkov]
    ) -> dict[int, Vector]:
        """Rows of the transition of all states but the pose.

        Slip fades, gravity turns with the body, and what else there is stays.
        """
        lane, dt = self.lane, self.lane.constant("dt")
        rows: dict[int, Vector] = {i: {i: 1.0} for i in lane.P.states}
        for i, fade in zip(range(s.SLIP.start, s.SLIP.stop), fades, strict=True):
            rows[i] = {i: fade.decay}
        travel = model.travel_speed(*self.smooth)
        kept = exponential(-lane.constant("slope_forgetting") * travel * dt)
        for i, row in model.gravity_rows(now.twist[2] * dt, tilt, kept, dt).items():
            rows[i] = {k: by for k, by in row.items() if k in lane.P.states}
        return rows

    def _with_rows(self, now: model.TracedTwist, climb: model.Climb | None) -> list[Vector]:
        """Products of the covariance with the derivatives of the twist, and of the climb."""
        P = self.lane.P
        with_rows = [
            P.times({i: value for i, value in row.items() if i not in part}, (1.0, part))
            for row, part in zip(now.rows, self.regressors, strict=True)
        ]
        if climb is not None:
            by_gravity = {i: {j: P.entry(i, j) for j in P.states} for i in GRAVITY}
            with_rows.append(climb.times(with_rows, by_gravity))
        return with_rows

    def _propagated(self, motion: Motion, with_rows: Sequence[Vector]) -> Covariance:
        """Propagate the covariance: F P F' + Q.

        Rows of F are e_i + yaws[i] e_yaw + M_dt[i] J for pose and height, with J the derivatives of the
        twist, and `faded` for all other states; with_rows = P J'.
        """
        P, states = self.lane.P, self.lane.shape.states
        rows, M_dt, yaws, faded, noise, own = motion
        moving = range(len(rows))  # pose and height

        def times_F(i: int, vector: Any, J_vector: Sequence[Real]) -> Real:
            """Product of row i of F, for pose or height, with a vector v, given J v."""
            by_twist = sum((M_dt[i][k] * J_vector[k] for k in moving), start=0.0)
            return vector[i] + yaws[i] * vector[s.YAW] + by_twist

        twist_covariance = np.empty((len(rows), len(rows)), dtype=object)  # J P J'
        for k in moving:
            for m in moving[k:]:
                twist_covariance[k, m] = twist_covariance[m, k] = dot(with_rows[k], rows[m])
        carried: dict[tuple[int, int], Real] = {}  # F P, in the rows of pose and height
        for j in P.states:
            column, J_column = [P.entry(i, j) for i in moving], [row[j] for row in with_rows]
            carried |= {(i, j): times_F(i, column, J_column) for i in moving}
        after: dict[tuple[int, int], Real] = {}
        for i in moving:
            carried_row = [carried[i, j] for j in moving]
            J_row = [times_F(i, with_rows[m], twist_covariance[m]) for m in moving]
            for k in moving[i:]:
                after[i, k] = times_F(k, carried_row, J_row) + noise[i, k]
            for j in states:
                if j >= s.MOVED.stop:
                    moved = sum((by * carried[i, b] for b, by in faded[j].items()), start=0.0)
                    after[i, j] = moved + noise.get((i, j), 0.0)
        for n, i in enumerate(states):
            for j in states[n:]:
                if i >= s.MOVED.stop:
                    after[i, j] = P.between(faded[i], faded[j])
            after[i, i] = after[i, i] + own[i]
        if self.kind.fast_slip:
            for j in FAST:
                for i in P.states:
                    if i < s.MOVED.stop:
                        after[i, j] = carried[i, j]
                    elif i <= j:
                        after[i, j] = P.between(faded[i], {j: 1.0})
                    elif i >= s.SIZE:
                        after[j, i] = P.between(faded[i], {j: 1.0})
        return Covariance(after)

    def _report_motion(
        self,
        motion: Motion,
        with_rows: Sequence[Vector],
        fades: Sequence[GaussMarkov],
        step: Sequence[Real],
    ) -> None:
        """Report a propagation, see `Moved`."""
        lane, states = self.lane, self.lane.P.states
        rows, M_dt, yaws, faded, pose_noise, own = motion

        def times_M(vectors: Sequence[Vector]) -> list[list[Real]]:
            """Product of M dt with the rows `vectors`, by pose or height and by state."""
            moved = [combined({}, *zip(factors, vectors, strict=True)) for factors in M_dt]
            return [[row.get(j, 0.0) for j in states] for row in moved]

        moved = range(len(rows))
        noise = [[pose_noise.get((min(i, j), max(i, j)), 0.0) for j in states] for i in moved]
        own_noise = [own[i] for i in states]
        gravity = [[faded[k].get(i, 0.0) for i in states] for k in GRAVITY]
        values = moved_values(
            lane.x[s.YAW],
            step,
            yaws[:2],
            [fade.decay for fade in fades],
            [*times_M(rows), *times_M(with_rows), *noise, own_noise, *gravity],
        )
        lane.report("moved", values, states)

    def _walks(self, tilt: model.Tilting) -> Vector:
        """Squared random-walk densities of the states that have one."""
        turning, travel = model.share_of_walk(*self.smooth), model.travel_speed(*self.smooth)
        lane, by_gyros = self.lane, tilt.down * tilt.down * self.lane.input("tilt_density")
        walks: Vector = {}
        for i in lane.shape.states:
            if i in WALKING:
                rate = lane.constant(f"walk{i}")
                if i in lane.layout.parameters:
                    rate = rate * turning
                walks[i] = rate * rate
                if i in GRAVITY:
                    walks[i] = walks[i] * travel + by_gyros
        return walks


def _noise_of_pose(
    rows: Sequence[Vector],
    M: Any,
    by_slip: Any,
    walk: Vector,
    sigma: Any,
    fades: Sequence[GaussMarkov],
    dt: Real,
) -> dict[tuple[int, int], Real]:
    """Covariances of pose and height that random walks and slip add over a step.

    The slip of w within the step is part of the fast slip.
    """
    half, third = 0.5 * dt * dt, dt * dt * dt * (1.0 / 3.0)
    noise: dict[tuple[int, int], Real] = {}
    count = len(rows)
    by_state = [
        {j: sum((M[i][k] * rows[k].get(j, 0.0) for k in range(count)), start=0.0) for j in walk}
        for i in range(count)
    ]
    squares = [part * part for part in sigma]
    integrals = [square * fade.integral for square, fade in zip(squares, fades, strict=True)]
    for i in range(count):
        for j in walk:
            noise[i, j] = by_state[i][j] * walk[j] * half
        for axis in range(2):
            slipped = by_slip[i][axis] * squares[axis] * fades[axis].cross
            noise[i, s.SLIP.start + axis] = slipped
        for k in range(i, count):
            walked = sum((by_state[i][j] * by_state[k][j] * walk[j] for j in walk), start=0.0)
            slips = [by_slip[i][a] * by_slip[k][a] * integrals[a] for a in range(2)]
            noise[i, k] = walked * third + sum(slips, start=0.0)
    return noise


def _product(a: Any, b: Any) -> list[list[Real]]:
    """Product of two matrices (3, 3)."""
    return [[sum(row[k] * b[k][j] for k in range(3)) for j in range(3)] for row in a]
