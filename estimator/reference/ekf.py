"""Textbook of the filter: an extended Kalman filter on filterpy.

State x: pose, slip, the parameters of the ICR model, biases and scales, gravity along the ground, and
fast slip (`icreckon.estimator.base.state`). With P its covariance, each step of length dt

    predicts   pose' = pose (+) Exp(twist dt)        twist = kinematics(track speeds, parameters) + slip,
                                                     projected onto the horizontal
               slip' = slip exp(-dt / tau)           a Gauss-Markov process for each component
               gravity' = gravity - rates x gravity dt       fixed in odom
               P' = F P F' + Q                       F = dx'/dx, Q the process noise
    updates    S = H P H' + R, K = P H' / S          one scalar measurement after the other
               x' = x + K z, P' = P - K H P

The kinematics are equations (20) to (30) of the paper with constant indices, or with indices that move
with the force of inertia, (25) to (27): `icreckon.estimator.motion.lagged_index_model`. All of it is
dense NumPy; nothing here watches for faults. A test holds the filter that runs on robots to this one.

The fast slip is white from one step to the next, and contains the error of the track speeds. It is part
of the state because one error both moves the pose and shows in the gyro's innovation. For the same reason
the derivatives by the parameters are smoothed in time: their noise is that of the track speeds, which is
in the innovation, too.
"""

import math
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.engine.constants import REGRESSOR_SMOOTHING
from icreckon.estimator.filter.ekf import WHOLE
from icreckon.estimator.motion.bounds import inside
from icreckon.estimator.motion.motion_model import (
    MotionModel,
    TwistModel,
    Unremembering,
    gravity_in,
    track_factors,
)
from icreckon.estimator.motion.propagation import (
    Triple,
    downward_gravity,
    gauss_markov,
    horizontal_projection,
    step_on_se2,
    turn,
    upward,
)
from icreckon.estimator.sensors.held_tracks import smoothing_share
from icreckon.estimator.sensors.measurement_models import POSE_FIXED, gyro_fixed, imu_fixed

# First columns of `by_speeds`, `by_slip` and `by_gravity` in `TwistDerivatives` side by side.
COLUMNS = (s.PARAMETER_COUNT, s.PARAMETER_COUNT + 2, s.PARAMETER_COUNT + 5)
# Paper's axes to REP-103: forward is the paper's second, left is minus its first.
TO_REP103 = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


class ProcessNoise(NamedTuple):
    """Noise of one prediction step."""

    slip_sigma: Floats  # (3,) stationary standard deviation of the slip [m/s, m/s, rad/s]
    time_constants: Triple  # (3,) correlation times of the slip [s]
    walk: Floats  # (SIZE,) random-walk densities of the states, per √s
    forgetting: float = 0.0  # rate at which gravity along the ground returns to zero [1/s]


class IcrEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """EKF with the kinematics of ICRs as its motion model.

    `x` is (SIZE,), `P` (SIZE, SIZE); `icreckon.estimator.base.state` has their layout. `F` and `Q` are
    those of the newest prediction. Updates are scalar (`update_scalar`).

    Args:
        model: the motion model.

    Attributes:
        regressors: (3, 10) smoothed derivatives of the twist by the parameters, of the steps before, and
            last in the third row the yaw rate; None for those of the present speeds.
        fixed_for_imu: places of the states that an accelerometer update leaves.
        fixed_for_gyro: places of the states that a gyro update leaves.
    """

    def __init__(self, model: MotionModel) -> None:
        super().__init__(dim_x=s.SIZE, dim_z=1)
        self.regressors: Floats | None = None
        self.fixed_for_imu = imu_fixed(model.taught_by_imu)
        self.fixed_for_gyro = gyro_fixed(model.taught_by_imu)
        self.x: Floats = np.zeros(s.SIZE)
        self.P: Floats = np.zeros((s.SIZE, s.SIZE))
        self.F: Floats = np.eye(s.SIZE)
        self.Q: Floats = np.zeros((s.SIZE, s.SIZE))
        self.model = model

    def twist_model(self, left: float, right: float, slip_shares: Triple = WHOLE) -> TwistModel:
        """Body velocity and its Jacobian at the present state.

        Args:
            left: measured speed of the left track [m/s].
            right: measured speed of the right track [m/s].
            slip_shares: factors on the slip, for its mean over a step.
        """
        model = self._evaluate(left, right, slip_shares)
        if self.regressors is not None:
            model.jacobian[:, s.PARAMETERS] = self.regressors[:, : s.PARAMETER_COUNT]
        return model

    def _evaluate(self, left: float, right: float, slip_shares: Triple) -> TwistModel:
        """Evaluate the motion model as `twist_model` does, without smoothed derivatives."""
        x = self.x.tolist()
        left_factor, right_factor = track_factors(x)
        slip_x, slip_y, slip_w = (
            share * slow + fast
            for share, slow, fast in zip(slip_shares, x[s.SLIP], x[s.FAST_SLIP], strict=True)
        )
        # The motion model has the paper's axes: right, which is minus left, and forward.
        speeds, slip = (left * left_factor, right * right_factor), (-slip_y, slip_x, slip_w)
        motion, derivatives = self.model.linearise(*speeds, x[s.PARAMETERS], slip, gravity_in(x))
        by_all = TO_REP103.dot(np.hstack(derivatives))
        by_parameters, by_speeds, by_slip, by_gravity = np.split(by_all, COLUMNS, axis=1)
        by_slip = by_slip.dot(TO_REP103.T)
        jacobian = np.zeros((3, s.SIZE))
        jacobian[:, s.SLIP] = by_slip * slip_shares
        jacobian[:, s.FAST_SLIP] = by_slip
        jacobian[:, s.PARAMETERS] = by_parameters
        jacobian[:, s.TRACK_SCALE] = by_speeds.dot((left, right))
        jacobian[:, s.TRACK_DIFFERENCE] = by_speeds.dot((-0.5 * left, 0.5 * right))
        by_right, by_forward = by_gravity.T
        jacobian[:, s.GRAVITY_X], jacobian[:, s.GRAVITY_Y] = by_forward, -by_right
        rightward, forward, w = motion.twist
        by_measured = by_speeds * (left_factor, right_factor)
        return TwistModel(np.array([forward, -rightward, w]), jacobian, by_measured, motion)

    def begin_step(self, dt: float, left: float, right: float) -> None:
        """Begin a step of `dt` seconds at mean track speeds [m/s] in the motion model."""
        if not isinstance(self.model, Unremembering):
            x = self.x.tolist()
            left_factor, right_factor = track_factors(x)
            speeds = left * left_factor, right * right_factor
            self.model.begin_step(dt, *speeds, x[s.PARAMETERS], gravity_in(x))

    @property
    def turn(self) -> float:
        """Yaw rate of the regressors [rad/s]."""
        return 0.0 if self.regressors is None else self.regressors.item(2, s.PARAMETER_COUNT)

    def _regressors_at(self, left: float, right: float, shares: Triple) -> Floats:
        """Regressors (3, 10) at the yaw rate that both the tracks and the estimate show.

        So noise of either moves no parameter and no bias (errors in variables).
        """
        x, now = self.x, self._evaluate(left, right, shares)
        estimated = now.twist[2]
        by_tracks = estimated - (shares[2] * x[s.SLIP_W] + x[s.FAST_SLIP][2])
        shown = min(estimated, by_tracks, key=abs) if estimated * by_tracks > 0.0 else 0.0
        # Least change of the track speeds that gives this yaw rate without slip.
        slope = now.by_speeds[2]
        left, right = np.array((left, right)) + slope * ((shown - by_tracks) / slope.dot(slope))
        self.x = x.copy()
        self.x[s.SLIP] = self.x[s.FAST_SLIP] = 0.0
        derivatives = self._evaluate(left, right, shares).jacobian[:, s.PARAMETERS]
        self.x = x
        return np.column_stack([derivatives, [0.0, 0.0, shown]])

    def predict_motion(
        self,
        dt: float,
        left: float,
        right: float,
        noise: ProcessNoise,
        tilt_rates: tuple[float, float] = (math.nan, math.nan),
    ) -> None:
        """Propagate over `dt` seconds with constant track speeds [m/s].

        Args:
            dt: length of the step [s].
            left: speed of the left track.
            right: speed of the right track.
            noise: noise of the step.
            tilt_rates: rates of roll and pitch by the gyros [rad/s], NaN if they are not known.
        """
        decay, mean, integral, cross, final = zip(
            *(gauss_markov(dt, tau) for tau in noise.time_constants), strict=True
        )
        model, gravity = self.twist_model(left, right, mean), self.x[s.GRAVITY].tolist()
        if self.regressors is not None:
            self.regressors += smoothing_share(dt, REGRESSOR_SMOOTHING) * (
                self._regressors_at(left, right, mean) - self.regressors
            )
        biases, down = self.x[[s.GYRO_BIAS_X, s.GYRO_BIAS_Y]], downward_gravity(gravity)
        roll_rate, pitch_rate = (np.array(tilt_rates) - biases).tolist()
        factors, yaw_by_pitch = horizontal_projection(gravity)
        kept, yaw_by_walk = 1.0, 0.0
        if math.isnan(roll_rate):
            # Gravity along the ground fades and walks: the body pitches without being measured.
            kept, yaw_by_walk = math.exp(-noise.forgetting * dt), yaw_by_pitch / down
            roll_rate = pitch_rate = down = 0.0
        by_twist = np.array(factors)
        moved = by_twist.dot(model.twist) * dt
        moved[s.YAW] += yaw_by_pitch * pitch_rate * dt
        step, by_yaw, rows = step_on_se2(self.x.item(s.YAW), moved.tolist())
        up, moving = upward(gravity), model.twist[:2]
        by_motion = np.vstack([np.array(rows).dot(by_twist), [*up, 0.0]])
        by_state = by_motion.dot(model.jacobian)
        by_state[s.Z, s.GRAVITY] += upward(moving)
        self.F = F = np.eye(s.SIZE)
        F[s.MOVED] += by_state * dt
        F[s.POSITION, s.YAW] += by_yaw
        F[s.SLIP, s.SLIP] = np.diag(decay)
        cos, sin = turn(model.twist.item(2) * dt)
        back = kept * np.array([[cos, sin], [-sin, cos]])
        F[s.GRAVITY, s.GRAVITY] = back
        F[s.GRAVITY_X, s.GYRO_BIAS_Y], F[s.GRAVITY_Y, s.GYRO_BIAS_X] = -down * dt, down * dt

        # Random walks and slip, and their effect on the pose within the step. The slip of w within it is
        # part of the fast slip.
        walk, slip = noise.walk**2, noise.slip_sigma**2
        integral, cross = (*integral[:2], 0.0), (*cross[:2], 0.0)
        walked, slipped = by_state * walk, by_motion * slip
        with_pose = walked * (dt**2 / 2.0)
        with_pose[:, s.SLIP] += slipped * cross
        self.Q = Q = np.zeros((s.SIZE, s.SIZE))
        Q[s.MOVED] = with_pose
        Q[:, s.MOVED] = with_pose.T
        Q[s.MOVED, s.MOVED] = walked.dot(by_state.T) * (dt**3 / 3.0)
        Q[s.MOVED, s.MOVED] += (slipped * integral).dot(by_motion.T)
        Q += np.diag(walk * dt)
        turned = yaw_by_walk * walk[s.GRAVITY_X] * dt
        Q[s.YAW, s.GRAVITY_X] += turned
        Q[s.GRAVITY_X, s.YAW] += turned
        Q[s.YAW, s.YAW] += yaw_by_walk * turned
        Q[s.SLIP, s.SLIP] += np.diag(slip * final)

        x = self.x.copy()
        x[s.MOVED] += (*step, moving.dot(up) * dt)
        x[s.SLIP] *= decay
        x[s.GRAVITY] = back.dot(self.x[s.GRAVITY])
        x[s.GRAVITY_X] += down * pitch_rate * dt
        x[s.GRAVITY_Y] -= down * roll_rate * dt
        self.predict(x)
        self.P = 0.5 * (self.P + self.P.T)

    def predict_x(self, u: Floats) -> None:
        """Set the state that `predict_motion` computed; called by filterpy's `predict`."""
        self.x = u

    def renew_fast_slip(self, covariance: Floats) -> None:
        """Begin a step with a new fast slip of this covariance (3, 3)."""
        self.x[s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, :] = 0.0
        self.P[:, s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, s.FAST_SLIP] = covariance

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
            fixed: states that are not to be moved.
            stand_in: state that is moved in their place, so that the predicted measurement moves as far
                as if none were fixed; none of them.
        """
        c = self.P.dot(h)
        S = float(h.dot(c)) + r
        K = c / S
        missing = float(h[list(fixed)].dot(K[list(fixed)]))
        K[list(fixed)] = 0.0
        if stand_in is not None:
            K[stand_in] += missing / h[stand_in]
        self.x = self.x + K * z
        half = K[:, None] * (c - (0.5 * S) * K)
        self.P = self.P - (half + half.T)

    def keep_inside_bounds(self, *, by_imu: bool = False) -> None:
        """Project the parameters to their bounds.

        Args:
            by_imu: leave the states that a gyro update must not move; otherwise only the pose.
        """
        fixed = self.fixed_for_gyro if by_imu else POSE_FIXED
        self.x = inside(self.x, self.P, self.model.bounds, fixed)
