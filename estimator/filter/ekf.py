"""State and covariance of the filter, and dense updates with any measurement.

    pose' = pose (+) Exp(twist dt)        twist = kinematics(track speeds, parameters) + slip + fast slip,
                                          projected onto the horizontal
    slip' = slip exp(-dt / tau) + noise   a Gauss-Markov process for each component
    gravity' = gravity - rates x gravity dt + noise       its part along the ground, by all three gyros

Parameters, biases and scales are constants or random walks. The fast slip is white from one step to the
next, and contains the error of the track speeds. It is part of the state because one error both moves the
pose and shows in the gyro's innovation. It also keeps fast motion from moving the parameters. With slow
slip alone, quick changes would count for too much, and noisy track speeds are bad regressors for them
(errors in variables). For the same reason the derivatives by the parameters are smoothed in time, and
taken at the turn on which tracks and gyro agree: noise of the track speeds is in the innovation, too.

The steps are those of `icreckon.estimator.engine.step`.

Noises must be independent of each other where components update the filter one after the other. With R =
L D L' (L lower triangular with ones on its diagonal, D diagonal) the components L⁻¹ z have noise D and
carry the same information as z (Simon, Optimal State Estimation, section 6.1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.changes import Listener, Moved, Updated
from icreckon.estimator.filter.clones import Clones
from icreckon.estimator.filter.gate import Gate, inflation, patience_for
from icreckon.estimator.filter.health import REACQUIRED, REJECTED
from icreckon.estimator.motion.bounds import inside
from icreckon.estimator.motion.motion_model import MotionModel, TwistModel
from icreckon.estimator.motion.propagation import Triple
from icreckon.estimator.sensors.measurement_models import POSE_FIXED, Linearised, MeasurementModel
from icreckon.estimator.sensors.sensor_models import shift

# A measurement whose variance is below this share of its innovation's is sharp. Such an update may leave
# less of the variances than rounding does: each is inflated by a share of what it was before.
SHARP, ROUNDING_SHARE = 1e-7, 2.0**-46
# Least variance of a measurement, in its unit squared: the state does not resolve smaller ones.
LEAST_VARIANCE = 1e-18
WHOLE = (1.0, 1.0, 1.0)  # factors on the slip that leave it as it is


class Observer(Listener, Protocol):
    """Observer that is notified of every change to the filter."""

    def replaced(self, covariance: Floats) -> None:
        """New pose, and wander if there is one, see `Ekf.replace_pose`."""

    def wandered(self, decay: float, variance: float) -> None:
        """Wander of the fixes over some time, see `Ekf.let_wander`."""


class Ekf:
    """State and covariance of a filter.

    `x` is (SIZE,), `P` (SIZE, SIZE); `icreckon.estimator.base.state` has their layout. If fixes wander,
    two more states follow (`add_wander`). Updates are scalar (`update_scalar`).

    Attributes:
        regressors: (3, 10) derivatives of the twist by the parameters, smoothed over earlier steps; the
            last entry of the third row is the smoothed yaw rate [rad/s].
        clones: stochastic clones, None if there are none; they change nothing else.
        observer: observer of all changes, or None.
        considered: consider states: updates do not move them, but their covariance counts
            (Schmidt-Kalman).
        evaluation: body velocity of a filter at track speeds [m/s] and factors on the slip; its engine
            sets it.
    """

    evaluation: Callable[[Ekf, float, float, Triple], TwistModel]

    def __init__(self, model: MotionModel) -> None:
        self.regressors: Floats = np.zeros((3, s.REGRESSOR_COUNT))
        self.clones: Clones | None = None
        self.observer: Observer | None = None
        self.considered: tuple[int, ...] = ()
        self.x: Floats = np.zeros(s.SIZE)
        self.P: Floats = np.zeros((s.SIZE, s.SIZE))
        self.model = model
        self._bounds = model.bounds
        # Cache of the newest evaluation of the twist model.
        self._evaluated_at: tuple[float | bytes, ...] | None = None
        self._evaluated: TwistModel

    def __getstate__(self) -> dict[str, Any]:
        # The engine sets its evaluation in copies, too.
        return {name: value for name, value in vars(self).items() if name != "evaluation"}

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
        """Propagate the wander of position fixes, which decays and gains a variance [m²].

        The decay is one number, which commutes with all other changes of that time. So one call before
        each fix is as exact as one in each step.
        """
        self.x[s.WANDER] *= decay
        fade_wander(self.P, decay)
        self.P[[s.WANDER_X, s.WANDER_Y], [s.WANDER_X, s.WANDER_Y]] += variance
        if self.clones is not None:
            self.clones = self.clones.faded(s.WANDER, decay)
        if self.observer is not None:
            self.observer.wandered(decay, variance)

    def twist_model(self, left: float, right: float, slip_shares: Triple = WHOLE) -> TwistModel:
        """Body velocity and Jacobian at track speeds [m/s] and slip shares; read-only."""
        arrays = self.x.tobytes(), self.model.memory.tobytes(), self.regressors.tobytes()
        key = (left, right, *slip_shares, *arrays)
        if key != self._evaluated_at:
            model = self.evaluation(self, left, right, slip_shares)
            model.jacobian[:, s.PARAMETERS] = self.regressors[:, : s.PARAMETER_COUNT]
            self._evaluated, self._evaluated_at = model, key
        return self._evaluated

    # --- changes by a step, see `changes.Listener` ------------------------------------------------

    def renewed(self, covariance: Floats) -> None:
        """Pass on a new fast slip."""
        if self.clones is not None:
            self.clones = self.clones.renewed()
        if self.observer is not None:
            self.observer.renewed(covariance)

    def inflated(self, states: Sequence[int], covariance: Floats, yaw: float | None = None) -> None:
        """Pass on an inflation; with a yaw [rad] it is an error of the motion there."""
        if self.observer is not None:
            self.observer.inflated(states, covariance)
        if yaw is not None and self.clones is not None:
            self.clones = self.clones.inflated(yaw, tuple(states), covariance)

    def updated(self, change: Updated) -> None:
        """Pass on a scalar update."""
        if self.clones is not None:
            share = ROUNDING_SHARE if change.is_sharp else 0.0
            self.clones = self.clones.updated(change, fixed=s.X in change.fixed, inflation=share)
        if self.observer is not None:
            self.observer.updated(change)

    def moved(self, step: Moved) -> None:
        """Pass on a step."""
        if self.clones is not None:
            self.clones = self.clones.moved(step)
        if self.observer is not None:
            self.observer.moved(step)

    # --- dense changes ----------------------------------------------------------------------------

    def renew_fast_slip(self, covariance: Floats) -> None:
        """Begin a step with a new, independent fast slip of a covariance (3, 3)."""
        self.x[s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, :] = self.P[:, s.FAST_SLIP] = 0.0
        self.P[s.FAST_SLIP, s.FAST_SLIP] = covariance
        self.renewed(covariance)

    def replace_pose(self, pose: Floats, covariance: Floats) -> None:
        """Replace the pose (3,) [m, m, rad] by another, independent of all other states.

        The covariance is (3, 3); if fixes wander, (5, 5) of the pose and of a new wander of zero.
        """
        states = replaced_states(covariance)
        self.x[states] = 0.0
        self.x[s.POSE] = pose
        self.P[states, :] = self.P[:, states] = 0.0
        self.P[np.ix_(states, states)] = covariance
        if self.clones is not None:
            self.clones = self.clones.renewed(states)
        if self.observer is not None:
            self.observer.replaced(covariance)

    def inflate(self, *states: int, variance: float, of_motion: bool = False) -> None:
        """Inflate states, each by a variance and independently of all other states."""
        self.inflate_jointly(states, variance * np.eye(len(states)), of_motion=of_motion)

    def inflate_jointly(
        self, states: tuple[int, ...], covariance: Floats, *, of_motion: bool = False
    ) -> None:
        """Inflate n states by a covariance (n, n); `of_motion`: an error of the motion."""
        self.P[np.ix_(states, states)] += covariance
        self.inflated(states, covariance, self.x.item(s.YAW) if of_motion else None)

    def update_scalar(self, z: float, h: Floats, r: float, *, fixed: tuple[int, ...] = ()) -> None:
        """Update with one scalar measurement, in Joseph form.

        With c = P h, S = h'c + r and any gain K, the covariance is P - K c' - c K' + S K K' (Simon,
        Optimal State Estimation, eq. 5.19). So fixed states simply have no gain (Schmidt-Kalman).

        Args:
            z: innovation, measured less predicted.
            h: (SIZE,) Jacobian of the predicted measurement.
            r: variance of the measurement noise.
            fixed: states that are not to be moved, besides those considered.
        """
        if self.considered:
            fixed = tuple(sorted({*fixed, *self.considered}))
        if self.wanders and s.X in fixed:
            # A fix measures the sum of position and wander: neither may move without the other.
            fixed = (*fixed, s.WANDER_X, s.WANDER_Y)
        variances = self.P.diagonal()
        c = self.P.dot(h)
        S = float(h.dot(c)) + r
        K = c / S
        K[list(fixed)] = 0.0
        self.x = self.x + K * z
        half = K[:, None] * (c - (0.5 * S) * K)
        self.P = self.P - (half + half.T)
        is_sharp = r < SHARP * S
        self.updated(Updated(z, r, S, is_sharp, h, c, K, fixed))
        if is_sharp:
            for index, variance in enumerate((ROUNDING_SHARE * variances).tolist()):
                self.inflate(index, variance=variance)

    def keep_inside_bounds(self) -> None:
        """Project parameters to the model's bounds; pose and consider states do not move."""
        fixed = (*POSE_FIXED, *self.considered, *range(s.SIZE, len(self.x)))
        self.x = inside(self.x, self.P, self._bounds, fixed)


