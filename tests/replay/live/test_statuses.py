"""Statuses of /diagnostics."""

from __future__ import annotations

import pytest

from icreckon.estimator.filter.fault_table import Finding
from icreckon.estimator.filter.health import SensorHealth
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.base.diagnostic_status import OK, STALE, WARN
from icreckon.replay.live.odometry import LiveOdometry
from icreckon.replay.live.statuses import (
    Counts,
    LiveStatuses,
    findings_status,
    named_wheels,
    sensor_status,
)

LEFT = Finding(
    "tracks", "left wheel 2", "wheel off", 5, 0.8, "the left wheel 2 is 0.80 m/s off", "out"
)
SLIDE = Finding("robot", "", "sliding", 7, -1.2, "the robot is 1.20 m/s slower", "grows")


def test_faults_are_sentences_with_values() -> None:
    status = findings_status([LEFT, SLIDE], {"wheel off": 3, "sliding": 1}, 1.5)
    assert status.level == WARN
    assert status.message == "the left wheel 2 is 0.80 m/s off; the robot is 1.20 m/s slower"
    assert status.values["wheel off: times"] == "3"
    assert status.values["left wheel 2: wheel off: since_ns"] == "5"
    assert status.values["robot: sliding: size"] == "-1.200"
    assert status.values["robot: sliding: effect"] == "grows"


def test_without_a_fault_all_is_well() -> None:
    status = findings_status([], {"sliding": 2}, 1.0)
    assert (status.level, status.message) == (OK, "none")
    assert status.values == {"sliding: times": "2", "slip_factor": "1.00"}


def test_a_wheel_has_the_name_of_its_joint() -> None:
    named = named_wheels(LEFT, ["front_left", "rear_left"], ["front_right", "rear_right"])
    assert named.text == "the left wheel 2 (rear_left) is 0.80 m/s off"
    assert named_wheels(SLIDE, ["front_left"], ["front_right"]) == SLIDE


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
