"""The contact that the friction model starts from."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from icreckon.estimator.motion.contact import Soil
from icreckon.estimator.robot.nominal_contact import presumed_contact, slow_turns
from icreckon.estimator.robot.robot_file import ConstantIcr, load_robot


@pytest.mark.parametrize("name", ["warthog", "husky", "husky-deflated"])
def test_its_slow_turns_have_the_robots_constant_icrs(name: str) -> None:
    robot = load_robot(name)
    turns, known = slow_turns(presumed_contact(robot)), robot.constant_indices
    half_gauge = 0.5 * robot.vehicle.track_gauge
    assert half_gauge * float(np.mean(turns.eta)) == pytest.approx(
        half_gauge * known.eta0, abs=2e-3
    )
    assert float(np.mean(turns.epsilon)) == pytest.approx(known.epsilon0, abs=2e-3)
    assert float(np.mean(turns.zeta)) == pytest.approx(known.zeta0, abs=2e-3)


def test_a_contact_is_half_as_long_as_the_file_says_at_least() -> None:
    """Marmotte turns as if its contact were a few centimetres long, which is not Coulomb friction."""
    robot = load_robot("marmotte")
    length = presumed_contact(robot).geometry.positions[-1]
    assert length == pytest.approx(0.5 * robot.vehicle.half_contact_length, rel=1e-3)


def test_icrs_that_are_off_the_centre_move_the_centre_of_mass() -> None:
    robot = load_robot("warthog")
    gauge = robot.vehicle.track_gauge
    robot = msgspec.structs.replace(
        robot, constant_icr=ConstantIcr(-0.75 * gauge - 0.05, 0.75 * gauge - 0.05, 0.06)
    )
    body = presumed_contact(robot).body
    assert body.y_CM > 0.01
    turns = slow_turns(presumed_contact(robot))
    assert float(np.mean(turns.zeta)) == pytest.approx(0.06, abs=2e-3)
    assert float(np.mean(turns.eta)) == pytest.approx(1.5, abs=0.01)


def test_known_ground_and_unknown_icrs_leave_the_file_as_it_is() -> None:
    warthog = load_robot("warthog")
    known = msgspec.structs.replace(warthog, soil=Soil(friction=0.6))
    assert presumed_contact(known) == known.contact
    nothing = msgspec.structs.replace(
        warthog, indices=msgspec.structs.replace(warthog.indices, eta0=1.0), constant_icr=None
    )
    assert presumed_contact(nothing) == nothing.contact
