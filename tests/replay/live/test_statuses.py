"""Statuses of /diagnostics."""

from collections import Counter

import pytest

from bag_messages import JOINTS as TRACKS
from bag_messages import SECOND, joints, live_inputs
from icreckon import Finding, SensorHealth, load_robot
from icreckon.replay.live.diagnostic_status import OK, STALE, WARN
from icreckon.replay.live.odometry import LiveOdometry
from icreckon.replay.live.silence import MOST_NAMES, missing_joints, silent_topic
from icreckon.replay.live.statuses import Counts, LiveStatuses, findings_status, sensor_status

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


@pytest.mark.parametrize(
    ("new", "level", "text"),
    [
        (Counts(30, Counter()), OK, "30 used since the last report"),
        (Counts(91, Counter(gate=9)), OK, "91 used since the last report"),
        (Counts(50, Counter(gate=50)), WARN, "50% rejected: gate"),
        (Counts(0, Counter()), STALE, "nothing since the last report"),
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


JOINTS, IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"


def test_a_topic_that_nobody_publishes_comes_with_those_that_fit() -> None:
    there = {"/imu": [IMU], "/wheel/joint_states": [JOINTS], "/a/joints": [JOINTS]}
    text = silent_topic("tracks", "/joint_states", [JOINTS], there, 5.2)
    assert "nobody has published /joint_states for 5 s" in text
    assert "/a/joints, /wheel/joint_states; name the topic in [log.tracks]" in text
    text = silent_topic("tracks", "/joint_states", [JOINTS], {"/imu": [IMU]}, 5.2)
    assert f"; there is none of type {JOINTS}; name" in text
    assert "for 5 s; name the topic" in silent_topic("imu", "/imu", [], {}, 5.0)
    many = {f"/{k}": [JOINTS] for k in range(MOST_NAMES + 3)}
    assert "/5, /6 and 3 more" in silent_topic("tracks", "/joint_states", [JOINTS], many, 5.0)


def test_a_misspelt_joint_comes_with_the_nearest() -> None:
    seen = {"front_left_wheel", "front_right_wheel"}
    assert missing_joints("/js", ["front_left_wheel"], seen) == ""
    text = missing_joints("/js", ["front_lef_wheel"], seen)
    assert "'front_lef_wheel'" in text
    assert "did you mean 'front_left_wheel'?" in text


def test_joints_are_missing_only_after_a_while() -> None:
    inputs, topics = live_inputs(tracks={"topic": "/js", "left": ["l"], "right": ["rigth"]})
    assert inputs.missing_joints(0) == ""
    for k in range(5):
        message = joints(k * SECOND, (1.0, 1.0), ("l", "right"))
        inputs.take(topics["/js"], JOINTS, message, k * SECOND)
    assert inputs.heard == {"/js": 0}
    assert inputs.missing_joints(SECOND) == ""
    assert inputs.missing_joints(4 * SECOND).endswith("did you mean 'right'?")


def test_joints_in_messages_of_their_own_are_there_once_each_has_come() -> None:
    inputs, topics = live_inputs(tracks=TRACKS)
    for name in ("l", "r"):
        inputs.take(topics["/js"], JOINTS, joints(SECOND, (1.0,), (name,)), SECOND)
    assert inputs.missing_joints(9 * SECOND) == ""


def test_the_types_that_fit_are_those_that_need_no_names_of_fields() -> None:
    inputs, topics = live_inputs(tracks=TRACKS, imu={"topic": "/imu"})
    assert JOINTS in inputs.fitting_types(topics["/js"])
    assert inputs.fitting_types(topics["/imu"]) == (IMU,)
