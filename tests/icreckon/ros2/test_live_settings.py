"""The node over real ROS 2: settings, frames, clocks, and what it refuses."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from conftest import REPOSITORY, simulated
from ros2_processes import (
    INPUTS,
    LONGEST,
    OUTPUTS,
    ROBOT,
    node,
    play,
    pose_of,
    recorded,
    recorded_node,
    refused,
    stamp_of,
    started,
    until,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def short_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bag")
    return simulated(folder / "short", 4.0, trajectory="slalom", seed=5)


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
        ("robot:=''", "parameter robot: give a robot file"),
    ],
)
def test_a_wrong_value_is_one_clear_line(given: str, message: str, ros: dict[str, str]) -> None:
    words = ("--robot", ROBOT) * (not given.startswith("robot"))
    assert f"icreckon: {message}" in refused(ros, *words, "--ros-args", "-p", given)


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


STATIC = """
import rclpy, time
from geometry_msgs.msg import TransformStamped
from rclpy.qos import QoSProfile, DurabilityPolicy
from tf2_msgs.msg import TFMessage
rclpy.init()
node = rclpy.create_node("static")
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
publisher, message = node.create_publisher(TFMessage, "/tf_static", qos), TFMessage()
def link(parent, child, x, y, z, rotation):
    one = TransformStamped(child_frame_id=child)
    one.header.frame_id = parent
    at, q = one.transform.translation, one.transform.rotation
    at.x, at.y, at.z = x, y, z
    q.x, q.y, q.z, q.w = rotation
    message.transforms.append(one)
link("world", "odom", 10.0, 20.0, 0.0, (0.0, 0.0, 1.0, 0.0))  # half a turn
link("base_link", "plate", 0.1, 0.0, 0.3, (0.0, 0.0, 0.0, 1.0))
link("plate", "imu_link", 0.0, 0.05, 0.0, (1.0, 0.0, 0.0, 0.0))  # upside down
publisher.publish(message)
time.sleep(120.0)
"""


def test_static_transforms_place_the_imu_and_the_fixes(ros, short_bag, tmp_path):
    options = {"map_frame": "world", "odom_frame": "wheels", "mounting_from_tf": "true"}
    options |= {"base_offset": "[0.2, 0.0, 0.0]", "reorder": 1}
    of_static = started(ros, tmp_path / "static.log", (sys.executable, "-c", STATIC))
    with of_static, node(ros, tmp_path / "node.log", **options) as running:
        play(ros, short_bag, topics=INPUTS[1:2])
        until(lambda: "ready:" in running.text(), running)
        assert "IMU in 'imu_link': turned by (180, 0, 0) deg, by tf" in running.text()
        play(ros, short_bag)
        until(lambda: "fixes: /fix/pose" in running.text(), running)
        time.sleep(2.0)
        assert running.stop() == 0, running.text()
    assert "taken as poses in" not in running.text()


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
