"""Extended Kalman filter: propagation of the state, and scalar updates.

    pose' = pose (+) Exp(twist dt)        twist = kinematics(track speeds, parameters) + slip + fast slip
    slip' = slip exp(-dt / tau) + noise   a Gauss-Markov process for each component
    gravity' = R(w dt)' gravity + noise   its part along the ground, fixed in odom, slowly forgotten

Parameters, biases and scales are constants or random walks. The fast slip is white from one step to the
next, and contains the error of the track speeds. It is part of the state because one error both moves the
pose and shows in the gyro's innovation. It also keeps fast motion from moving the parameters. With slow
slip alone, quick changes would count for too much, and noisy track speeds are bad regressors for them
(errors in variables). For the same reason the derivatives by the parameters are smoothed in time: their
noise is that of the track speeds, which is in the innovation, too.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.clones import Clones
from icreckon.estimator.motion.bounds import BOUND_ROUNDS, ROUNDING
from icreckon.estimator.motion.motion_model import (
    MotionModel,
    TwistModel,
    Unremembering,
    gravity_in,
    track_factors,
)
from icreckon.estimator.motion.propagation import (
    Triple,
    gauss_markov,
    step_on_se2,
    turn,
)
from icreckon.estimator.sensors.held_tracks import smoothing_share
from icreckon.estimator.sensors.measurement_models import POSE_FIXED, gyro_fixed, imu_fixed

# Time constant of the derivatives by the parameters [s]. A longer one leaves less noise, but delays them
# so much that they are those of another motion.
REGRESSOR_SMOOTHING = 0.05
IDENTITY = np.eye(s.WANDER.stop)
# A measurement whose variance is below this share of its innovation's is sharp. Such an update may leave
# less of the variances than rounding does: each is inflated by a share of what it was before.
SHARP, ROUNDING_SHARE = 1e-7, 2.0**-46
# Factors on the slip for its present value.
WHOLE = (1.0, 1.0, 1.0)
# Ends of the derivatives by slip, parameters and track speeds among those of a twist.
PARTS = (3, 3 + s.PARAMETER_COUNT, 5 + s.PARAMETER_COUNT)
# Paper's axes to REP-103: forward is the paper's second, left is minus its first.
TO_REP103 = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


class ProcessNoise(NamedTuple):
    """Noise of one prediction step.

    Attributes:
        slip_sigma: (3,) stationary standard deviation of the slip [m/s, m/s, rad/s].
        time_constants: (3,) correlation times of the slip [s].
        walk: (SIZE,) random-walk densities of the states, per √s.
        forgetting: rate at which gravity along the ground returns to zero [1/s].
    """

    slip_sigma: Floats
    time_constants: Triple
    walk: Floats
    forgetting: float = 0.0


class SlipFading(NamedTuple):
    """Transition of the slip: (3,) each, see `motion.propagation.GaussMarkov`."""

    decay: Floats
    mean: Triple
    integral: Floats
    cross: Floats
    final: Floats


def slip_fading(dt: float, noise: ProcessNoise) -> SlipFading:
    """Transition of the slip over `dt` seconds."""
    axes = [gauss_markov(dt, tau) for tau in noise.time_constants]
    decay, mean, integral, cross, final = zip(*axes, strict=True)
    return SlipFading(np.array(decay), mean, *map(np.array, (integral, cross, final)))


class Observer(Protocol):
    """Observer that is notified of every change to the filter."""

    def moved(self, F: Floats, Q: Floats) -> None:
        """Step of transition F and process noise Q (SIZE, SIZE)."""

    def renewed(self, covariance: Floats) -> None:
        """New fast slip of this covariance (3, 3), independent of the one before."""

    def replaced(self, covariance: Floats) -> None:
        """New pose, and wander if there is one, see `IcrEkf.replace_pose`."""

    def wandered(self, decay: float, variance: float) -> None:
        """Wander of the fixes over some time, see `IcrEkf.let_wander`."""

    def inflated(self, states: tuple[int, ...], covariance: Floats) -> None:
        """Inflation of these n states by this covariance (n, n)."""

    def updated(
        self, z: float, h: Floats, r: float, change: Floats, fixed: tuple[int, ...]
    ) -> None:
        """Scalar update: innovation, Jacobian, noise variance, change and fixed states."""

    def projected(self, change: Floats) -> None:
        """Projection of the state to its bounds by this change (SIZE,)."""


class IcrEkf:
    """EKF with the kinematics of ICRs as its motion model.

    `x` is (SIZE,), `P` (SIZE, SIZE); `icreckon.estimator.base.state` has their layout. If fixes wander
    there are two states more behind these (`add_wander`). `F` and `Q` are those of the newest prediction.
    Updates are scalar (`update_scalar`).

    Args:
        model: the motion model.

    Attributes:
        regressors: (3, 9) smoothed derivatives of the twist by the parameters; None before the first
            step.
        clones: stochastic clones, None if there are none; they change nothing else.
        observer: observer of all changes, or None.
        considered: consider states: updates do not move them, but their covariance counts
            (Schmidt-Kalman).
    """

    def __init__(self, model: MotionModel) -> None:
        self.regressors: Floats | None = None
        self.clones: Clones | None = None
        self.observer: Observer | None = None
        self.considered: tuple[int, ...] = ()
        self.fixed_for_imu = imu_fixed(model.taught_by_imu)
        self.fixed_for_gyro = gyro_fixed(model.taught_by_imu)
        self.x: Floats = np.zeros(s.SIZE)
        self.P: Floats = np.zeros((s.SIZE, s.SIZE))
        self.F: Floats = np.eye(s.SIZE)
        self.Q: Floats = np.zeros((s.SIZE, s.SIZE))
        self.model = model
        self._bounds = model.bounds
        self._next_x: Floats = self.x
        # Cache of the newest evaluation of the twist model.
        self._evaluated_at: tuple[float | bytes, ...] | None = None
        self._evaluated: TwistModel

    @property
    def wanders(self) -> bool:
        """True if the wander of position fixes is part of the state."""
        return len(self.x) > s.SIZE

    def add_wander(self, sigma: float) -> None:
        """Add the wander of position fixes to the state, of this standard deviation [m]."""
        x, P = np.zeros(s.WANDER.stop), np.diag([0.0] * s.SIZE + [sigma * sigma] * 2)
        x[: s.SIZE], P[: s.SIZE, : s.SIZE] = self.x, self.P
        self.x, self.P = x, P

    def let_wander(self, decay: float, variance: float) -> None:
        """Propagate the wander of position fixes over some time.

        Its transition is a number, which commutes with everything else that happens in that time. So this
        is exact once before each fix, and not only in each step.

        Args:
            decay: factor on the wander.
            variance: variance that it gains along each axis [m²].
        """
        self.x[s.WANDER] *= decay
        fade_wander(self.P, decay)
        self.P[[s.WANDER_X, s.WANDER_Y], [s.WANDER_X, s.WANDER_Y]] += variance
        if self.clones is not None:
            self.clones = self.clones.faded(s.WANDER, decay)
        if self.observer is not None:
            self.observer.wandered(decay, variance)

    def twist_model(self, left: float, right: float, slip_shares: Triple = WHOLE) -> TwistModel:
        """Body velocity and its Jacobian at the present state; do not change them.

        Args:
            left: measured speed of the left track [m/s].
            right: measured speed of the right track [m/s].
            slip_shares: factors on the slip, for its mean over a step.
        """
        at = self._inputs(left, right, slip_shares)
        if at != self._evaluated_at:
            model = self._evaluate(left, right, slip_shares)
            if self.regressors is not None:
                model.jacobian[:, s.PARAMETERS] = self.regressors
            self._evaluated, self._evaluated_at = model, at
        return self._evaluated

    def _inputs(self, left: float, right: float, slip_shares: Triple) -> tuple[float | bytes, ...]:
        """Inputs of an evaluation of the twist model."""
        smoothed = b"" if self.regressors is None else self.regressors.tobytes()
        return (left, right, *slip_shares, self.x.tobytes(), self.model.memory.tobytes(), smoothed)

    def _evaluate(self, left: float, right: float, slip_shares: Triple) -> TwistModel:
        x = self.x.tolist()
        of_left, of_right = track_factors(x)
        forward, sideways, turning = (
            share * slow + fast
            for share, slow, fast in zip(slip_shares, x[s.SLIP], x[s.FAST_SLIP], strict=True)
        )
        # REP-103 slip in the paper's axes: right is minus left.
        slip = (-sideways, forward, turning)
        motion, by = self.model.linearise(
            left * of_left, right * of_right, x[s.PARAMETERS], slip, gravity_in(x)
        )
        parts = zip(by.by_slip, by.by_parameters, by.by_speeds, by.by_gravity, strict=True)
        by_all = TO_REP103.dot(
            np.array([[value for part in row for value in part] for row in parts])
        )
        by_slip, by_parameters, by_speeds, by_gravity = np.split(by_all, PARTS, axis=1)
        by_slip = by_slip.dot(TO_REP103.T)
        jacobian = np.zeros((3, len(x)))
        jacobian[:, s.SLIP] = by_slip * slip_shares
        jacobian[:, s.FAST_SLIP] = by_slip
        jacobian[:, s.PARAMETERS] = by_parameters
        jacobian[:, s.TRACK_SCALE] = by_speeds.dot((left, right))
        jacobian[:, s.TRACK_DIFFERENCE] = by_speeds.dot((-0.5 * left, 0.5 * right))
        jacobian[:, s.GRAVITY_X], jacobian[:, s.GRAVITY_Y] = by_gravity[:, 1], -by_gravity[:, 0]
        v_x, v_y, w = motion.twist
        by_speeds = by_speeds * (of_left, of_right)
        return TwistModel(np.array([v_y, -v_x, w]), jacobian, by_speeds, motion)

    def predict_motion(self, dt: float, left: float, right: float, noise: ProcessNoise) -> None:
        """Propagate over `dt` seconds with constant track speeds [m/s]."""
        fades = slip_fading(dt, noise)
        model = self.twist_model(left, right, fades.mean)
        clones = self.clones
        if clones is None:
            self._move(dt, model, noise, fades)
        else:
            yaw, P = self.x.item(s.YAW), self.P.copy()
            step = self._move(dt, model, noise, fades)
            by_state = self.F[s.POSE].copy()
            by_state[:, s.POSE] = 0.0
            self.clones = clones.moved(yaw, np.array(step), by_state, P, self.F, self.Q)
        if self.observer is not None:
            self.observer.moved(self.F, self.Q)

    def begin_step(self, dt: float, left: float, right: float) -> None:
        """Begin a step of `dt` seconds at mean track speeds [m/s] in the motion model."""
        if not isinstance(self.model, Unremembering):
            x = self.x.tolist()
            of_left, of_right = track_factors(x)
            speeds = left * of_left, right * of_right
            self.model.begin_step(dt, *speeds, x[s.PARAMETERS], gravity_in(x))

    def smooth_regressors(self, dt: float, left: float, right: float) -> TwistModel:
        """Smooth the derivatives by the parameters, at the start of a step.

        Args:
            dt: length of the step [s].
            left: measured speed of the left track [m/s].
            right: measured speed of the right track [m/s].

        Returns:
            The twist model with the smoothed derivatives, as `twist_model` returns it.
        """
        model = self._evaluate(left, right, WHOLE)
        now, before = model.jacobian[:, s.PARAMETERS], self.regressors
        if before is not None:
            now -= before
            now *= smoothing_share(dt, REGRESSOR_SMOOTHING)
            now += before
        self.regressors = now.copy()
        self._evaluated, self._evaluated_at = model, self._inputs(left, right, WHOLE)
        return model

    def _move(self, dt: float, model: TwistModel, noise: ProcessNoise, fades: SlipFading) -> Triple:
        """Propagate at the mean twist of a step; return the increment of the pose."""
        step, by_yaw, rows = step_on_se2(self.x.item(s.YAW), (model.twist * dt).tolist())
        by_motion = np.array(rows)

        by_state = by_motion.dot(model.jacobian)
        size = len(self.x)
        diagonal, of_slip = slice(None, None, size + 1), slip_diagonal(size)
        self.F = F = IDENTITY[:size, :size].copy()
        F[s.POSE] += by_state * dt
        F[s.POSITION, s.YAW] += by_yaw
        F.ravel()[of_slip] = fades.decay
        cos, sin = turn(step[2])
        back = math.exp(-noise.forgetting * dt) * np.array([[cos, sin], [-sin, cos]])
        F[s.GRAVITY, s.GRAVITY] = back

        # Random walks and slip, and their effect on the pose within the step.
        walk, slip = noise.walk**2, noise.slip_sigma**2
        if self.wanders:
            walk = np.append(walk, (0.0, 0.0))
        walked, slipped = by_state * walk, by_motion * slip
        with_pose = walked * (dt**2 / 2.0)
        with_pose[:, s.SLIP] += slipped * fades.cross
        self.Q = Q = np.zeros((size, size))
        Q[s.POSE] = with_pose
        Q[:, s.POSE] = with_pose.T
        Q[s.POSE, s.POSE] = walked.dot(by_state.T) * (dt**3 / 3.0)
        Q[s.POSE, s.POSE] += (slipped * fades.integral).dot(by_motion.T)
        Q.ravel()[diagonal] += walk * dt
        Q.ravel()[of_slip] += slip * fades.final

        self._next_x = self.x.copy()
        self._next_x[s.POSE] += step
        self._next_x[s.SLIP] *= fades.decay
        self._next_x[s.GRAVITY] = back.dot(self.x[s.GRAVITY])
        self._predict()
        self.P = 0.5 * (self.P + self.P.T)
        return step

    def _predict(self) -> None:
        """Take the state that `_move` computed, and propagate the covariance by F and Q."""
        self.x = self._next_x
        self.P = self.F.dot(self.P).dot(self.F.T) + self.Q

    def renew_fast_slip(self, covariance: Floats) -> None:
        """Begin a step with a new fast slip, independent of all other states.

        Args:
            covariance: (3, 3) covariance of the new fast slip.
        """
        self._draw(covariance)
        if self.clones is not None:
            self.clones = self.clones.renewed()
        if self.observer is not None:
            self.observer.renewed(covariance)

    def _draw(self, covariance: Floats) -> None:
        self.x[s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, :] = 0.0
        self.P[:, s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, s.FAST_SLIP] = covariance

    def replace_pose(self, pose: Floats, covariance: Floats) -> None:
        """Replace the pose by another, independent of all other states.

        Args:
            pose: (3,) x, y [m], yaw [rad].
            covariance: (3, 3) covariance of the pose; if fixes wander, (5, 5) of the pose and of a new
                wander of zero.
        """
        states = replaced_states(covariance)
        self.x[states] = 0.0
        self.x[s.POSE] = pose
        self.P[states, :] = 0.0
        self.P[:, states] = 0.0
        self.P[np.ix_(states, states)] = covariance
        if self.clones is not None:
            self.clones = self.clones.renewed(states)
        if self.observer is not None:
            self.observer.replaced(covariance)

    def inflate(self, *states: int, variance: float) -> None:
        """Inflate states, each by a variance and independently of all other states."""
        self.inflate_jointly(states, variance * np.eye(len(states)))

    def inflate_jointly(self, states: tuple[int, ...], covariance: Floats) -> None:
        """Inflate n states by a covariance (n, n)."""
        self.P[np.ix_(states, states)] += covariance
        if self.observer is not None:
            self.observer.inflated(states, covariance)

    def inflate_motion(self, states: tuple[int, ...], covariance: Floats) -> None:
        """Inflate n states by the covariance (n, n) of an error of the motion."""
        self.inflate_jointly(states, covariance)
        if self.clones is not None:
            self.clones = self.clones.inflated(self.x.item(s.YAW), states, covariance)

    def innovation_covariance(self, H: Floats, R: Floats) -> Floats:
        """S (n, n) of a measurement with Jacobian H (n, SIZE) and noise R (n, n)."""
        return np.asarray(H.dot(self.P).dot(H.T) + R)

    def update_scalar(
        self,
        z: float,
        h: Floats,
        r: float,
        *,
        fixed: tuple[int, ...] = (),
        stand_in: int | None = None,
    ) -> None:
        """Update with one scalar measurement, in Joseph form.

        With c = P h, S = h'c + r and any gain K, the covariance is P - K c' - c K' + S K K' (Simon,
        Optimal State Estimation, eq. 5.19). So fixed states simply have no gain (Schmidt-Kalman).

        Args:
            z: innovation, measured less predicted.
            h: (SIZE,) Jacobian of the predicted measurement.
            r: variance of the measurement noise.
            fixed: states that are not to be moved, besides those considered.
            stand_in: state that is moved in their place, so that the predicted measurement moves as far
                as if none were fixed; none of them.
        """
        if self.considered:
            fixed = tuple(sorted({*fixed, *self.considered}))
        if self.wanders and s.X in fixed:
            # A fix shows the sum of position and wander: one is not to move without the other.
            fixed = (*fixed, s.WANDER_X, s.WANDER_Y)
        observer = self.observer
        before = self.x if observer is None else self.x.copy()
        variances = self.P.diagonal()
        c, K, S = self._correct(z, h, r, fixed, stand_in)
        is_sharp = r < SHARP * S
        if self.clones is not None:
            more = ROUNDING_SHARE if is_sharp else 0.0
            self.clones = self.clones.updated(z, h, c, K, S, fixed=s.X in fixed, more=more)
        if observer is not None:
            observer.updated(z, h, r, self.x - before, fixed)
        if is_sharp:
            for index, variance in enumerate((ROUNDING_SHARE * variances).tolist()):
                self.inflate(index, variance=variance)

    def _correct(
        self, z: float, h: Floats, r: float, fixed: tuple[int, ...], stand_in: int | None
    ) -> tuple[Floats, Floats, float]:
        """Update state and covariance; return c, K and S."""
        c = self.P.dot(h)
        S = float(h.dot(c)) + r
        K = c / S
        missing = 0.0
        for index in fixed:
            missing += h[index] * K[index]
            K[index] = 0.0
        if stand_in is not None:
            K[stand_in] += missing / h[stand_in]
        self.x = self.x + K * z
        half = K[:, None] * (c - (0.5 * S) * K)
        self.P = self.P - (half + half.T)
        return c, K, S

    def keep_inside_bounds(self, *, by_imu: bool = False) -> None:
        """Project the parameters to the bounds of the motion model.

        The state moves along the covariance to the nearest point of the violated bound. The pose stays,
        and so do the states that the last measurement does not move, after the IMU those that the gyro
        does not move. The covariance stays, which is
        conservative (Simon, Optimal State Estimation, section 7.5).

        Args:
            by_imu: the last measurement is the IMU's.
        """
        before, P = self.x, self.P
        fixed = [*(self.fixed_for_gyro if by_imu else POSE_FIXED), *self.considered]
        fixed += range(s.SIZE, len(before))
        for _ in range(BOUND_ROUNDS):
            moved = False
            for bound in range(len(self._bounds)):
                direction, least = self._bounds[bound, :-1], self._bounds[bound, -1]
                short = float(least - direction.dot(self.x[s.PARAMETERS]))
                if short <= ROUNDING:
                    continue
                of_state = np.zeros(len(before))
                of_state[s.PARAMETERS] = direction
                of_state[fixed] = 0.0
                cross = of_state[s.PARAMETERS].dot(P[s.PARAMETERS])
                cross[fixed] = 0.0
                variance = float(of_state[s.PARAMETERS].dot(cross[s.PARAMETERS]))
                if variance <= 0.0:
                    continue
                self.x = self.x + cross * (short / variance)
                moved = True
            if not moved:
                break
        if self.observer is not None and self.x is not before:
            self.observer.projected(self.x - before)


def fade_wander(P: Floats, decay: float) -> None:
    """Multiply the wander of position fixes in a matrix, in place.

    Args:
        P: (n, n) covariance or information matrix with the states of the wander.
        decay: factor on the wander.
    """
    P[s.WANDER] *= decay
    P[:, s.WANDER] *= decay


def slip_diagonal(size: int) -> slice:
    """Places of the slip on the diagonal of a flattened (size, size) matrix."""
    return slice(s.SLIP_X * (size + 1), s.SLIP_W * (size + 1) + 1, size + 1)


def replaced_states(covariance: Floats) -> list[int]:
    """States that `IcrEkf.replace_pose` replaces, by the size of its covariance."""
    return [s.X, s.Y, s.YAW, s.WANDER_X, s.WANDER_Y][: len(covariance)]
