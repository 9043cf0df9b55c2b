"""Published and reproduced numbers of the paper.

Also Table II of the published parameters themselves, and a check that shows that two of the published
numbers contradict each other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import PaperTwist, symmetry_coordinates
from icreckon.estimator.motion.index_model import solve
from icreckon.estimator.robot.robot_file import ConstantIcr, Indices
from icreckon.estimator.robot.soil import Soil
from icreckon.simulation.contact.contact import Body, Contact, equally_spaced
from icreckon.simulation.contact.steady_state import SteadyMotion, solve_steady, track_speed_grid
from icreckon.simulation.paper.dynamic_map import DynamicMap, Inertia, VelocityErrors, map_of
from icreckon.simulation.paper.fits import fitted_parameters, mean_icrs, velocity_errors
from icreckon.simulation.paper.published import (
    AURIGA_ALPHA,
    PUBLISHED,
    READ_OFF,
    PublishedNumber,
    published_mean_icrs,
    published_parameters,
)

INERTIAS: tuple[Inertia, ...] = ("measured", "literal", "smooth")
# Contact that comes closest to the printed numbers, by `examples/paper`: the paper states none.
CONTACT = Contact(
    Soil(friction=0.921977, rolling_resistance=0.0538813),
    equally_spaced(AURIGA_ALPHA.gauge, half_length=0.40016, count=5),
    Body(AURIGA_ALPHA.mass, AURIGA_ALPHA.x_CM, AURIGA_ALPHA.y_CM, z_CM=0.753865),
)


class Row(PublishedNumber, frozen=True, kw_only=True):
    """Published number and its reproduction."""

    published: float  # the number as printed [unit]
    reproduced: float  # the reproduced number [unit]
    difference_percent: float  # reproduced less published, as a share of the published size [%]
    rounds_to_published: bool  # True if the reproduced number rounds to the published digits


@dataclass(frozen=True)
class Reproduction:
    """Reproduction of the paper: a map and the numbers derived from it."""

    mapped: DynamicMap  # the stationary motions
    icrs: ConstantIcr  # constant ICRs
    parameters: Indices  # the eight index parameters
    errors: VelocityErrors  # Table II with these ICRs and parameters
    rows: tuple[Row, ...]  # all published numbers, the one read off a figure last


class InterceptCheck(NamedTuple):
    """Check of whether published means and fits can come from the same motions.

    By least squares with an intercept, the mean of an index equals the fit at the mean of its
    regressors. With s|F| for |F| sign(x_1) sign(x_2):
    """

    needed: float  # mean of s|F| at which the published fit (26) gives it [N]
    # range of `needed` over all values that round to the published digits [N]
    needed_range: tuple[float, float]
    of_published_model: float  # mean of s|F| by the published parameters [N]
    of_map: float  # mean of s|F| of the reproduced motions [N]


def paper_map(contact: Contact = CONTACT, *, count: int = 21) -> DynamicMap:
    """Stationary motions of Auriga-alpha over the paper's grid, by default 21 x 21.

    Raises:
        SimulationError: pairs without a stationary motion.
    """
    V_l, V_r = track_speed_grid(count)
    return map_of(solve_steady(V_l, V_r, contact), AURIGA_ALPHA)


def reproduce() -> Reproduction:
    """Reproduce all published numbers."""
    mapped = paper_map()
    icrs, parameters = mean_icrs(mapped), fitted_parameters(mapped)
    errors = velocity_errors(mapped, parameters, icrs)
    rows = published_rows(numbers(mapped, icrs, parameters, errors))
    return Reproduction(mapped, icrs, parameters, errors, rows)


def numbers(
    mapped: DynamicMap, icrs: ConstantIcr, parameters: Indices, errors: VelocityErrors
) -> dict[str, float]:
    """Reproduced numbers by the names of the published ones, in their units."""
    values = {f"mean_{name}": value for name, value in msgspec.structs.asdict(icrs).items()}
    values |= msgspec.structs.asdict(parameters)
    for model, rmse in (("inertia", errors.inertia_based), ("constant", errors.constant)):
        values |= {f"rmse_{model}_{axis}": value for axis, value in rmse._asdict().items()}
    values["largest_eta"] = float(np.nanmax(mapped.indices.eta))
    return values


def published_rows(values: Mapping[str, float]) -> tuple[Row, ...]:
    """Published numbers with their reproduction, as of `numbers`."""
    return tuple(
        Row(
            **msgspec.structs.asdict(number),
            published=number.value,
            reproduced=values[number.name],
            difference_percent=100.0 * (values[number.name] - number.value) / abs(number.value),
            rounds_to_published=number.rounds_from(values[number.name]),
        )
        for number in (*PUBLISHED, *READ_OFF)
    )


def within(rows: Sequence[Row], percent: float) -> int:
    """Number of rows that differ by at most `percent` [%]."""
    return sum(abs(row.difference_percent) <= percent for row in rows)


def table_2_with_published_parameters(mapped: DynamicMap) -> dict[Inertia, VelocityErrors]:
    """Table II of a map with the paper's numbers instead of fits, by `INERTIAS`."""
    parameters, icrs = published_parameters(), published_mean_icrs()
    return {inertia: velocity_errors(mapped, parameters, icrs, inertia) for inertia in INERTIAS}


def map_of_published_model() -> DynamicMap:
    """Motions implied by the published parameters, with |F| from the model itself."""
    V_l, V_r = track_speed_grid()
    parameters = published_parameters().as_array()
    twist = solve(V_l, V_r, parameters, AURIGA_ALPHA, form="literal").twist
    residual = np.zeros_like(V_l)
    is_solved, tips = np.ones(V_l.shape, bool), np.zeros(V_l.shape, bool)
    motion = SteadyMotion(V_l, V_r, PaperTwist(*twist), residual, is_solved, tips)
    return map_of(motion, AURIGA_ALPHA)


def check_intercepts(mapped: DynamicMap) -> InterceptCheck:
    """Check whether published means and fits can come from the (reproduced) motions."""
    icrs, fitted = published_mean_icrs(), published_parameters()
    mean_epsilon = 0.5 * (icrs.x_ICRl + icrs.x_ICRr)
    # Half a unit of the last published digit, of either mean ICR (so of their mean) and of the fit.
    corners = [
        (mean_epsilon + mean - fitted.epsilon0 - offset) / (fitted.epsilon1 + gain)
        for mean in (-5e-4, 5e-4)
        for offset in (-5e-4, 5e-4)
        for gain in (-5e-5, 5e-5)
    ]
    return InterceptCheck(
        needed=(mean_epsilon - fitted.epsilon0) / fitted.epsilon1,
        needed_range=(min(corners), max(corners)),
        of_published_model=float(_signed_inertia(map_of_published_model()).mean()),
        of_map=float(_signed_inertia(mapped).mean()),
    )


def _signed_inertia(mapped: DynamicMap) -> Floats:
    """|F| sign(x_1) sign(x_2) of all turning motions, with the published H [N]."""
    turning, motion = mapped.turning, mapped.motion
    H = published_parameters().H
    x_1, x_2 = symmetry_coordinates(motion.V_l[turning], motion.V_r[turning], H)
    return np.asarray(mapped.magnitude[turning] * np.sign(x_1) * np.sign(x_2))
