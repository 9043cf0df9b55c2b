"""Pictures of the shipped robots: of today's robot files, with the ICRs of the model."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from robot_gallery import icrs_at, old_pictures, write_picture

from conftest import REPOSITORY
from icreckon.estimator.motion.index_model import solve
from icreckon.estimator.robot.robot_file import load_robot, robot_names

PAGE = REPOSITORY / "docs" / "reference" / "robots.md"


def test_each_shipped_robot_has_a_picture_of_its_file():
    assert old_pictures(PAGE.parent / "robots") == []
    text = PAGE.read_text(encoding="utf-8")
    assert [name for name in robot_names() if f"](robots/{name}.png)" not in text] == []


def test_another_robot_file_makes_a_picture_old(tmp_path: Path):
    robot = load_robot("husky")
    write_picture(tmp_path / "husky.png", robot)
    assert "husky" not in old_pictures(tmp_path)
    changed = replace(robot, indices=replace(robot.indices, zeta1=0.001))
    write_picture(tmp_path / "husky.png", changed)
    assert "husky" in old_pictures(tmp_path)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_icrs_are_those_of_the_steady_model(side: float):
    robot = load_robot("warthog")
    left, right = 1.0 - 0.4 * side, 1.0 + 0.4 * side
    found = solve(left, right, robot.indices.as_array(), robot.constants)
    twist = found.twist
    shown = icrs_at(robot, np.array([twist.v_y * twist.w]))[:, 0]
    expected = ((left - twist.v_y) / twist.w, (right - twist.v_y) / twist.w, twist.v_x / twist.w)
    assert shown == pytest.approx(expected, abs=1e-3)
