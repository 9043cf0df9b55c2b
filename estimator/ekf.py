"""The extended Kalman filter: state propagation and measurement updates, nothing about streams.

    pose'  = pose (+) Exp(twist dt)          twist = kinematics(track speeds, parameters) + slip
    slip'  = slip exp(-dt / tau) + noise     a Gauss-Markov process for each component

Parameters, biases and scales are constants or random walks. The error of the newest track-speed sample
is part of the state, because one and the same error moves the pose and shows in the gyro's innovation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from estimator import state as s
from estimator.frames import Floats, arc_factors
from estimator.motion import Channels, Form, Motion, VehicleConstants, channels, solve

# How much of eta0 is kept away from the bounds x_ICRl < 0 < x_ICRr and eta0 >= 1.
BOUND_MARGIN = 1e-3


class TwistModel(NamedTuple):
    """The body velocity at a state: value (3,), Jacobian by the state (3, SIZE), and the motion."""

    twist: Floats
    jacobian: Floats
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
    """A scalar measurement against its prediction: residual, its variance, and whether it was used."""

    residual: float
    variance: float
    used: bool

    @property
    def nis(self) -> float:
        """Normalised innovation squared, chi-square with one degree of freedom."""
        return self.residual * self.residual / self.variance


class InertiaEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's EKF with the inertia-based ICR kinematics as its motion model.

    `x` is (SIZE,), `P` (SIZE, SIZE); see `estimator.state` for what stands where.

    Args:
        vehicle: gauge, mass and centre of mass.
        form: form of the index polynomials.
        slip_in_inertia: whether the slip (which the IMU shows) counts in the force of inertia.
    """

    def __init__(
        self, vehicle: VehicleConstants, form: Form = "smooth", slip_in_inertia: bool = False
    ) -> None:
        super().__init__(dim_x=s.SIZE, dim_z=1)
        self.x: Floats = np.zeros(s.SIZE)
        self.P: Floats = np.zeros((s.SIZE, s.SIZE))
        self.vehicle = vehicle
        self.form = form
        self.slip_in_inertia = slip_in_inertia
        self._next_x: Floats = self.x

    def twist_model(self, left: float, right: float, slip_share: float = 1.0) -> TwistModel:
        """Body velocity and its Jacobian at the present state.

        Args:
            left: measured speed of the left track [m/s].
            right: measured speed of the right track [m/s].
            slip_share: factor on the slip, for its mean over a step.
        """
        x = self.x.tolist()
        scale = 1.0 + x[s.TRACK_SCALE]
        V_l = left * scale - x[s.TRACK_ERROR_L]
        V_r = right * scale - x[s.TRACK_ERROR_R]
        # REP-103 slip in the paper's axes: right is minus left.
        slip = (-slip_share * x[s.SLIP_Y], slip_share * x[s.SLIP_X], slip_share * x[s.SLIP_W])
        parameters = x[s.PARAMETERS]
        motion = solve(
            V_l,
            V_r,
            parameters,
            self.vehicle,
            form=self.form,
            slip=slip,
            slip_in_inertia=self.slip_in_inertia,
        )
        by = channels(
            V_l,
            V_r,
            parameters,
            self.vehicle,
            motion,
            form=self.form,
            slip=slip,
            slip_in_inertia=self.slip_in_inertia,
        )
        twist = motion.twist
        return TwistModel(
            np.array([twist.v_y, -twist.v_x, twist.w]),
            _twist_jacobian(by, motion, left, right, slip_share),
            motion,
        )

    def predict_motion(self, dt: float, left: float, right: float, noise: ProcessNoise) -> None:
        """Propagate over `dt` seconds with constant track speeds [m/s]."""
        ratio = dt / noise.time_constant
        decay = math.exp(-ratio)
        share = -math.expm1(-ratio) / ratio if ratio > 0.0 else 1.0
        model = self.twist_model(left, right, share)
        pose, by_yaw, by_motion = _step_on_se2(self.x[s.YAW], model.twist * dt)

        self.F = np.eye(s.SIZE)
        self.F[s.POSE] += (by_motion * dt) @ model.jacobian
        self.F[s.X, s.YAW] += by_yaw[0]
        self.F[s.Y, s.YAW] += by_yaw[1]
        self.F[s.SLIP, s.SLIP] *= decay

        self.Q = np.diag(noise.walk**2 * dt)
        integral, cross, final = _gauss_markov_noise(dt, noise.time_constant, decay)
        power = noise.slip_sigma**2
        self.Q[s.POSE, s.POSE] += (by_motion * (power * integral)) @ by_motion.T
        pose_slip = by_motion * (power * cross)
        self.Q[s.POSE, s.SLIP] += pose_slip
        self.Q[s.SLIP, s.POSE] += pose_slip.T
        self.Q[s.SLIP, s.SLIP] += np.diag(power * final)

        self._next_x = self.x.copy()
        self._next_x[s.POSE] += pose
        self._next_x[s.SLIP] *= decay
        self.predict()
        self.P = 0.5 * (self.P + self.P.T)

    def predict_x(self, u: float = 0) -> None:  # noqa: ARG002 - the signature is filterpy's
        """Hand filterpy's `predict` the state that `predict_motion` has worked out."""
        self.x = self._next_x

    def renew_track_errors(self, variance: float) -> None:
        """A new track-speed sample has come: its error is independent of all that was known."""
        self.x[s.TRACK_ERROR] = 0.0
        self.P[s.TRACK_ERROR, :] = 0.0
        self.P[:, s.TRACK_ERROR] = 0.0
        self.P[s.TRACK_ERROR_L, s.TRACK_ERROR_L] = variance
        self.P[s.TRACK_ERROR_R, s.TRACK_ERROR_R] = variance

    def innovation(self, residual: float, row: Floats, variance: float) -> Innovation:
        """The innovation of a scalar measurement, not yet used.

        Args:
            residual: measured less predicted.
            row: (SIZE,) Jacobian of the prediction.
            variance: of the measurement.
        """
        return Innovation(residual, float(row @ self.P @ row) + variance, used=False)

    def estimate_after(self, residual: float, row: Floats, variance: float) -> Floats:
        """The state (SIZE,) that `update_scalar` would lead to, without going there."""
        cross = self.P @ row
        return np.asarray(self.x + cross * (residual / float(row @ cross + variance)))

    def update_scalar(self, residual: float, row: Floats, variance: float) -> None:
        """Joseph update with one scalar measurement (Simon, Optimal State Estimation, eq. 5.19).

        Args:
            residual: measured less predicted.
            row: (SIZE,) Jacobian of the prediction.
            variance: of the measurement.
        """
        cross = self.P @ row
        gain = cross / (row @ cross + variance)
        self.x = self.x + gain * residual
        reduced = self.P - np.outer(gain, cross)
        P = reduced - np.outer(reduced @ row, gain) + np.outer(gain * variance, gain)
        self.P = 0.5 * (P + P.T)

    def keep_inside_bounds(self) -> None:
        """Project the parameters back where ICRs can be: eta0 >= 1 and x_ICRl < 0 < x_ICRr.

        The state moves along the covariance to the nearest point of the violated bound; the
        covariance stays, which is on the safe side (Simon, Optimal State Estimation, section 7.5).
        """
        half = 0.5 * self.vehicle.gauge
        for row, bound in (
            ({s.ETA0: 1.0}, 1.0),
            ({s.ETA0: half, s.EPSILON0: 1.0}, BOUND_MARGIN),
            ({s.ETA0: half, s.EPSILON0: -1.0}, BOUND_MARGIN),
        ):
            value = sum(factor * self.x[index] for index, factor in row.items())
            if value < bound:
                direction = np.zeros(s.SIZE)
                direction[list(row)] = list(row.values())
                cross = self.P @ direction
                spread = float(direction @ cross)
                if spread > 0.0:
                    self.x = self.x + cross * ((bound - value) / spread)


