"""The node over real ROS 2: what it publishes is the replay of what it heard."""

import csv
import shutil
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import succeeds
from conftest import simulated
from icreckon import load_robot, read_log, run
from icreckon.estimator.base.frames import compose
from ros2_processes import (
    INPUT_TYPES,
    INPUTS,
    LONGEST,
    OUTPUTS,
    ROBOT,
    VARIANT,
    node,
    odometry_heard,
    play,
    player,
    pose_of,
    recorded,
    recorded_node,
    stamp_of,
    until,
    until_heard,
    until_quiet,
)

pytestmark = pytest.mark.slow

SECONDS = 10.0
DEEP = 10_000
"""Length of the queues of inputs that holds a whole drive: a busy machine loses nothing of it."""
REORDER = SECONDS
"""The whole drive: a busy node takes the messages of one topic long after those of another [s]."""
PLANAR = np.ix_((0, 1, 5), (0, 1, 5))


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bag")
    return simulated(folder / "drive", SECONDS, trajectory="slalom", seed=5)


def statuses(message: Any) -> dict[str, dict[str, str]]:
    """Values by key, by name of the status."""
    return {
        status.name.removeprefix("icreckon: "): {pair.key: pair.value for pair in status.values}
        for status in message.status
    }


def same_pose(one: np.ndarray, other: np.ndarray) -> None:
    assert one[:2] == pytest.approx(other[:2], abs=1e-9)
    assert np.sin(0.5 * (one[2] - other[2])) == pytest.approx(0.0, abs=1e-9)


@pytest.fixture(scope="module")
def live(ros, bag, tmp_path_factory):
    """Messages of a live run with a cold start, its recorded bag, and its state file."""
    folder = tmp_path_factory.mktemp("live")
    state = folder / "state.json"
    options = {"reorder": REORDER, "state_file": state, "icr_markers": "true", "input_depth": DEEP}
    topics = OUTPUTS | INPUT_TYPES
    with recorded_node(ros, folder, topics=topics, **options) as (record, running):
        play(ros, bag, "--subscribers", 2)
        until_heard(record, folder / "out", bag)
    assert "Traceback" not in running.text()
    assert "cold start" in running.text()
    return recorded(folder / "out"), folder / "out", state


def test_no_message_is_lost(live: Any, bag: Path) -> None:
    messages, sent = live[0], recorded(bag)
    for topic in INPUTS:
        assert len(messages[topic]) == len(sent[topic])
    imu = [stamp_of(one.header) for one in sent["/imu/data_raw"]]
    odometry = [stamp_of(one.header) for one in messages["/odom"]]
    assert odometry == imu
    counts = statuses(messages["/diagnostics"][-1])["tracks"]
    assert int(counts["used"]) == len(sent["/joint_states"])
    assert counts["late"] == "0"


def test_odometry_is_a_run_without_fixes(live: Any, bag: Path) -> None:
    messages = live[0]
    robot = load_robot(ROBOT)
    alone = run(replace(read_log(bag, robot), fixes=None), robot, VARIANT)
    odometry = {stamp_of(one.header): one for one in messages["/odom"]}
    assert len(alone.stamps) > 450
    for k, stamp in enumerate(alone.stamps.tolist()):
        one, trajectory = odometry[stamp], alone.trajectory
        pose = pose_of(one.pose.pose.position, one.pose.pose.orientation)
        same_pose(pose, trajectory.poses[k])
        covariance = one.pose.covariance.reshape(6, 6)
        assert covariance[PLANAR] == pytest.approx(trajectory.pose_covariances[k], abs=1e-9)
        assert covariance[2, 2] == covariance[3, 3] == covariance[4, 4] == 1e6
        twist = one.twist.twist
        body = np.array([twist.linear.x, twist.linear.y, twist.angular.z])
        assert body == pytest.approx(trajectory.twists[k], abs=1e-9)
        covariance = one.twist.covariance.reshape(6, 6)
        assert covariance[PLANAR] == pytest.approx(trajectory.twist_covariances[k], abs=1e-9)
        assert (one.header.frame_id, one.child_frame_id) == ("odom", "base_link")


