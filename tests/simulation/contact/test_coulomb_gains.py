"""Gains by Coulomb friction are those of the contact, and slow turns those of the robot's contact."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from scipy.optimize import root

from icreckon.estimator.motion.icr import GRAVITY, PaperTwist
from icreckon.estimator.robot.coulomb_gains import coulomb_gains
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.simulation.contact.contact import steady_balance
from icreckon.simulation.contact.of_robot import contact_of, slow_turns

ALPHA = load_robot("auriga-alpha")


def test_epsilon_F_is_what_the_contact_loses_uphill() -> None:
    """A robot without height or offsets, slowly turning uphill."""
    vehicle = msgspec.structs.replace(
        ALPHA.vehicle, centre_of_mass=(0.0, 0.0, 0.01), contact_points=40
    )
    soil = msgspec.structs.replace(ALPHA.soil, rolling_resistance=0.0)
    robot = msgspec.structs.replace(ALPHA, vehicle=vehicle, soil=soil)
    contact, (left, right) = contact_of(robot), (0.10, 0.18)
    twists = {}
    for gravity in (0.0, -0.5):

        def off(twist: np.ndarray, gravity: float = gravity) -> np.ndarray:
            found = steady_balance(PaperTwist(*twist), left, right, contact).values[:, 0]
            return np.asarray(found) + np.array([0.0, vehicle.mass * gravity, 0.0])

        found = root(off, [0.0, 0.14, 0.1], tol=1e-10)
        assert found.success
        twists[gravity] = PaperTwist(*found.x)
    level, uphill = twists[0.0], twists[-0.5]
    eta = (right - left) / (vehicle.track_gauge * level.w)
    indices = msgspec.structs.replace(robot.indices, eta0=float(eta))
    robot = msgspec.structs.replace(robot, indices=indices, constant_icr=None)
    lost = level.v_y - uphill.v_y
    assert lost == pytest.approx(level.w * coulomb_gains(robot)[1] * 0.5 / GRAVITY, rel=0.1)


def test_slow_turns_are_those_of_the_centre_of_mass() -> None:
    """Symmetric: no shift; forward: the robot turns about a point that is forward, too."""
    vehicle = msgspec.structs.replace(ALPHA.vehicle, centre_of_mass=(0.0, 0.0, 0.0))
    middle = slow_turns(contact_of(msgspec.structs.replace(ALPHA, vehicle=vehicle)))
    assert np.abs(np.mean(middle.zeta)) < 1e-3
    vehicle = msgspec.structs.replace(vehicle, centre_of_mass=(0.05, 0.0, 0.0))
    ahead = slow_turns(contact_of(msgspec.structs.replace(ALPHA, vehicle=vehicle)))
    assert np.mean(ahead.zeta) > 0.01