def _twist_jacobian(
    by: Channels, motion: Motion, left: float, right: float, slip_share: float
) -> Floats:
    """Jacobian (3, SIZE) of the REP-103 twist by the state, from the channels of the model."""
    by_left = [0.5 * m - d for m, d in zip(by.V_m, by.D, strict=True)]
    by_right = [0.5 * m + d for m, d in zip(by.V_m, by.D, strict=True)]
    paper = np.zeros((3, s.SIZE))
    paper[:, s.SLIP_X] = by.r_y
    paper[:, s.SLIP_Y] = by.r_x
    paper[:, s.SLIP_W] = by.r_w
    paper[:, s.SLIP] *= slip_share
    paper[:, s.SLIP_Y] *= -1.0
    paper[:, s.ZETA0] = by.zeta
    paper[:, s.EPSILON0] = by.epsilon
    paper[:, s.ETA0] = by.eta
    paper[:, s.ZETA1] = paper[:, s.ZETA0] * motion.Z
    paper[:, s.EPSILON1] = paper[:, s.EPSILON0] * motion.S
    paper[:, s.ETA1] = paper[:, s.ETA0] * motion.S
    paper[:, s.ETA2] = paper[:, s.ETA0] * (motion.u * motion.u)
    paper[:, s.TRACK_ERROR_L] = by_left
    paper[:, s.TRACK_ERROR_R] = by_right
    paper[:, s.TRACK_SCALE] = left * paper[:, s.TRACK_ERROR_L] + right * paper[:, s.TRACK_ERROR_R]
    paper[:, s.TRACK_ERROR] *= -1.0
    return np.stack([paper[1], -paper[0], paper[2]])


def _step_on_se2(yaw: float, motion: Floats) -> tuple[Floats, Floats, Floats]:
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