def test_the_pose_in_map_is_the_replay_of_the_recording(live: Any, tmp_path: Path) -> None:
    messages, recording, _ = live
    out = tmp_path / "replayed"
    words = ("--robot", ROBOT, "--variants", VARIANT, "--formats", "csv", "--out", out)
    succeeds("replay", recording, *words, cwd=tmp_path)
    in_map = {stamp_of(one.header): one.pose.pose for one in messages["/pose_in_map"]}
    first, compared = min(in_map), 0
    with (out / f"{VARIANT}.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if int(row["stamp_ns"]) >= first:
                live_pose = in_map[int(row["stamp_ns"])]
                replayed = np.array([float(row[name]) for name in ("x_m", "y_m", "yaw_rad")])
                same_pose(pose_of(live_pose.position, live_pose.orientation), replayed)
                compared += 1
    assert compared > 450


def test_transforms_make_one_tree(live: Any) -> None:
    messages = live[0]
    odometry = {stamp_of(one.header): one.pose.pose for one in messages["/odom"]}
    in_map = {stamp_of(one.header): one.pose.pose for one in messages["/pose_in_map"]}
    assert len(messages["/tf"]) == len(odometry)
    joined = 0
    for message in messages["/tf"]:
        links = {
            (one.header.frame_id, one.child_frame_id): pose_of(
                one.transform.translation, one.transform.rotation
            )
            for one in message.transforms
        }
        stamp = stamp_of(message.transforms[0].header)
        base = links["odom", "base_link"]
        at = odometry[stamp]
        same_pose(base, pose_of(at.position, at.orientation))
        if ("map", "odom") in links:
            there = in_map[stamp]
            whole = compose(links["map", "odom"], base)
            same_pose(whole, pose_of(there.position, there.orientation))
            joined += 1
    assert joined == len(in_map) > 900


def test_diagnostics_and_markers(live: Any) -> None:
    messages = live[0]
    last = {one.name: one for one in messages["/diagnostics"][-1].status}
    for name in ("pose in odom", "pose in map", "gyro", "tracks", "position", "parameters"):
        assert f"icreckon: {name}" in last
    assert last["icreckon: clocks"].level == 0
    assert last["icreckon: pose in odom"].hardware_id == ROBOT
    assert len(messages["/icrs"]) > 0.5 * SECONDS * 5.0
    left, right = messages["/icrs"][-1].markers[0].points
    assert left.y > 0.0 > right.y
    assert len(messages["/slip"]) > 0.5 * SECONDS * 5.0
    slip = messages["/slip"][len(messages["/slip"]) // 2]
    assert [one.name for one in slip.status] == ["slip", "stuck", "spinning", "sliding"]
    assert [one.level for one in slip.status] == [0, 0, 0, 0]
    assert 0.2 < float(statuses(slip)["slip"]["left_ratio"]) < 5.0
    eta0 = statuses(messages["/learnt_parameters"][-1])["eta0"]
    assert float(eta0["value"]) > 1.0
    assert 0.0 < float(eta0["sigma"]) < 1.0


def test_starts_warm_and_again_after_a_kill(live, ros, bag, tmp_path):
    state = tmp_path / "state.json"
    shutil.copy(live[2], state)
    options = {"state_file": state, "save_period": 1.0, "input_depth": DEEP, "reorder": REORDER}
    with node(ros, tmp_path / "first.log", **options) as running:
        until(lambda: "ready:" in running.text(), running)
        assert "warm start" in running.text()
        before = state.read_bytes()
        play(ros, simulated(tmp_path / "short", 4.0, trajectory="slalom", seed=5))
        until(lambda: state.read_bytes() != before, running)
        running.stop(signal.SIGKILL)
    # SIGTERM, as systemd and docker send.
    with recorded_node(ros, tmp_path, stop=signal.SIGTERM, **options) as (record, running):
        assert "warm start" in running.text()
        play(ros, bag)
        until_heard(record, tmp_path / "out", bag)
    odometry = recorded(tmp_path / "out")["/odom"]
    assert odometry[0].pose.pose.position.x == pytest.approx(0.0, abs=0.01)
    assert len(odometry) > 900
    last = statuses(recorded(tmp_path / "out")["/diagnostics"][-1])
    assert last["pose in odom"]["warm_start"] == "true"


def test_a_node_kept_from_running_catches_up(live, ros, bag, tmp_path):
    """Three seconds wait in the queues: three times what a filter corrects afterwards.

    Taken as they came, 51 samples were late. A busy machine may bring a few after the wait.
    """
    options = {"use_fixes": "false", "input_depth": DEEP}
    with recorded_node(ros, tmp_path, **options) as (record, running):
        playing = subprocess.Popen(player(bag, INPUTS[:2]), env=ros)
        until(lambda: odometry_heard(tmp_path / "out") > 200, record)
        running.popen.send_signal(signal.SIGSTOP)
        time.sleep(3.0)
        running.popen.send_signal(signal.SIGCONT)
        assert playing.wait(LONGEST) == 0
        until_quiet(record, tmp_path / "out")
    messages = recorded(tmp_path / "out")
    for sensor in ("gyro", "tracks"):
        assert int(statuses(messages["/diagnostics"][-1])[sensor]["late"]) < 10
    found, wanted = messages["/odom"][-1], live[0]["/odom"][-1]
    assert found.header.stamp == wanted.header.stamp
    ends = [pose_of(one.pose.pose.position, one.pose.pose.orientation) for one in (found, wanted)]
    assert ends[0] == pytest.approx(ends[1], abs=0.01)
