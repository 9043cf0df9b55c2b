"""The dynamic map, and fits on motions that are known."""

import numpy as np
import pytest

from icreckon import SimulationError, Soil
from icreckon.estimator.motion.icr import PaperTwist
from icreckon.estimator.motion.index_model import VehicleConstants
from icreckon.simulation.contact.contact import Body, Contact, equally_spaced
from icreckon.simulation.contact.steady_state import SteadyMotion, solve_steady, track_speed_grid
from icreckon.simulation.paper.dynamic_map import DynamicMap, map_of, on_spot_line
from icreckon.simulation.paper.fits import fitted_parameters, mean_icrs, weighted_fit

AURIGA = Contact(
    Soil(friction=0.9, rolling_resistance=0.074),
    equally_spaced(0.42, half_length=0.39, count=5),
    Body(258.0, -0.015, 0.04, 0.79),
)
VEHICLE = VehicleConstants(0.42, 258.0, -0.015, 0.04)


@pytest.fixture(scope="module")
def mapped() -> DynamicMap:
    return map_of(solve_steady(*track_speed_grid(), AURIGA), VEHICLE)


def test_the_line_of_least_inertia_goes_through_on_spot_turns(mapped):
    H = on_spot_line(mapped)
    V_r = np.array([-0.9, -0.4, 0.3, 1.0])
    on, off = (solve_steady(-ratio * V_r, V_r, AURIGA).twist for ratio in (H, H + 0.1))
    forward_on, forward_off = (np.abs(t.v_y + VEHICLE.x_CM * t.w) for t in (on, off))
    assert (forward_on < 0.25 * forward_off).all()


def fit(motion: SteadyMotion) -> None:
    mapped = map_of(motion, VEHICLE)
    mean_icrs(mapped)
    fitted_parameters(mapped)


def made(turn: float) -> SteadyMotion:
    """Motions that turn in proportion to the difference of the tracks, instead of by friction."""
    V_l, V_r = track_speed_grid()
    twist = PaperTwist(0.0 * V_l, 0.5 * (V_l + V_r), turn * (V_r - V_l))
    zero = np.zeros_like(V_l)
    return SteadyMotion(V_l, V_r, twist, zero, zero == 0.0, zero != 0.0)


def forward_only() -> SteadyMotion:
    return solve_steady(*np.meshgrid([0.5, 0.6], [0.3, 0.9], indexing="ij"), AURIGA)


@pytest.mark.parametrize(
    ("fits", "message"),
    [
        (lambda: fit(made(0.0)), "none of the motions turns"),
        (
            lambda: weighted_fit(np.ones((9, 2)), np.ones(9), np.ones(9)),
            "do not show all parameters",
        ),
        (lambda: fit(solve_steady([0.5, 0.6], [0.3, 0.9], AURIGA)), "needs a grid"),
        (lambda: fit(forward_only()), "no on-spot turning"),
        (lambda: fit(made(5.0)), "eta0"),
        (lambda: fit(made(-2.0)), "mean ICRs"),
    ],
)
def test_what_cannot_be_derived_is_said(fits, message):
    with pytest.raises(SimulationError, match=message):
        fits()
