"""The dynamic map: figures of the design's identification, and fits on motions that are known."""

import numpy as np
import pytest

from icreckon import SimulationError, Soil
from icreckon.estimator.motion.icr import PaperTwist
from icreckon.estimator.motion.index_model import VehicleConstants
from icreckon.simulation.contact.contact import Body, Contact, equally_spaced
from icreckon.simulation.contact.steady_state import SteadyMotion, solve_steady, track_speed_grid
from icreckon.simulation.paper.dynamic_map import DynamicMap, map_of, on_spot_line
from icreckon.simulation.paper.readings import Reading, read_errors, read_means, read_parameters

AURIGA = Contact(
    Soil(friction=0.9, rolling_resistance=0.074),
    equally_spaced(0.42, half_length=0.39, count=5),
    Body(258.0, -0.015, 0.04, 0.79),
)
PLAIN = Reading()
VEHICLE = VehicleConstants(0.42, 258.0, -0.015, 0.04)


@pytest.fixture(scope="module")
def mapped() -> DynamicMap:
    return map_of(solve_steady(*track_speed_grid(), AURIGA), VEHICLE)


def test_figures_of_the_identified_soil(mapped):
    # The identification's friction and height are known to two digits: half a unit of the last one
    # moves eta2 by 3 %, epsilon1 and eta1 by 2 %, the others by less than 1 %.
    icrs, fitted = read_means(mapped, PLAIN), read_parameters(mapped, PLAIN)
    means = icrs.x_ICRl, icrs.x_ICRr, icrs.y_ICR
    assert means == pytest.approx((-0.455, 0.657, 0.0481), rel=5e-3)
    found = fitted.zeta0, fitted.zeta1, fitted.epsilon0, fitted.eta0
    assert found == pytest.approx((0.0481, 2.39e-4, 0.086, 2.49), rel=5e-3)
    assert (fitted.epsilon1, fitted.eta1) == pytest.approx((8.5e-4, 1.77e-3), rel=0.025)
    assert fitted.eta2 == pytest.approx(2.4e-5, rel=0.05)
    errors = read_errors(mapped, fitted, icrs, PLAIN)
    assert errors.inertia_based == pytest.approx((0.0034, 0.046, 0.051), rel=0.02)
    assert errors.constant == pytest.approx((0.017, 0.077, 0.110), rel=0.02)


def test_the_line_of_least_inertia_goes_through_on_spot_turns(mapped):
    H = on_spot_line(mapped)
    V_r = np.array([-0.9, -0.4, 0.3, 1.0])
    on, off = (solve_steady(-ratio * V_r, V_r, AURIGA).twist for ratio in (H, H + 0.1))
    forward_on, forward_off = (np.abs(t.v_y + VEHICLE.x_CM * t.w) for t in (on, off))
    assert (forward_on < 0.25 * forward_off).all()


def read(motion: SteadyMotion, reading: Reading = PLAIN) -> None:
    made = map_of(motion, VEHICLE)
    read_means(made, reading)
    read_parameters(made, reading)


def made(turn: float) -> SteadyMotion:
    """Motions that turn in proportion to the difference of the tracks, instead of by friction."""
    V_l, V_r = track_speed_grid()
    twist = PaperTwist(0.0 * V_l, 0.5 * (V_l + V_r), turn * (V_r - V_l))
    zero = np.zeros_like(V_l)
    return SteadyMotion(V_l, V_r, twist, zero, zero == 0.0, zero != 0.0)


def forward_only() -> SteadyMotion:
    return solve_steady(*np.meshgrid([0.5, 0.6], [0.3, 0.9], indexing="ij"), AURIGA)


@pytest.mark.parametrize(
    ("reads", "message"),
    [
        (lambda: read(made(2.0), Reading(least_difference=3.0)), "none of the motions turns"),
        (lambda: read(made(2.0), Reading(least_difference=1.95)), "do not show all parameters"),
        (lambda: read(solve_steady([0.5, 0.6], [0.3, 0.9], AURIGA)), "needs a grid"),
        (lambda: read(forward_only()), "no on-spot turning"),
        (lambda: read(made(5.0)), "eta0"),
        (lambda: read(made(-2.0)), "mean ICRs"),
    ],
)
def test_what_cannot_be_derived_is_said(reads, message):
    with pytest.raises(SimulationError, match=message):
        reads()
