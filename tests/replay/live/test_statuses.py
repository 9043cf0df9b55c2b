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
from icreckon.replay.live.statuses import (
    Counts,
    LiveStatuses,
    gyro_status,
    sensor_status,
    slip_status,
)


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
    used = (100, 130, 4)
    found = [statuses._new("gyro", SensorHealth(used=one)) for one in used]
    assert found == [Counts(100, 0), Counts(30, 0), Counts(4, 0)]
    rejected = SensorHealth(used=5, rejected={"gate": 3})
    assert statuses._new("gyro", rejected) == Counts(1, 3)


@pytest.mark.parametrize(
    ("new", "level", "text"),
    [
        (Counts(30, 0), OK, "30 used since the last report"),
        (Counts(91, 9), OK, "91 used since the last report"),
        (Counts(50, 50), WARN, "50% rejected: gate"),
        (Counts(0, 0), STALE, "nothing since the last report"),
    ],
)
def test_a_sensor_has_a_status_by_its_new_counts(new: Counts, level: int, text: str) -> None:
    status = sensor_status("gyro", SensorHealth(used=100, rejected={"gate": 50}), new)
    assert (status.level, status.message) == (level, text)


def test_a_slide_has_its_values() -> None:
    values = slip_status(SlipHealth(forward=Slide(7, -1.2), slides=1)).values
    assert (values["forward_since_ns"], values["forward_m_s"]) == ("7", "-1.200")


def test_wheels_have_theirs() -> None:
    values = slip_status(SlipHealth(left_wheels=OddWheel(5, 1, 0.8, 9), odd_wheels=3)).values
    found = values["left_wheels_since_ns"], values["left_wheels_samples"], values["odd_wheels"]
    assert found == ("5", "9", "3")


def test_messages_that_cannot_be_used_are_reported_once() -> None:
    statuses = LiveStatuses(live := LiveOdometry(load_robot("auriga-alpha"), "gyro"))
    assert statuses._messages().level == OK
    live.inputs.lost["fixes: receiver without a fix"] = 3
    status = statuses._messages()
    assert status.level == WARN
    assert "fixes: receiver without a fix (3)" in status.message
    live.inputs.lost["tracks: cannot be read"] = 1
    assert "fixes" not in statuses._messages().message
    assert statuses._messages().level == OK


def test_a_silent_gyro_does_not_work() -> None:
    assert gyro_status(GyroHealth(), is_silent=True).level == STALE
    assert gyro_status(GyroHealth()).message == "it works"
