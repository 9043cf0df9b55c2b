"""Readings of ambiguous parts of the paper: means, fits, and Table II's force.

The paper averages each ICR distribution and fits the indices by least squares; the weights of turning
motions are not stated. Each reading gives the same ten numbers and two motion models. That which comes
closest to the printed numbers is in `icreckon.simulation.paper.fits`.
"""

from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
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
from icreckon.simulation.paper.fits import index_columns, weighted_fit
from icreckon.simulation.paper.reproduction import numbers

Means = Literal["plain", "median", "velocity"]
Fit = Literal["plain", "velocity", "absolute"]

# Reweighted least squares towards least absolute deviations: rounds, and the deviation at which the
# weight is capped, as a share of the largest initial one.
REWEIGHTINGS = 30
SMALLEST_DEVIATION = 1e-3


class Reading(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Method that derives the numbers of the paper from the stationary motions."""

    # constant ICRs as the "plain" mean of each distribution, as its "median", or such that they fit the
    # "velocity" best (each motion weighs w²)
    means: Means = "plain"
    # index parameters by "plain" least squares on the indices, on the "velocity" that they imply (each
    # motion weighs w²), or by least "absolute" deviations of the indices
    fit: Fit = "plain"
    # force input of Table II's inertia-based model: "measured", that of the stationary motion, or that
    # of the model itself in the "literal" or "smooth" form
    inertia: Inertia = "measured"
    largest_inertia: float | None = None  # of motions in means and fits [N]; None for all
    least_difference: float = 0.0  # of the track speeds of motions in means and fits [m/s]
    straight: bool = True  # True if Table II counts straight motions, which both models follow


def read_means(mapped: DynamicMap, reading: Reading) -> ConstantIcr:
    """Constant ICRs of a map [m] (section II).

    Raises:
        SimulationError: nothing turns, or no skid-steer vehicle has such means.
    """
    chosen = chosen_motions(mapped, reading)
    coordinates = [coordinate[chosen] for coordinate in mapped.icrs]
    if reading.means == "plain":
        means = [float(np.mean(values)) for values in coordinates]
    elif reading.means == "median":
        means = np.median(coordinates, axis=1).tolist()
    else:
        weights = mapped.motion.twist.w[chosen] ** 2
        means = np.average(coordinates, axis=1, weights=weights).tolist()
    try:
        return ConstantIcr(*means)
    except ValueError as error:
        raise SimulationError(f"the mean ICRs make no sense: {error}") from error


def read_parameters(mapped: DynamicMap, reading: Reading, H: float | None = None) -> Indices:
    """Eight index parameters of a map over a grid: H, and the fits of (25) to (27).

    H, the ratio of track speeds of on-spot turning, is from `on_spot_line` by default.

    Raises:
        SimulationError: too few motions, or no skid-steer vehicle has the fitted parameters.
    """
    chosen = chosen_motions(mapped, reading)
    H = on_spot_line(mapped) if H is None else H
    w = mapped.motion.twist.w[chosen]
    weight = w**2 if reading.fit == "velocity" else np.ones_like(w)
    fit = _absolute if reading.fit == "absolute" else weighted_fit
    values = [H]
    for target, columns in index_columns(mapped, chosen, H):
        values += fit(columns, target, weight).tolist()
    try:
        return Indices(*values)
    except ValueError as error:
        raise SimulationError(f"the fitted parameters make no sense: {error}") from error


def read_errors(
    mapped: DynamicMap, parameters: Indices, icrs: ConstantIcr, reading: Reading
) -> VelocityErrors:
    """Velocity errors (RMSE) of both models over the motions of a map, as Table II.

    The inertia-based model has the `parameters`, the model of constant ICRs the `icrs`.
    """
    # Index of the motions that count: all (...), or a mask of the turning ones.
    counted = ... if reading.straight else mapped.turning
    true = mapped.motion.twist
    by_inertia = inertia_based_twist(mapped, parameters, reading.inertia)
    by_constant = constant_twist(mapped, icrs)
    return VelocityErrors(rmse(by_inertia, true, counted), rmse(by_constant, true, counted))


def read_numbers(mapped: DynamicMap, reading: Reading) -> dict[str, float]:
    """Numbers of the paper by a reading, as of `icreckon.simulation.paper.reproduction.numbers`.

    Raises:
        SimulationError: the map gives no valid ICRs or parameters.
    """
    icrs, parameters = read_means(mapped, reading), read_parameters(mapped, reading)
    errors = read_errors(mapped, parameters, icrs, reading)
    return numbers(mapped, icrs, parameters, errors)


def chosen_motions(mapped: DynamicMap, reading: Reading) -> NDArray[np.bool_]:
    """Mask of the motions in means and fits; a SimulationError if there are none."""
    difference = np.abs(mapped.motion.V_l - mapped.motion.V_r)
    chosen = mapped.turning & (difference >= reading.least_difference)
    if reading.largest_inertia is not None:
        chosen &= mapped.magnitude <= reading.largest_inertia
    if not chosen.any():
        raise SimulationError("none of the motions turns: there are no ICRs to average or fit")
    return chosen


def _absolute(columns: Floats, target: Floats, weight: Floats) -> Floats:
    """Fit by least absolute deviations; only the first guess uses `weight`."""
    solution = weighted_fit(columns, target, weight)
    largest = float(np.abs(target - columns @ solution).max())
    least = SMALLEST_DEVIATION * largest + 1e-300  # not zero, where the first guess is exact
    for _ in range(REWEIGHTINGS):
        deviation = np.abs(target - columns @ solution)
        solution = weighted_fit(columns, target, 1.0 / np.maximum(deviation, least))
    return solution
