"""The node over real ROS 2: player, node and recorder as three processes."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from conftest import REPOSITORY
from icreckon import load_robot, read_log, run
from icreckon.estimator.base.frames import compose

pytestmark = pytest.mark.slow

ROBOT, VARIANT = "auriga-alpha", "inertia-online"
INPUTS = ("/joint_states", "/imu/data_raw", "/fix/pose")
OUTPUTS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/pose_in_map": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/icrs": "visualization_msgs/msg/MarkerArray",
    "/slip": "diagnostic_msgs/msg/DiagnosticArray",
    "/learnt_parameters": "diagnostic_msgs/msg/DiagnosticArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
"""Recorded topics. Subscriptions are announced in this order, and only the last one has messages before
the robot drives."""
INPUT_TYPES = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/imu/data_raw": "sensor_msgs/msg/Imu",
    "/fix/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
SECONDS, RATE = 10.0, 1.0
DEEP = 10_000
"""Length of the queues of inputs that holds a whole drive: a busy machine loses nothing of it."""
REORDER = SECONDS
"""The whole drive: a busy node takes the messages of one topic long after those of another [s]."""
LONGEST = 120.0
"""Longest time to wait for a process [s]."""
PLANAR = np.ix_((0, 1, 5), (0, 1, 5))


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment of the processes: a domain of their own, tf2_msgs built where it is missing."""
    if find_spec("rclpy") is None:
        pytest.skip("no ROS 2: pip install -e '.[ros2-test]', or source a ROS 2")
    folder = tmp_path_factory.mktemp("ros")
    environment = os.environ | {
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(folder / "log"),
        "PYTHONUNBUFFERED": "1",
    }
    if find_spec("tf2_msgs") is None:
        if not (shutil.which("gcc") and shutil.which("g++")):
            pytest.skip("no compiler to build tf2_msgs with, which the ROS 2 wheels lack")
        builder = REPOSITORY / "tests" / "ros2_tf2_msgs.py"
        subprocess.run([sys.executable, builder, folder / "built"], env=environment, check=True)
        before = environment.get("PYTHONPATH")
        paths = [str(folder / "built"), *([before] if before else [])]
        environment["PYTHONPATH"] = os.pathsep.join(paths)
    return environment


def simulated(path: Path, seconds: float) -> Path:
    words = ("--duration", seconds, "--trajectory", "slalom", "--seed", 5)
    icreckon("simulate", "--out", path, "--robot", ROBOT, *words)
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("bag") / "drive", SECONDS)


