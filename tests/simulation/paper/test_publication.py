"""The published numbers: values, digits, and what rounds to them."""

import math

import pytest

from icreckon.estimator.robot.robot_file import load_robot
from icreckon.simulation.paper.published import (
    AURIGA_ALPHA,
    published,
    published_mean_icrs,
    published_parameters,
)


def test_they_are_those_of_the_robot_file() -> None:
    robot = load_robot("auriga-alpha")
    assert published_parameters() == robot.indices
    assert published_mean_icrs() == robot.constant_icr
    x_CM, y_CM = robot.centre_of_mass_paper
    vehicle = robot.vehicle
    table_1 = (vehicle.track_gauge, vehicle.mass, x_CM, y_CM)
    assert tuple(AURIGA_ALPHA)[:4] == pytest.approx(table_1)


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("mean_x_ICRl", (-0.4584, -0.4576, -0.458, -0.4585), (-0.4586, -0.4574, 0.458)),
        ("mean_x_ICRr", (0.6304, 0.6296), (0.6306, 0.6294, math.nan)),
        ("eta2", (0.5e-5, 1.4e-5), (0.4e-5, 1.6e-5, math.inf)),
        ("zeta0", (0.0475, 0.0484), (0.0486, 0.04749)),
    ],
)
def test_what_rounds_to_the_published_digits(name, inside, outside):
    assert all(published(name).rounds_from(value) for value in inside)
    assert not any(published(name).rounds_from(value) for value in outside)
