"""Inputs that do not come are named, with what there is instead."""

from __future__ import annotations

from bag_messages import SECOND, joints, robot_with
from icreckon.replay.live.inputs import LiveInputs
from icreckon.replay.live.silence import MOST_NAMES, missing_joints, silent_topic
from icreckon.replay.mapping.topics import topic_map

JOINTS, IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"


def test_a_topic_that_nobody_publishes_comes_with_those_that_fit() -> None:
    there = {"/imu": [IMU], "/wheel/joint_states": [JOINTS], "/a/joints": [JOINTS]}
    text = silent_topic("tracks", "/joint_states", [JOINTS], there, 5.2)
    assert text == (
        "tracks: nobody has published /joint_states for 5 s; of a fitting type there is /a/joints, "
        "/wheel/joint_states; name the topic in [log.tracks] of the robot file"
    )
    text = silent_topic("tracks", "/joint_states", [JOINTS], {"/imu": [IMU]}, 5.2)
    assert f"; there is none of type {JOINTS}; name" in text
    assert "for 5 s; name the topic" in silent_topic("imu", "/imu", [], {}, 5.0)
    many = {f"/{k}": [JOINTS] for k in range(MOST_NAMES + 3)}
    assert "/5, /6 and 3 more" in silent_topic("tracks", "/joint_states", [JOINTS], many, 5.0)


def test_a_topic_that_is_silent_is_another_matter() -> None:
    text = silent_topic("imu", "/imu", [IMU], {"/imu": [IMU]}, 5.0)
    assert text.startswith("imu: /imu has a publisher, and no message has come for 5 s")
    assert "best_effort" in text


def test_a_misspelt_joint_comes_with_the_nearest() -> None:
    seen = {"front_left_wheel", "front_right_wheel"}
    assert missing_joints("/js", ["front_left_wheel"], seen) == ""
    assert missing_joints("/js", ["front_lef_wheel"], seen) == (
        "joint 'front_lef_wheel' of [log.tracks] has not come on /js; did you mean 'front_left_wheel'?"
    )


def test_several_missing_joints_are_one_warning() -> None:
    seen = {"front_left_wheel", "front_right_wheel"}
    assert missing_joints("/js", ["l", "front_left_wheel", "r"], seen) == (
        "joints 'l', 'r' of [log.tracks] have not come on /js, which has 'front_left_wheel', "
        "'front_right_wheel'"
    )


def test_joints_are_missing_only_after_a_while() -> None:
    robot = robot_with(tracks={"topic": "/js", "left": ["l"], "right": ["rigth"]})
    inputs = LiveInputs(robot, topic_map(robot, "robot"))
    (tracks,) = inputs.subscriptions()
    assert inputs.missing_joints(0) == ""
    for k in range(5):
        inputs.take(tracks, JOINTS, joints(k * SECOND, (1.0, 1.0), ("l", "right")), k * SECOND)
    assert inputs.heard == {"/js": 0}
    assert inputs.missing_joints(SECOND) == ""
    assert inputs.missing_joints(4 * SECOND).endswith("did you mean 'right'?")


def test_joints_in_messages_of_their_own_are_there_once_each_has_come() -> None:
    robot = robot_with(tracks={"topic": "/js", "left": ["l"], "right": ["r"]})
    inputs = LiveInputs(robot, topic_map(robot, "robot"))
    (tracks,) = inputs.subscriptions()
    for name in ("l", "r"):
        inputs.take(tracks, JOINTS, joints(SECOND, (1.0,), (name,)), SECOND)
    assert inputs.missing_joints(9 * SECOND) == ""


def test_the_types_that_fit_are_those_that_need_no_names_of_fields() -> None:
    robot = robot_with(
        tracks={"topic": "/js", "left": ["l"], "right": ["r"]}, imu={"topic": "/imu"}
    )
    inputs = LiveInputs(robot, topic_map(robot, "robot"))
    tracks, imu = inputs.subscriptions()
    assert JOINTS in inputs.fitting_types(tracks)
    assert inputs.fitting_types(imu) == (IMU,)
