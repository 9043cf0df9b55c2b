"""Measurement update of every sensor: innovation, gate, inflation, update, record.

Noises must be independent of each other where components update the filter one after the other. With R =
L D L' (L lower triangular with ones on its diagonal, D diagonal) the components L⁻¹ z have noise D and
carry the same information as z (Simon, Optimal State Estimation, section 6.1).
"""

from __future__ import annotations

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.ekf import ROUNDING_SHARE, Ekf
from icreckon.estimator.filter.gate import Gate, inflation, patience_for
from icreckon.estimator.filter.health import REACQUIRED, REJECTED
from icreckon.estimator.sensors.measurement_models import Linearised, MeasurementModel
from icreckon.estimator.sensors.sensor_models import shift

# Least variance of a measurement, in its unit squared: what is sharper, the state does not resolve.
LEAST_VARIANCE = 1e-18


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
    """Update with a measurement, all of its components or none.

    Args:
        ekf: the filter.
        model: measurement model of the sensor.
        gate: gate of the sensor.
        linearised: the measurement at the present state.
        stamp: stamp of the measurement [ns].
        interval: time that it counts if it is rejected [s].
        fastest: highest track speed of the robot [m/s].

    Returns:
        True if the measurement was used.
    """
    linearised = _resolved(linearised)
    z, H, R = linearised
    S = ekf.innovation_covariance(H, R)
    nis = normalised_square(z, S)
    square = float(z[:2] @ z[:2]) if model.is_place else 0.0
    verdict = gate.judge(nis, interval, patience_for(square, gate.patience, fastest))
    if verdict == REACQUIRED:
        R = _inflated(ekf, model, linearised, S)
    if verdict != REJECTED:
        correct(ekf, z, H, R, fixed=model.fixed, correlated=model.correlated)
    gate.keep(stamp, verdict, z, S)
    return verdict != REJECTED


def normalised_square(z: Floats, S: Floats) -> float:
    """Normalised innovation squared (NIS) of an innovation (n,) of covariance (n, n)."""
    if len(z) == 1:
        return z.item() * z.item() / S.item()
    # The prediction alone may be singular, beside which a sharp measurement vanishes.
    return float(z @ np.linalg.solve(S + ROUNDING_SHARE * np.diag(S.diagonal()), z))


def correct(
    ekf: Ekf,
    z: Floats,
    H: Floats,
    R: Floats,
    *,
    fixed: tuple[int, ...] = (),
    correlated: bool = True,
) -> None:
    """Update with each component of a measurement in turn, without a gate.

    Args:
        ekf: the filter.
        z: (n,) innovation at the present state.
        H: (n, SIZE) Jacobian of the predicted measurement.
        R: (n, n) covariance of the measurement noise.
        fixed: states that are not to be moved.
        correlated: use the correlations of R.
    """
    if correlated and len(z) > 1:
        z, H, R = decorrelated(z, H, R)
    x = ekf.x.copy()
    for k in range(len(z)):
        # Each component is linearised at the state before the first.
        moved = shift(H[k], ekf.x, x) if k else 0.0
        ekf.update_scalar(z.item(k) - moved, H[k], R.item(k, k), fixed=fixed)


def decorrelated(z: Floats, H: Floats, R: Floats) -> Linearised:
    """Transform a measurement to components of independent noise."""
    # The noise of the motion ahead of the IMU alone may be singular.
    root = np.linalg.cholesky(R + ROUNDING_SHARE * np.diag(R.diagonal()))
    sigmas = root.diagonal()
    L = root / sigmas
    mixed = np.linalg.solve(L, np.column_stack((z, H)))
    return Linearised(np.asarray(mixed[:, 0]), mixed[:, 1:], np.diag(sigmas * sigmas))


def _resolved(linearised: Linearised) -> Linearised:
    """Limit the variances of a measurement to those that the state resolves."""
    missing = LEAST_VARIANCE - linearised.R.diagonal()
    if missing.max() <= 0.0:
        return linearised
    return linearised._replace(R=linearised.R + np.diag(np.maximum(missing, 0.0)))


def _inflated(ekf: Ekf, model: MeasurementModel, linearised: Linearised, S: Floats) -> Floats:
    """Inflate the states that the measurement is to move; return R.

    A considered state cannot be moved: R of its component is inflated instead.
    """
    z, H, R = linearised
    squares, variances = z * z, S.diagonal()
    if model.inflated_jointly:
        squares, variances = np.full(len(z), z @ z), np.full(len(z), variances.min())
    for k, state in enumerate(model.inflated):
        more = inflation(squares.item(k), variances.item(k))
        if state in ekf.considered:
            R = R.copy()
            R[k, k] += more * H.item(k, state) ** 2
        else:
            ekf.inflate(state, variance=more)
    return R