@pytest.fixture(scope="module")
def short_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive whose messages come, of whatever they tell."""
    return simulated(tmp_path_factory.mktemp("bag") / "short", 4.0)


def icreckon(*words: object) -> None:
    command = [Path(sys.executable).parent / "icreckon", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


class Process(NamedTuple):
    """A running program and the file of its output."""

    popen: subprocess.Popen[str]
    log: Path

    def text(self) -> str:
        return self.log.read_text(encoding="utf-8")

    def stop(self, by: int = signal.SIGINT) -> int:
        self.popen.send_signal(by)
        return self.popen.wait(LONGEST)


@contextmanager
def started(environment: dict[str, str], log: Path, command: Sequence[object]) -> Iterator[Process]:
    with log.open("w", encoding="utf-8") as file:
        popen = subprocess.Popen(
            list(map(str, command)), env=environment, stdout=file, stderr=file, text=True
        )
        try:
            yield Process(popen, log)
        finally:
            if popen.poll() is None:
                popen.kill()
                popen.wait()


def node(environment: dict[str, str], log: Path, **parameters: object) -> Any:
    """Start the node."""
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    program = Path(sys.executable).parent / "icreckon"
    command = [program, "ros2-node", "--robot", ROBOT, "--variant", VARIANT, "--ros-args", *words]
    return started(environment, log, command)


@contextmanager
def recorded_node(
    environment: dict[str, str],
    folder: Path,
    *,
    topics: dict[str, str] = OUTPUTS,
    stop: int = signal.SIGINT,
    **parameters: object,
) -> Iterator[tuple[Process, Process]]:
    """Recorder of `folder / "out"` and a node that has found it; both end well."""
    path, program = folder / "out", REPOSITORY / "tests" / "ros2_recorder.py"
    wanted = [f"{topic}:{kind}" for topic, kind in topics.items()]
    command = [sys.executable, program, path, *wanted]
    with (
        started(environment, path.with_suffix(".log"), command) as record,
        node(environment, folder / "node.log", **parameters) as running,
    ):
        until((folder / "out.ready").exists, record)
        until(lambda: "ready:" in running.text(), running)
        if "/diagnostics" in topics:
            # Nothing that the node publishes is lost.
            until((folder / "out.hears").exists, record)
            time.sleep(0.5)
        yield record, running
        assert running.stop(stop) == 0, running.text()
        assert record.stop() == 0, record.text()


def player(bag: Path, topics: Sequence[str], *options: object) -> list[str]:
    program = REPOSITORY / "tests" / "ros2_player.py"
    return list(map(str, [sys.executable, program, bag, ",".join(topics), RATE, *options]))


def play(
    environment: dict[str, str], bag: Path, *options: object, topics: Sequence[str] = INPUTS
) -> None:
    command = player(bag, topics, *options)
    subprocess.run(command, env=environment, check=True, timeout=2 * LONGEST)


def refused(environment: dict[str, str], *words: object) -> str:
    """What a node prints that does not start."""
    command = [Path(sys.executable).parent / "icreckon", "ros2-node", *words]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=LONGEST
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    return done.stderr


def until(condition: Callable[[], bool], process: Process) -> None:
    end = time.monotonic() + LONGEST
    while not condition():
        assert process.popen.poll() is None, process.text()
        assert time.monotonic() < end, process.text()
        time.sleep(0.05)


def until_heard(record: Process, path: Path, bag: Path) -> None:
    """Wait until the odometry of each IMU sample of a bag is recorded, and what follows it."""
    with AnyReader([bag]) as reader:
        samples = reader.topics["/imu/data_raw"].msgcount
    until(lambda: odometry_heard(path) >= samples, record)
    time.sleep(2.0)


def until_quiet(record: Process, path: Path) -> None:
    """Wait until the node has worked through its queues: no odometry comes for 5 s."""
    count = -1
    while (heard := odometry_heard(path)) != count:
        assert record.popen.poll() is None, record.text()
        count = heard
        time.sleep(5.0)


def odometry_heard(path: Path) -> int:
    """Number of messages of odometry that the recorder has by now."""
    hears = path.with_suffix(".hears")
    return int(hears.read_text("utf-8") or 0) if hears.exists() else 0


def recorded(path: Path) -> dict[str, list[Any]]:
    messages: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            messages.setdefault(connection.topic, []).append(message)
    return messages


def stamp_of(header: Any) -> int:
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def pose_of(place: Any, turn: Any) -> np.ndarray:
    return np.array([place.x, place.y, 2.0 * np.arctan2(turn.z, turn.w)])


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
    last = {one.name: one for one in messages["/diagnostics"][-1].status}
    counts = {one.key: one.value for one in last["icreckon: tracks"].values}
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
    icreckon(
        "replay", recording, "--robot", ROBOT, "--variants", VARIANT,
        "--formats", "csv", "--out", out,
    )  # fmt: skip
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
    ratios = {one.key: float(one.value) for one in slip.status[0].values}
    assert 0.2 < ratios["left_ratio"] < 5.0
    learnt = {one.name: one for one in messages["/learnt_parameters"][-1].status}
    values = {one.key: float(one.value) for one in learnt["eta0"].values}
    assert values["value"] > 1.0
    assert 0.0 < values["sigma"] < 1.0


def test_starts_warm_and_again_after_a_kill(live, ros, bag, short_bag, tmp_path):
    state = tmp_path / "state.json"
    shutil.copy(live[2], state)
    options = {"state_file": state, "save_period": 1.0, "input_depth": DEEP, "reorder": REORDER}
    with node(ros, tmp_path / "first.log", **options) as running:
        until(lambda: "ready:" in running.text(), running)
        assert "warm start" in running.text()
        before = state.read_bytes()
        play(ros, short_bag)
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
    last = {
        one.name: {pair.key: pair.value for pair in one.values}
        for one in recorded(tmp_path / "out")["/diagnostics"][-1].status
    }
    assert last["icreckon: pose in odom"]["warm_start"] == "true"


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
    last = {one.name: one for one in messages["/diagnostics"][-1].status}
    for sensor in ("gyro", "tracks"):
        counts = {one.key: one.value for one in last[f"icreckon: {sensor}"].values}
        assert int(counts["late"]) < 10
    found, wanted = messages["/odom"][-1], live[0]["/odom"][-1]
    assert found.header.stamp == wanted.header.stamp
    ends = [pose_of(one.pose.pose.position, one.pose.pose.orientation) for one in (found, wanted)]
    assert ends[0] == pytest.approx(ends[1], abs=0.01)


def test_simulated_time_that_jumps_back_starts_anew(ros, short_bag, tmp_path):
    options = {"use_sim_time": "true", "use_fixes": "false"}
    topics = {"/odom": OUTPUTS["/odom"]}
    with recorded_node(ros, tmp_path, topics=topics, **options) as (_, running):
        play(ros, short_bag, "--clock", "--loops", 2, topics=INPUTS[:2])
    assert "the clock went back by" in running.text()
    stamps = [stamp_of(one.header) for one in recorded(tmp_path / "out")["/odom"]]
    (back,) = np.flatnonzero(np.diff(stamps) < 0)
    after = recorded(tmp_path / "out")["/odom"][back + 1]
    assert np.hypot(after.pose.pose.position.x, after.pose.pose.position.y) < 0.05


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("reorder:=soon", "parameters of the node: reorder: expected a number, found text"),
        ("use_sim_time:=1", "parameters of the node: Trying to set parameter 'use_sim_time'"),
        (
            "qos_overrides./odom.publisher.reliability:=best",
            "parameter qos_overrides./odom.publisher.reliability 'best'; did you mean 'best_effort'?",
        ),
        ("odom_frame:=", "arguments for ROS: Couldn't parse parameter override rule"),
    ],
)
def test_a_wrong_value_is_one_clear_line(given: str, message: str, ros: dict[str, str]) -> None:
    assert f"icreckon: {message}" in refused(ros, "--robot", ROBOT, "--ros-args", "-p", given)


def test_qos_overrides_act(ros: dict[str, str], short_bag: Path, tmp_path: Path) -> None:
    """Of a publisher and of a subscription, by what other nodes see of them."""
    names = ("/odom.publisher", "/joint_states.subscription")
    options = {f"qos_overrides.{one}.reliability": "best_effort" for one in names}
    # Nodes find each other within a second, on a busy machine within some.
    look = (
        "import rclpy, time\n"
        "rclpy.init()\n"
        "node, found = rclpy.create_node('look'), []\n"
        "ends = time.monotonic() + 60.0\n"
        "while not (found and all(found)):\n"
        "    assert time.monotonic() < ends, found\n"
        "    time.sleep(0.5)\n"
        "    found = [node.get_publishers_info_by_topic('/odom')]\n"
        "    found += [node.get_subscriptions_info_by_topic('/joint_states')]\n"
        "print(*(of[0].qos_profile.reliability.name for of in found))\n"
    )
    with node(ros, tmp_path / "node.log", **options) as running:
        until(lambda: "ready:" in running.text(), running)
        play(ros, short_bag, topics=INPUTS[:2])
        done = subprocess.run(
            [sys.executable, "-c", look], env=ros, capture_output=True, text=True, check=True
        )
        assert running.stop() == 0, running.text()
    assert done.stdout.split() == ["BEST_EFFORT", "BEST_EFFORT"]
    assert "unknown" not in running.text()


def test_its_own_odometry_is_no_input(ros: dict[str, str], tmp_path: Path) -> None:
    shipped = REPOSITORY / "estimator" / "robot" / "robots" / f"{ROBOT}.toml"
    robot = tmp_path / "robot.toml"
    before_log = shipped.read_text("utf-8").partition("\n[log")[0]
    robot.write_text(before_log + '\n[log.tracks]\ntopic = "/odom"\n', "utf-8")
    text = refused(ros, "--robot", robot)
    assert "icreckon: topic /odom is an input (tracks) and the node's own output" in text
    assert "-r __ns:=/icreckon" in text
    program = Path(sys.executable).parent / "icreckon"
    command = [program, "ros2-node", "--robot", robot, "--ros-args", "-r", "__ns:=/mine"]
    with started(ros, tmp_path / "node.log", command) as running:
        until(lambda: "ready:" in running.text(), running)
        assert running.stop() == 0, running.text()


GIVE_POSE = """
import sys, time
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
rclpy.init()
node = rclpy.create_node("rviz")
publisher = node.create_publisher(PoseWithCovarianceStamped, "/initialpose", 1)
while not publisher.get_subscription_count():
    time.sleep(0.05)
