"""Remarks on robot files that leave out what friction needs."""

import pytest

from icreckon.estimator.robot.robot_file import Robot, changed_robot, load_robot, make_robot
from icreckon.simulation.contact.of_robot import robot_remarks

MINE = make_robot(
    "mine",
    vehicle={"mass": 60.0, "track_gauge": 0.5, "sprocket_radius": 0.1, "half_contact_length": 0.3},
)


def test_a_file_with_what_is_required_only() -> None:
    height, track = robot_remarks(MINE, "friction")
    assert "the third number of centre_of_mass" in height
    assert "effective track of 1.5" in track
    assert "its file states 1.00" in track


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"vehicle.centre_of_mass": [0.0, 0.0, 0.3]}, ["eta0"]),
        ({"indices.eta0": 1.57}, ["centre of mass"]),
        ({"vehicle.centre_of_mass": [0.0, 0.0, 0.3], "indices.eta0": 1.57}, []),
    ],
)
def test_what_is_set_is_not_remarked_on(changes: dict[str, object], words: list[str]) -> None:
    found = robot_remarks(changed_robot(MINE, changes), "friction")
    assert len(found) == len(words)
    assert all(word in text for word, text in zip(words, found, strict=True))


@pytest.mark.parametrize(
    ("robot", "truth"), [(MINE, "kinematic"), (load_robot("auriga-alpha"), "friction")]
)
def test_only_where_friction_moves_a_robot_whose_file_lacks_it(robot: Robot, truth: str) -> None:
    assert robot_remarks(robot, truth) == []


def test_the_value_that_is_proposed_leaves_no_remark() -> None:
    (_, track) = robot_remarks(MINE, "friction")
    proposed = float(track.partition("set eta0 = ")[2].split()[0])
    assert len(robot_remarks(changed_robot(MINE, {"indices.eta0": proposed}), "friction")) == 1
