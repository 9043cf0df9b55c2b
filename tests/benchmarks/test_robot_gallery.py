"""Pictures of the shipped robots: of today's robot files, with the ICRs of the model."""

import numpy as np
import pytest
from robot_gallery import icrs_at, old_pictures

from conftest import REPOSITORY
from icreckon.estimator.motion.index_model import solve
from icreckon.estimator.robot.robot_file import load_robot, robot_names

PAGE = REPOSITORY / "docs" / "reference" / "robots.md"


def test_each_shipped_robot_has_a_picture_of_its_file():
    assert old_pictures(PAGE.parent / "robots") == []
    text = PAGE.read_text(encoding="utf-8")
    assert [name for name in robot_names() if f"](robots/{name}.png)" not in text] == []


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_icrs_are_those_of_the_steady_model(side: float):
    robot = load_robot("warthog")
    left, right = 1.0 - 0.4 * side, 1.0 + 0.4 * side
    found = solve(left, right, robot.indices.as_array(), robot.constants)
    twist = found.twist
    shown = icrs_at(robot, np.array([twist.v_y * twist.w]))[:, 0]
    expected = ((left - twist.v_y) / twist.w, (right - twist.v_y) / twist.w, twist.v_x / twist.w)
    assert shown == pytest.approx(expected, abs=1e-3)