message = PoseWithCovarianceStamped()
message.pose.pose.position.x, message.pose.pose.position.y = 3.0, 4.0
message.pose.pose.orientation.w = 1.0
for frame in ("odom", "map"):
    message.header.frame_id = frame
    publisher.publish(message)
    time.sleep(0.5)
"""


def test_a_given_pose_places_the_map(ros: dict[str, str], short_bag: Path, tmp_path: Path) -> None:
    """Without fixes: by a parameter, then anew by a message; odom goes on."""
    options = {"use_fixes": "false", "start_pose": "[1.0, 2.0, 0.5]"}
    with recorded_node(ros, tmp_path, **options) as (_, running):
        play(ros, short_bag, topics=INPUTS[:2])
        subprocess.run([sys.executable, "-c", GIVE_POSE], env=ros, check=True, timeout=LONGEST)
        until(lambda: "map starts again at x 3.00 m, y 4.00 m" in running.text(), running)
        assert "initialpose is in frame 'odom', not in 'map': not used" in running.text()
    in_map = recorded(tmp_path / "out")["/pose_in_map"]
    first = in_map[0].pose.pose
    assert pose_of(first.position, first.orientation) == pytest.approx([1.0, 2.0, 0.5], abs=0.1)


def test_fixes_in_another_frame_are_warned_of(ros, short_bag, tmp_path):
    # A whole number is a real number, too.
    options = {"map_frame": "world", "odom_frame": "wheels", "reorder": 1}
    with node(ros, tmp_path / "node.log", **options) as running:
        until(lambda: "ready:" in running.text(), running)
        play(ros, short_bag)
        until(lambda: "fixes are in" in running.text(), running)
        assert running.stop() == 0, running.text()
    assert "fixes are in frame 'odom', and are taken as poses in 'world'" in running.text()
    assert running.text().count("taken as poses") == 1


def test_a_missing_robot_is_one_clear_line(ros: dict[str, str]) -> None:
    assert "parameter robot: give a robot file" in refused(ros)
