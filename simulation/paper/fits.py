"""Means and fits of the paper over stationary motions, and the errors of Table II.

The paper averages each ICR distribution and fits the indices by least squares; which motions count, and
with which weight, it does not state. This is the way that comes closest to the printed numbers
(`examples/paper` tries 36).
"""

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import symmetry_coordinates
from icreckon.estimator.robot.robot_file import ConstantIcr, Indices
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.paper.dynamic_map import (
    DynamicMap,
    Inertia,
    VelocityErrors,
    constant_twist,
    inertia_based_twist,
    on_spot_line,
    rmse,
)

LARGEST_INERTIA = 120.0  # of motions in means and fits [N]


def motions_in_fits(mapped: DynamicMap) -> NDArray[np.bool_]:
    """Mask of the motions in means and fits: those that turn, under little inertia."""
    return mapped.turning & (mapped.magnitude <= LARGEST_INERTIA)


def mean_icrs(mapped: DynamicMap) -> ConstantIcr:
    """Mean ICRs of a map [m] (section II).

    Raises:
        SimulationError: nothing turns, or no skid-steer vehicle has such means.
    """
    counted = motions_in_fits(mapped)
    if not counted.any():
        raise SimulationError("none of the motions turns: there are no ICRs to average or fit")
    try:
        return ConstantIcr(*(float(np.mean(coordinate[counted])) for coordinate in mapped.icrs))
    except ValueError as error:
        raise SimulationError(f"the mean ICRs make no sense: {error}") from error


def fitted_parameters(mapped: DynamicMap) -> Indices:
    """Eight index parameters of a map over a grid: H, and the fits of (25) to (27).

    Each motion weighs w²: the fit is one of the velocity that an index stands for.

    Raises:
        SimulationError: too few motions, or no skid-steer vehicle has the fitted parameters.
    """
    counted, H = motions_in_fits(mapped), on_spot_line(mapped)
    values = [H]
    for target, columns in index_columns(mapped, counted, H):
        values += weighted_fit(columns, target, mapped.motion.twist.w[counted] ** 2).tolist()
    try:
        return Indices(*values)
    except ValueError as error:
        raise SimulationError(f"the fitted parameters make no sense: {error}") from error


def index_columns(
    mapped: DynamicMap, counted: NDArray[np.bool_], H: float
) -> list[tuple[Floats, Floats]]:
    """Values (n,) and regressors (n, k) of zeta, epsilon, eta, (25) to (27)."""
    x_1, x_2 = symmetry_coordinates(mapped.motion.V_l[counted], mapped.motion.V_r[counted], H)
    force = mapped.magnitude[counted]
    ones, signed = np.ones_like(force), force * np.sign(x_1) * np.sign(x_2)
    regressors = [ones, force * np.sign(x_2)], [ones, signed], [ones, signed, force**2]
    return [
        (index[counted], np.stack(columns, axis=-1))
        for index, columns in zip(mapped.indices, regressors, strict=True)
    ]


def weighted_fit(columns: Floats, target: Floats, weight: Floats) -> Floats:
    """Weighted least squares: coefficients (k,) of columns (n, k) for a target (n,).

    Raises:
        SimulationError: too few unlike motions.
    """
    root = np.sqrt(weight)
    solution, _, rank, _ = np.linalg.lstsq(columns * root[:, None], target * root, rcond=None)
    if rank < columns.shape[1]:
        raise SimulationError(f"{len(target)} motions do not show all parameters of an index")
    return np.asarray(solution, dtype=float)


def velocity_errors(
    mapped: DynamicMap, parameters: Indices, icrs: ConstantIcr, inertia: Inertia = "measured"
) -> VelocityErrors:
    """Velocity errors (RMSE) of both models over all motions of a map, as Table II.

    The inertia-based model has the `parameters`, the model of constant ICRs the `icrs`.
    """
    true = mapped.motion.twist
    by_inertia = inertia_based_twist(mapped, parameters, inertia)
    return VelocityErrors(rmse(by_inertia, true), rmse(constant_twist(mapped, icrs), true))
