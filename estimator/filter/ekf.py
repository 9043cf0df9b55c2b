"""The extended Kalman filter: state propagation and measurement updates, nothing about streams.

    pose' = pose (+) Exp(twist dt)        twist = kinematics(track speeds, parameters) + slip + fast slip
    slip' = slip exp(-dt / tau) + noise   a Gauss-Markov process for each component

Parameters, biases and scales are constants or random walks. The fast slip is white from one step to the
next, the error of the track speeds included; it is part of the state because the same error moves the
pose and shows in the gyro's innovation. It also keeps the parameters from being learnt from what is
fast: the slip alone would call slow agreement cheap and make much of the noise in quick changes, and
noisy track speeds are no good regressors for those (errors in variables). For the same reason the
derivatives by the parameters are smoothed in time: noise in them is that of the track speeds, which is in
the innovation, too.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.clones import Marks
from icreckon.estimator.motion.bounds import BOUND_ROUNDS, ROUNDING
from icreckon.estimator.motion.motion_model import MotionModel, TwistModel, Unremembering
from icreckon.estimator.motion.propagation import Triple, fading, gauss_markov_noise, step_on_se2
from icreckon.estimator.sensors.held_tracks import smoothing_share

# What a twist measurement does not move: the pose, which is to be continuous.
POSE_KEPT = (s.X, s.Y, s.YAW)
# What the IMU does not move either: it sees the track scale only through what else is wrong with the
# yaw rate, and would call it all scale. Fixes and body velocities show it for what it is.
IMU_KEPT = (*POSE_KEPT, s.TRACK_SCALE)
# What being told that the robot stands does not move: nothing but the slip, which was another until it
# stopped, and would have biases and parameters take the blame for that.
STANDING_KEPT = (*POSE_KEPT, *range(s.LEARNT.start, s.LEARNT.stop))
# Time constant of the derivatives by the parameters [s]: a longer one leaves less of the noise, and comes
# so late that parameters are learnt from what the robot does no longer.
REGRESSOR_SMOOTHING = 0.05
IDENTITY = np.eye(s.SIZE)
# Where the diagonal, and the slip's part of it, stand in a covariance that is laid out flat.
DIAGONAL = slice(None, None, s.SIZE + 1)
SLIP_DIAGONAL = slice(s.SLIP_X * (s.SIZE + 1), s.SLIP_W * (s.SIZE + 1) + 1, s.SIZE + 1)
# From the paper's axes: forward is its second, left minus its first.
TO_REP103 = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


class ProcessNoise(NamedTuple):
    """Noise of one prediction step.

    Attributes:
        slip_sigma: (3,) stationary standard deviation of the slip [m/s, m/s, rad/s].
        time_constant: correlation time of the slip [s].
        walk: (SIZE,) random-walk densities of the states, per √s.
    """

    slip_sigma: Floats
    time_constant: float
    walk: Floats


class Witness(Protocol):
    """What is told of all that changes the filter."""

    def moved(self, F: Floats, Q: Floats) -> None:
        """A step, by its transition and its noise (SIZE, SIZE)."""

    def renewed(self, covariance: Floats) -> None:
        """The fast slip was drawn anew, with this covariance (3, 3)."""

    def replaced(self, covariance: Floats) -> None:
        """The pose was replaced by another, independent of all else, with this covariance (3, 3)."""

    def reopened(self, states: tuple[int, ...], variance: float) -> None:
        """These states were made more uncertain, each by this variance."""

    def updated(self, residual: float, row: Floats, variance: float, change: Floats) -> None:
        """An update, by its measurement, and the change (SIZE,) of the state that the filter made."""

    def projected(self, change: Floats) -> None:
        """The state was brought inside its bounds by this change (SIZE,)."""


class Innovation(NamedTuple):
    """A scalar measurement against its prediction: the residual, and the variance it should have."""

    residual: float
    variance: float

    @property
    def nis(self) -> float:
        """Normalised innovation squared, chi-square with one degree of freedom."""
        return self.residual * self.residual / self.variance


class IcrEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's EKF with the kinematics of ICRs as its motion model.

    `x` is (SIZE,), `P` (SIZE, SIZE); see `estimator.base.state` for what stands where. `F` and `Q` are
    those of the newest prediction.

    Args:
        model: the index model in these kinematics.

    Attributes:
        regressors: (3, 8) derivatives of the twist by the parameters, smoothed; None before the first
            step, when they are those of the moment.
        marks: the motion since each mark, None where there is none; it changes nothing else.
        witness: is told of all that is done; None where nobody is to be told.
        considered: states that nothing moves and no measurement makes more certain; what is not known of
            them counts in all else (Schmidt-Kalman).
    """

    def __init__(self, model: MotionModel) -> None:
        super().__init__(dim_x=s.SIZE, dim_z=1)
        self.regressors: Floats | None = None
        self.marks: Marks | None = None
        self.witness: Witness | None = None
        self.considered: tuple[int, ...] = ()
        self.x: Floats = np.zeros(s.SIZE)
        self.P: Floats = np.zeros((s.SIZE, s.SIZE))
        self.model = model
        self._bounds = model.bounds
        self._next_x: Floats = self.x
        # The newest evaluation of the twist model, which is often asked for again.
        self._evaluated_at: tuple[float | bytes, ...] | None = None
        self._evaluated: TwistModel

    def twist_model(self, left: float, right: float, slip_share: float = 1.0) -> TwistModel:
        """Body velocity and its Jacobian at the present state; not to be written to.

        Args:
            left: measured speed of the left track [m/s].
            right: measured speed of the right track [m/s].
            slip_share: factor on the slip, for its mean over a step.
        """
        at = self._all_of(left, right, slip_share)
        if at != self._evaluated_at:
            model = self._evaluate(left, right, slip_share)
            if self.regressors is not None:
                model.jacobian[:, s.PARAMETERS] = self.regressors
            self._evaluated, self._evaluated_at = model, at
        return self._evaluated

    def _all_of(self, left: float, right: float, slip_share: float) -> tuple[float | bytes, ...]:
        """All that an evaluation of the twist model depends on."""
        smoothed = b"" if self.regressors is None else self.regressors.tobytes()
        return (left, right, slip_share, self.x.tobytes(), self.model.memory.tobytes(), smoothed)

    def _evaluate(self, left: float, right: float, slip_share: float) -> TwistModel:
        x = self.x.tolist()
        scale = 1.0 + x[s.TRACK_SCALE]
        forward, sideways, turning = (
            slip_share * slow + fast for slow, fast in zip(x[s.SLIP], x[s.FAST_SLIP], strict=True)
        )
        # REP-103 slip in the paper's axes: right is minus left.
        slip = (-sideways, forward, turning)
        motion, by = self.model.linearise(left * scale, right * scale, x[s.PARAMETERS], slip)
        rows = zip(by.by_slip, by.by_parameters, by.by_speeds, strict=True)
        by_all = TO_REP103.dot(np.array([[*one, *two, *three] for one, two, three in rows]))
        by_slip, by_speeds = by_all[:, :3].dot(TO_REP103.T), by_all[:, 11:]
        jacobian = np.zeros((3, s.SIZE))
        jacobian[:, s.SLIP] = slip_share * by_slip
        jacobian[:, s.FAST_SLIP] = by_slip
        jacobian[:, s.PARAMETERS] = by_all[:, 3:11]
        jacobian[:, s.TRACK_SCALE] = by_speeds.dot((left, right))
        v_x, v_y, w = motion.twist
        return TwistModel(np.array([v_y, -v_x, w]), jacobian, scale * by_speeds, motion)

    def predict_motion(self, dt: float, left: float, right: float, noise: ProcessNoise) -> None:
        """Propagate over `dt` seconds with constant track speeds [m/s]."""
        model = self.twist_model(left, right, fading(dt, noise.time_constant).mean)
        marks = self.marks
        if marks is None:
            self._move(dt, model, noise)
        else:
            yaw, P = self.x.item(s.YAW), self.P.copy()
            step = self._move(dt, model, noise)
            by_state = self.F[s.POSE].copy()
            by_state[:, s.POSE] = 0.0
            self.marks = marks.moved(yaw, np.array(step), by_state, P, self.F, self.Q)
        if self.witness is not None:
            self.witness.moved(self.F, self.Q)

    def begin_step(self, dt: float, left: float, right: float) -> None:
        """Tell a model that remembers of a step of `dt` seconds at these mean track speeds [m/s]."""
        if not isinstance(self.model, Unremembering):
            x = self.x.tolist()
            scale = 1.0 + x[s.TRACK_SCALE]
            self.model.begin_step(dt, left * scale, right * scale, x[s.PARAMETERS])

    def smooth_regressors(self, dt: float, left: float, right: float) -> TwistModel:
        """Let the derivatives by the parameters follow those of the moment, at the start of a step.

        Args:
            dt: of the step [s].
            left: measured speed of the left track [m/s].
            right: of the right track [m/s].

        Returns:
            What `twist_model` has to say then.
        """
        model = self._evaluate(left, right, 1.0)
        now, before = model.jacobian[:, s.PARAMETERS], self.regressors
        if before is not None:
            now -= before
            now *= smoothing_share(dt, REGRESSOR_SMOOTHING)
            now += before
        self.regressors = now.copy()
        self._evaluated, self._evaluated_at = model, self._all_of(left, right, 1.0)
        return model

    def _move(self, dt: float, model: TwistModel, noise: ProcessNoise) -> Triple:
        """Propagate at the mean twist of a step; what that adds to the pose."""
        decay = fading(dt, noise.time_constant).decay
        step, by_yaw, rows = step_on_se2(self.x.item(s.YAW), (model.twist * dt).tolist())
        by_motion = np.array(rows)

        by_state = by_motion.dot(model.jacobian)
        self.F = F = IDENTITY.copy()
        F[s.POSE] += by_state * dt
        F[s.POSITION, s.YAW] += by_yaw
        F.ravel()[SLIP_DIAGONAL] = decay

        # Random walks, the slip, and what they do to the pose on the way.
        walk, slip = noise.walk**2, noise.slip_sigma**2
        integral, cross, final = gauss_markov_noise(dt, noise.time_constant)
        walked, slipped = by_state * walk, by_motion * slip
        with_pose = walked * (dt**2 / 2.0)
        with_pose[:, s.SLIP] += slipped * cross
        self.Q = Q = np.zeros((s.SIZE, s.SIZE))
        Q[s.POSE] = with_pose
        Q[:, s.POSE] = with_pose.T
        Q[s.POSE, s.POSE] = walked.dot(by_state.T) * (dt**3 / 3.0)
        Q[s.POSE, s.POSE] += (slipped * integral).dot(by_motion.T)
        Q.ravel()[DIAGONAL] += walk * dt
        Q.ravel()[SLIP_DIAGONAL] += slip * final

        self._next_x = self.x.copy()
        self._next_x[s.POSE] += step
        self._next_x[s.SLIP] *= decay
        self.predict()
        self.P = 0.5 * (self.P + self.P.T)
        return step

    def predict_x(self, u: float = 0) -> None:  # noqa: ARG002 - the signature is filterpy's
        """Hand filterpy's `predict` the state that `predict_motion` has worked out."""
        self.x = self._next_x

    def renew_fast_slip(self, covariance: Floats) -> None:
        """A new step begins, with a fast slip that is independent of all that was known.

        Args:
            covariance: (3, 3) of the new fast slip.
        """
        self._draw(covariance)
        if self.marks is not None:
            self.marks = self.marks.renewed()
        if self.witness is not None:
            self.witness.renewed(covariance)

    def _draw(self, covariance: Floats) -> None:
        self.x[s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, :] = 0.0
        self.P[:, s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, s.FAST_SLIP] = covariance

    def replace_pose(self, pose: Floats, covariance: Floats) -> None:
        """Believe another pose, independent of all that was known.

        Args:
            pose: (3,) x, y [m], yaw [rad].
            covariance: (3, 3) of it.
        """
        self.x[s.POSE] = pose
        self.P[s.POSE, :] = 0.0
        self.P[:, s.POSE] = 0.0
        self.P[s.POSE, s.POSE] = covariance
        if self.marks is not None:
            self.marks = self.marks.renewed(s.POSE)
        if self.witness is not None:
            self.witness.replaced(covariance)

    def reopen(self, *states: int, variance: float) -> None:
        """Make states more uncertain, each by a variance and independently of all else."""
        for index in states:
            self.P[index, index] += variance
        if self.witness is not None:
            self.witness.reopened(states, variance)

    def innovation(self, residual: float, row: Floats, variance: float) -> Innovation:
        """The innovation of a scalar measurement, not yet used.

        Args:
            residual: measured less predicted.
            row: (SIZE,) Jacobian of the prediction.
            variance: of the measurement.
        """
        return Innovation(residual, float(row.dot(self.P.dot(row))) + variance)

    def update_scalar(
        self, residual: float, row: Floats, variance: float, *, kept: tuple[int, ...] = ()
    ) -> None:
        """Joseph update with one scalar measurement (Simon, Optimal State Estimation, eq. 5.19).

        With S the variance of the innovation and c = P row, that is P - k c' - c k' + S k k' for any
        gain k, and here h = c - S k / 2.

        Args:
            residual: measured less predicted.
            row: (SIZE,) Jacobian of the prediction.
            variance: of the measurement.
            kept: states that are not to be moved, besides those considered, whatever their correlations
                say; the covariance takes that into account (Schmidt-Kalman; the Joseph form holds for
                any gain).
        """
        if self.considered:
            kept = tuple(sorted({*kept, *self.considered}))
        witness = self.witness
        before = self.x if witness is None else self.x.copy()
        cross, gain, expected = self._correct(residual, row, variance, kept)
        if self.marks is not None:
            self.marks = self.marks.updated(residual, row, cross, gain, expected, kept=s.X in kept)
        if witness is not None:
            witness.updated(residual, row, variance, self.x - before)

    def _correct(
        self, residual: float, row: Floats, variance: float, kept: tuple[int, ...]
    ) -> tuple[Floats, Floats, float]:
        """The update itself; c, k and S."""
        cross = self.P.dot(row)
        expected = float(row.dot(cross)) + variance
        gain = cross / expected
        for index in kept:
            gain[index] = 0.0
        self.x = self.x + gain * residual
        half = gain[:, None] * (cross - (0.5 * expected) * gain)
        self.P = self.P - (half + half.T)
        return cross, gain, expected

    def keep_inside_bounds(self) -> None:
        """Project the parameters back to where the motion model allows them to be.

        The state moves along the covariance to the nearest point of the violated bound, but for what only
        fixes move; the covariance stays, which is on the safe side (Simon, Optimal State Estimation,
        section 7.5).
        """
        before, P = self.x, self.P
        considered = list(self.considered)
        kept = [*IMU_KEPT, *considered]
        for _ in range(BOUND_ROUNDS):
            moved = False
            for bound in range(len(self._bounds)):
                direction, least = self._bounds[bound, :8], self._bounds[bound, 8]
                short = float(least - direction.dot(self.x[s.PARAMETERS]))
                if short <= ROUNDING:
                    continue
                of_state = np.zeros(s.SIZE)
                of_state[s.PARAMETERS] = direction
                of_state[considered] = 0.0
                cross = of_state[s.PARAMETERS].dot(P[s.PARAMETERS])
                cross[kept] = 0.0
                spread = float(of_state[s.PARAMETERS].dot(cross[s.PARAMETERS]))
                if spread <= 0.0:
                    continue
                self.x = self.x + cross * (short / spread)
                moved = True
            if not moved:
                break
        if self.witness is not None and self.x is not before:
            self.witness.projected(self.x - before)
