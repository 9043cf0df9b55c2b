"""Statuses of /diagnostics."""

from __future__ import annotations

import pytest

from icreckon.estimator.filter.health import (
    GyroHealth,
    OddWheel,
    SensorHealth,
    Slide,
    SlipHealth,
)
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.base.diagnostic_status import OK, STALE, WARN
from icreckon.replay.live.odometry import LiveOdometry
from icreckon.replay.live.statuses import LiveStatuses, gyro_status, slip_status


@pytest.mark.parametrize(
    ("slip", "level", "text"),
    [
        (SlipHealth(times=2, slides=1), OK, "no track spins"),
        (
            SlipHealth("left", 5, 0.8, 1),
            WARN,
            "the left track spins, or its sensor fails: 0.80 m/s too much",
        ),
        (
            SlipHealth("unknown", 5, 0.8, 1, Slide(7, -1.2)),
            WARN,
            "one track spins, or its sensor fails: 0.80 m/s too much; "
            "the robot is 1.20 m/s slower than its tracks",
        ),
        (
            SlipHealth(forward=Slide(7, 0.9), slides=1),
            WARN,
            "the robot is 0.90 m/s faster than its tracks",
        ),
        (SlipHealth(sideways=Slide(7, 0.9)), WARN, "the robot slides to the left at 0.90 m/s"),
        (SlipHealth(sideways=Slide(7, -0.9)), WARN, "the robot slides to the right at 0.90 m/s"),
        (
            SlipHealth(left_wheels=OddWheel(5, 1, 0.8, 9), odd_wheels=1),
            WARN,
            "rear_left of the left side is 0.80 m/s off and is not used",
        ),
        (
            SlipHealth(right_wheels=OddWheel(5, None, 0.4, 9), odd_wheels=1),
            WARN,
            "the right wheels are 0.80 m/s apart, which is right is not clear",
        ),
    ],
)
def test_slip_is_a_sentence(slip: SlipHealth, level: int, text: str) -> None:
    status = slip_status(slip, ["front_left", "rear_left"], ["front_right", "rear_right"])
    assert (status.level, status.message) == (level, text)
    assert status.values["slides"] == str(slip.slides)


def test_counts_that_begin_anew_are_no_negative_ones() -> None:
    statuses = LiveStatuses(LiveOdometry(load_robot("auriga-alpha"), "gyro"))
    assert statuses._sensor("gyro", SensorHealth(used=100)).message.startswith("100 used")
    assert statuses._sensor("gyro", SensorHealth(used=130)).message.startswith("30 used")
    assert statuses._sensor("gyro", SensorHealth(used=4)).message.startswith("4 used")
    rejected = SensorHealth(used=5, rejected={"gate": 3})
    assert statuses._sensor("gyro", rejected).level == WARN


def test_a_slide_has_its_values() -> None:
    values = slip_status(SlipHealth(forward=Slide(7, -1.2), slides=1)).values
    assert (values["forward_since_ns"], values["forward_m_s"]) == ("7", "-1.200")


def test_wheels_have_theirs() -> None:
    values = slip_status(SlipHealth(left_wheels=OddWheel(5, 1, 0.8, 9), odd_wheels=3)).values
    found = values["left_wheels_since_ns"], values["left_wheels_samples"], values["odd_wheels"]
    assert found == ("5", "9", "3")


def test_rejections_of_the_stream_do_not_make_a_working_imu_stale() -> None:
    statuses = LiveStatuses(LiveOdometry(load_robot("auriga-alpha"), "gyro"))
    one = SensorHealth(used=0, rejected={"duplicate stamp": 1})
    assert statuses._sensor("imu", one, 100).level == OK
    again = statuses._sensor("imu", one, 100)
    assert (again.level, again.message) == (OK, "100 used since the last report")
    assert statuses._sensor("imu", one, 0).level == STALE
    many = SensorHealth(used=0, rejected={"duplicate stamp": 51})
    assert statuses._sensor("imu", many, 50).message.startswith("50% rejected")


def test_a_silent_gyro_does_not_work() -> None:
    assert gyro_status(GyroHealth(), is_silent=True).level == STALE
    assert gyro_status(GyroHealth()).message == "it works"