def update(
    ekf: Ekf,
    model: MeasurementModel,
    gate: Gate,
    linearised: Linearised,
    stamp: int,
    interval: float,
    *,
    fastest: float,
) -> bool:
    """Update with a measurement, with all of its components in turn or none.

    Args:
        ekf: the filter.
        model: measurement model of the sensor.
        gate: gate of the sensor.
        linearised: the measurement at the present state.
        stamp: stamp of the measurement [ns].
        interval: time to add to the time of rejections if the gate rejects it [s].
        fastest: highest track speed of the robot [m/s].

    Returns:
        True if the measurement was used.
    """
    shortfall = np.maximum(LEAST_VARIANCE - linearised.R.diagonal(), 0.0)
    linearised = linearised._replace(R=linearised.R + np.diag(shortfall))
    z, H, R = linearised
    S = np.asarray(H.dot(ekf.P).dot(H.T) + R)
    nis = normalised_square(z, S)
    squared_distance = float(z[:2] @ z[:2]) if model.is_place else 0.0
    verdict = gate.judge(nis, interval, patience_for(squared_distance, gate.patience, fastest))
    if verdict == REACQUIRED:
        R = _inflate_for(ekf, model, linearised, S)
    if verdict != REJECTED:
        if model.correlated and len(z) > 1:
            z, H, R = decorrelated(z, H, R)
        x_before = ekf.x.copy()
        for k in range(len(z)):
            # All components are linearised at `x_before`: earlier ones have changed the prediction.
            change = shift(H[k], ekf.x, x_before) if k else 0.0
            ekf.update_scalar(z.item(k) - change, H[k], R.item(k, k), fixed=model.fixed)
    gate.keep(stamp, verdict, linearised.z, S)
    return verdict != REJECTED


