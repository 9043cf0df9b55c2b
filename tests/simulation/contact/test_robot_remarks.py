"""Remarks on robot files that leave out what friction needs."""

import pytest

from icreckon.estimator.robot.robot_file import Robot, changed_robot, load_robot, make_robot
from icreckon.simulation.contact.of_robot import robot_remarks

MINE = make_robot(
    "mine",
    vehicle={"mass": 60.0, "track_gauge": 0.5, "sprocket_radius": 0.1, "half_contact_length": 0.3},
)
HIGH = changed_robot(MINE, {"vehicle.centre_of_mass": [0.0, 0.0, 0.3]})
WIDE = {"indices.eta0": 1.57}
HEIGHT, ETA0 = "the third number of centre_of_mass", "set eta0 = "


@pytest.mark.parametrize(
    ("robot", "truth", "remarks"),
    [
        (MINE, "friction", [HEIGHT, ETA0]),
        (HIGH, "friction", [ETA0]),
        (changed_robot(MINE, WIDE), "friction", [HEIGHT]),
        (changed_robot(HIGH, WIDE), "friction", []),
        (load_robot("auriga-alpha"), "friction", []),
        (MINE, "kinematic", []),
    ],
)
def test_what_friction_needs_and_a_file_lacks_is_remarked_on(
    robot: Robot, truth: str, remarks: list[str]
) -> None:
    found = robot_remarks(robot, truth)
    assert len(found) == len(remarks)
    assert all(remark in text for remark, text in zip(remarks, found, strict=True))


def test_the_value_that_is_proposed_leaves_no_remark() -> None:
    (_, track) = robot_remarks(MINE, "friction")
    assert "effective track of 1.5" in track
    assert "its file states 1.00" in track
    proposed = float(track.partition(ETA0)[2].split()[0])
    assert len(robot_remarks(changed_robot(MINE, {"indices.eta0": proposed}), "friction")) == 1
