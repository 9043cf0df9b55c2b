"""The extended Kalman filter: state propagation and measurement updates, nothing about streams.

    pose' = pose (+) Exp(twist dt)        twist = kinematics(track speeds, parameters) + slip + fast slip
    slip' = slip exp(-dt / tau) + noise   a Gauss-Markov process for each component

Parameters, biases and scales are constants or random walks. The fast slip is white from one step to the
next, the error of the track speeds included; it is part of the state because the same error moves the
pose and shows in the gyro's innovation. It also keeps the parameters from being learnt from what is
fast: the slip alone would call slow agreement cheap and make much of the noise in quick changes, and
noisy track speeds are no good regressors for those (errors in variables).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from estimator import state as s
from estimator.frames import Floats, arc_factors
from estimator.motion import Channels, Motion, MotionModel
from estimator.relative_motion import Marks

# How much of eta0 is kept away from the bounds x_ICRl < 0 < x_ICRr and eta0 >= 1.
BOUND_MARGIN = 1e-3
# Moving to one bound may cross another; a few rounds settle it.
BOUND_ROUNDS = 50
ROUNDING = 1e-12
IDENTITY = np.eye(s.SIZE)
# Where the diagonal, and the slip's part of it, stand in a covariance that is laid out flat.
DIAGONAL = slice(None, None, s.SIZE + 1)
SLIP_DIAGONAL = slice(s.SLIP_X * (s.SIZE + 1), s.SLIP_W * (s.SIZE + 1) + 1, s.SIZE + 1)
# From the paper's axes: forward is its second, left minus its first.
TO_REP103 = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# The channels that the motion model is differentiated by, and what moves them as it stands: REP-103
# slip, offsets, and in the last two columns the track speeds (D = V_r - V_l, V_m is their mean).
D, V_M, ZETA, EPSILON, ETA, R_X, R_Y, R_W = range(len(Channels._fields))
SLIP_CHANNELS = ((R_Y, s.SLIP_X), (R_X, s.SLIP_Y), (R_W, s.SLIP_W))
BASIS = np.zeros((len(Channels._fields), s.SIZE + 2))
BASIS[[R_Y, R_X, R_W], [s.SLIP_X, s.SLIP_Y, s.SLIP_W]] = 1.0, -1.0, 1.0
BASIS[[R_Y, R_X, R_W], s.FAST_SLIP] = np.diag([1.0, -1.0, 1.0])
BASIS[[ZETA, EPSILON, ETA], [s.ZETA0, s.EPSILON0, s.ETA0]] = 1.0
BASIS[[D, V_M], s.SIZE :] = (-1.0, 1.0), (0.5, 0.5)


class TwistModel(NamedTuple):
    """The body velocity at a state.

    Attributes:
        twist: (3,) v_x, v_y [m/s], w [rad/s].
        jacobian: (3, SIZE) its derivative by the state.
        by_speeds: (3, 2) its derivative by the speeds of the left and the right track.
        motion: the solved motion model, in the paper's axes.
    """

    twist: Floats
    jacobian: Floats
    by_speeds: Floats
    motion: Motion


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

    `x` is (SIZE,), `P` (SIZE, SIZE); see `estimator.state` for what stands where.

    Args:
        model: the index model in these kinematics.

    Attributes:
        marks: the motion since each mark, None where there is none; it changes nothing else.
    """

    def __init__(self, model: MotionModel) -> None:
        super().__init__(dim_x=s.SIZE, dim_z=1)
        self.marks: Marks | None = None
        self.x: Floats = np.zeros(s.SIZE)
        self.P: Floats = np.zeros((s.SIZE, s.SIZE))
        self.model = model
        self._next_x: Floats = self.x
        # The newest evaluation of the twist model, which is often asked for again.
        self._evaluated_at: tuple[float, float, float, bytes] | None = None
        self._evaluated: TwistModel

    def twist_model(self, left: float, right: float, slip_share: float = 1.0) -> TwistModel:
        """Body velocity and its Jacobian at the present state; not to be written to.

        Args:
            left: measured speed of the left track [m/s].
            right: measured speed of the right track [m/s].
            slip_share: factor on the slip, for its mean over a step.
        """
        at = (left, right, slip_share, self.x.tobytes())
        if at == self._evaluated_at:
            return self._evaluated
        x = self.x.tolist()
        scale = 1.0 + x[s.TRACK_SCALE]
        V_l, V_r = left * scale, right * scale
        forward, sideways, turning = (
            slip_share * slow + fast for slow, fast in zip(x[s.SLIP], x[s.FAST_SLIP], strict=True)
        )
        # REP-103 slip in the paper's axes: right is minus left.
        slip = (-sideways, forward, turning)
        motion, by = self.model.linearise(V_l, V_r, x[s.PARAMETERS], slip)
        twist = motion.twist
        by_all = TO_REP103.dot(np.array(by).T).dot(_basis(motion, left, right, slip_share))
        self._evaluated_at = at
        self._evaluated = TwistModel(
            np.array([twist.v_y, -twist.v_x, twist.w]),
            by_all[:, : s.SIZE],
            scale * by_all[:, s.SIZE :],
            motion,
        )
        return self._evaluated

    def predict_motion(self, dt: float, left: float, right: float, noise: ProcessNoise) -> None:
        """Propagate over `dt` seconds with constant track speeds [m/s]."""
        ratio = dt / noise.time_constant
        decay = math.exp(-ratio)
        share = -math.expm1(-ratio) / ratio if ratio > 0.0 else 1.0
        model = self.twist_model(left, right, share)
        pose, by_yaw, by_motion = step_on_se2(self.x.item(s.YAW), model.twist * dt)

        by_state = by_motion.dot(model.jacobian)
        self.F = F = IDENTITY.copy()
        F[s.POSE] += by_state * dt
        F[s.POSITION, s.YAW] += by_yaw
        F.ravel()[SLIP_DIAGONAL] = decay

        # Random walks, the slip, and what they do to the pose on the way.
        walk, slip = noise.walk**2, noise.slip_sigma**2
        integral, cross, final = _gauss_markov_noise(dt, noise.time_constant, decay)
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
        self._next_x[s.POSE] += pose
        self._next_x[s.SLIP] *= decay
        if self.marks is not None:
            self.marks = self.marks.moved(self.x.item(s.YAW), pose, by_state * dt, self.P, F, Q)
        self.predict()
        self.P = 0.5 * (self.P + self.P.T)

    def predict_x(self, u: float = 0) -> None:  # noqa: ARG002 - the signature is filterpy's
        """Hand filterpy's `predict` the state that `predict_motion` has worked out."""
        self.x = self._next_x

    def renew_fast_slip(self, covariance: Floats) -> None:
        """A new step begins, with a fast slip that is independent of all that was known.

        Args:
            covariance: (3, 3) of the new fast slip.
        """
        self.x[s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, :] = 0.0
        self.P[:, s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, s.FAST_SLIP] = covariance
        if self.marks is not None:
            self.marks = self.marks.renewed()

    def reopen(self, *states: int, variance: float) -> None:
        """Make states more uncertain, each by a variance and independently of all else."""
        for index in states:
            self.P[index, index] += variance

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
            kept: states that are not to be moved, whatever their correlations say; the covariance
                takes that into account (Schmidt-Kalman; the Joseph form holds for any gain).
        """
        cross = self.P.dot(row)
        expected = float(row.dot(cross)) + variance
        gain = cross / expected
        for index in kept:
            gain[index] = 0.0
        if self.marks is not None:
            self.marks = self.marks.updated(residual, row, cross, gain, expected, kept=s.X in kept)
        self.x = self.x + gain * residual
        half = gain[:, None] * (cross - (0.5 * expected) * gain)
        self.P = self.P - (half + half.T)

    def keep_inside_bounds(self) -> None:
        """Project the parameters back where ICRs can be: eta0 >= 1 and x_ICRl < 0 < x_ICRr.

        The state moves along the covariance to the nearest point of the violated bound; the
        covariance stays, which is on the safe side (Simon, Optimal State Estimation, section 7.5).
        """
        half = 0.5 * self.model.vehicle.gauge
        for _ in range(BOUND_ROUNDS):
            moved = False
            for by_eta, by_epsilon, bound in (
                (1.0, 0.0, 1.0),
                (half, 1.0, BOUND_MARGIN),
                (half, -1.0, BOUND_MARGIN),
            ):
                eta, epsilon = self.x.item(s.ETA0), self.x.item(s.EPSILON0)
                short = bound - (by_eta * eta + by_epsilon * epsilon)
                if short <= ROUNDING:
                    continue
                cross = by_eta * self.P[:, s.ETA0] + by_epsilon * self.P[:, s.EPSILON0]
                spread = float(by_eta * cross[s.ETA0] + by_epsilon * cross[s.EPSILON0])
                if spread > 0.0:
                    self.x = self.x + cross * (short / spread)
                    if self.marks is not None:
                        direction = by_eta * IDENTITY[s.ETA0] + by_epsilon * IDENTITY[s.EPSILON0]
                        self.marks = self.marks.projected(direction, short / spread)
                    moved = True
            if not moved:
                break


def _basis(motion: Motion, left: float, right: float, slip_share: float) -> Floats:
    """(8, SIZE + 2) what each state, and the speed of each track, moves the channels by."""
    gains = motion.regressors
    basis = BASIS.copy()
    for channel, slip in SLIP_CHANNELS:
        basis[channel, slip] *= slip_share
    basis[ZETA, s.ZETA1] = gains.zeta1
    basis[EPSILON, s.EPSILON1] = gains.epsilon1
    basis[ETA, s.ETA1] = gains.eta1
    basis[ETA, s.ETA2] = gains.eta2
    basis[D, s.TRACK_SCALE] = right - left
    basis[V_M, s.TRACK_SCALE] = 0.5 * (left + right)
    return basis


def step_on_se2(yaw: float, motion: Floats) -> tuple[Floats, Floats, Floats]:
    """Increment of the pose by a body motion, its derivative by yaw (2,) and by the motion (3, 3)."""
    dx, dy, angle = motion.tolist()
    a, b = arc_factors(angle)
    if abs(angle) < 1e-4:
        a_slope, b_slope = -angle / 3.0, 0.5 - angle * angle / 8.0
    else:
        a_slope, b_slope = (math.cos(angle) - a) / angle, (math.sin(angle) - b) / angle
    cos, sin = math.cos(yaw), math.sin(yaw)
    chord_x, chord_y = a * dx - b * dy, b * dx + a * dy
    turn_x, turn_y = a_slope * dx - b_slope * dy, b_slope * dx + a_slope * dy
    step_x, step_y = cos * chord_x - sin * chord_y, sin * chord_x + cos * chord_y
    by_motion = np.array(
        [
            [cos * a - sin * b, -cos * b - sin * a, cos * turn_x - sin * turn_y],
            [sin * a + cos * b, -sin * b + cos * a, sin * turn_x + cos * turn_y],
            [0.0, 0.0, 1.0],
        ]
    )
    return np.array([step_x, step_y, angle]), np.array([-step_y, step_x]), by_motion


def _gauss_markov_noise(dt: float, tau: float, decay: float) -> tuple[float, float, float]:
    """Covariance of a unit-variance Gauss-Markov process and its integral, driven over `dt`.

    Returns:
        Variance of the integral [s²], covariance of integral and value [s], variance of the value.
    """
    ratio = dt / tau
    lost = -math.expm1(-ratio)
    if ratio < 1e-3:
        integral = 2.0 / 3.0 * tau * tau * ratio**3 * (1.0 - 0.75 * ratio)
    else:
        integral = 2.0 * tau * tau * (ratio - 2.0 * lost + 0.5 * lost * (1.0 + decay))
    return integral, tau * lost * lost, lost * (1.0 + decay)