def normalised_square(z: Floats, S: Floats) -> float:
    """Normalised innovation squared (NIS) of an innovation (n,) of covariance (n, n)."""
    if len(z) == 1:
        return z.item() * z.item() / S.item()
    # Next to a singular prediction, R of a sharp measurement may vanish by rounding.
    return float(z @ np.linalg.solve(S + ROUNDING_SHARE * np.diag(S.diagonal()), z))


def decorrelated(z: Floats, H: Floats, R: Floats) -> Linearised:
    """Transform a measurement to components of independent noise."""
    # R of a prediction ahead of the IMU may be singular.
    root = np.linalg.cholesky(R + ROUNDING_SHARE * np.diag(R.diagonal()))
    sigmas = root.diagonal()
    L = root / sigmas
    mixed = np.linalg.solve(L, np.column_stack((z, H)))
    return Linearised(np.asarray(mixed[:, 0]), mixed[:, 1:], np.diag(sigmas * sigmas))


def _inflate_for(ekf: Ekf, model: MeasurementModel, linearised: Linearised, S: Floats) -> Floats:
    """Inflate the states that a re-acquired measurement is to move; return its R."""
    z, H, R = linearised
    squares, variances = z * z, S.diagonal()
    if model.inflated_jointly:
        squares, variances = np.full(len(z), z @ z), np.full(len(z), variances.min())
    for k, state in enumerate(model.inflated):
        added = inflation(squares.item(k), variances.item(k))
        if state in ekf.considered:
            # It cannot be moved: R of its component is inflated instead.
            R = R.copy()
            R[k, k] += added * H.item(k, state) ** 2
        else:
            ekf.inflate(state, variance=added)
    return R


def fade_wander(P: Floats, decay: float) -> None:
    """Scale the wander of fixes in a covariance or information matrix, in place."""
    P[s.WANDER] *= decay
    P[:, s.WANDER] *= decay


def replaced_states(covariance: Floats) -> list[int]:
    """States that `Ekf.replace_pose` replaces, by the size of its covariance."""
    return [s.X, s.Y, s.YAW, s.WANDER_X, s.WANDER_Y][: len(covariance)]
