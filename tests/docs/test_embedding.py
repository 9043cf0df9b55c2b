"""The guide for embedding: its code runs and does what the text says; the ROS 2 node without ROS."""

import contextlib
import importlib.util
import io
import re
import sys
from itertools import pairwise
from types import ModuleType, SimpleNamespace

import msgspec
import numpy as np
import pytest

import icreckon
from icreckon.estimator.base.frames import relative
from readme import ROOT, code_blocks

PAGE = "docs/embedding.md"
NODE = ROOT / "docs" / "examples" / "ros2_node.py"


@pytest.fixture(scope="module")
def guide(tmp_path_factory):
    """All names after the blocks of the guide have run, and what each has printed."""
    names, printed = {}, []
    with contextlib.chdir(tmp_path_factory.mktemp("guide")):
        for block in code_blocks("python", PAGE):
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(block, PAGE, "exec"), names)  # noqa: S102
            printed.append(out.getvalue())
    return names, printed


def test_the_pose_graphs_edges_are_right_within_their_information(guide):
    names, _ = guide
    edges, log = names["front_end"].edges, names["log"]
    assert len(edges) >= 8
    truth = dict(zip(log.truth.poses.stamps.tolist(), log.truth.poses.poses, strict=True))
    for (_, end, *_), (begin, *_) in pairwise(edges):
        assert begin == end, "a chain from keyframe to keyframe"
    normalised = []
    for begin, end, pose, information in edges:
        (x0, y0, yaw0), (x1, y1, yaw1) = truth[begin], truth[end]
        dx, dy = x1 - x0, y1 - y0
        true = [
            np.cos(yaw0) * dx + np.sin(yaw0) * dy - pose[0],
            np.cos(yaw0) * dy - np.sin(yaw0) * dx - pose[1],
            yaw1 - yaw0 - pose[2],
        ]
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        seen = [cos * true[0] + sin * true[1], cos * true[1] - sin * true[0], true[2]]
        normalised.append(np.array(seen) @ information @ np.array(seen))
    # The truth is friction, which the filter takes for slip: no band, but no nonsense either.
    assert 0.3 < np.mean(normalised) < 15.0
    # Only the newest keyframe is still marked.
    assert names["front_end"].estimator.marks == (names["front_end"].keyframe,)


def test_visual_odometry_helps(guide):
    names, _ = guide
    true = names["truth"].poses[-1]
    alone, fused = (names[name] for name in ("alone", "fused"))
    assert fused.health.sensors["body velocity"].late > 150
    assert fused.pose_covariance[0, 0] < alone.pose_covariance[0, 0]
    assert np.hypot(*(fused.pose - true)[:2]) < np.hypot(*(alone.pose - true)[:2])


def test_body_velocity_of_a_motion_on_a_circle(guide):
    """With a sensor off the centre, in front and to the left."""
    names, _ = guide
    v, w, dt, (sx, sy) = 0.8, 0.9, 0.1, (0.4, 0.3)
    radius = v / w

    def sensor_pose(angle):
        x, y = radius * np.sin(angle), radius * (1.0 - np.cos(angle))
        cos, sin = np.cos(angle), np.sin(angle)
        return np.array([x + cos * sx - sin * sy, y + sin * sx + cos * sy, angle])

    seen = relative(sensor_pose(0.3), sensor_pose(0.3 + w * dt))
    found = names["body_velocity_of"](0, 100_000_000, seen, 0.01, sensor=(sx, sy))
    assert found.stamp == 50_000_000
    assert (found.v_x, found.v_y) == pytest.approx((v, 0.0), abs=1e-3)
    assert found.variance == pytest.approx(0.01)


def test_restored_and_warm_started_are_what_the_guide_says(guide):
    names, _ = guide
    assert (names["same"].pose == names["fused"].pose).all()
    assert (names["later"].pose == 0.0).all()
    assert names["later"].parameters == names["fused"].parameters


def test_every_example_says_something(guide):
    _, printed = guide
    assert re.match(r"\d\.\d s: ", printed[0])
    assert all(printed)
    text = "".join(printed)
    said_so = (
        "in the map: [",
        "with visual odometry: ",
        "the motion would show: ['",
        "docked at [",
    )
    for said in (*said_so, "newest admitted: off by [", "gaps bridged, ", "considered: "):
        assert said in text
    # What is kept fixed has no share, and the others are learnt.
    (learnt,) = re.findall(r"eta0: \S+, share nan\nepsilon0: \S+, share (\S+)\n", text)
    assert float(learnt) < 1.0


def test_the_dock_is_found_and_the_bias_with_it(guide):
    names, _ = guide
    docked = names["docked"]
    assert docked.pose == pytest.approx([0.1, 0.0, 0.2], abs=0.02)
    assert docked.biases["gyro_bias"] == pytest.approx(0.004, abs=1e-3)
    assert docked.health.rejections() == {}


def test_what_is_considered_stays(guide):
    names, _ = guide
    eta0 = names["considering"].parameter_health["eta0"]
    assert names["considering"].parameters["eta0"] == names["robot"].indices.eta0
    assert (eta0.share, eta0.sigma) == (1.0, 0.4)


def test_the_kept_parameter_is_the_robot_files(guide):
    names, _ = guide
    assert names["kept"].parameters["eta0"] == names["robot"].indices.eta0
    assert names["kept"].parameters["epsilon0"] != names["robot"].indices.epsilon0


def in_the_map(names):
    """The true pose at the end in the map of the guide."""
    x, y, yaw = names["log"].truth.poses.poses[-1]
    x0, y0, yaw0 = (names[name] for name in ("x0", "y0", "yaw0"))
    cos, sin = np.cos(yaw0), np.sin(yaw0)
    return np.array([x0 + cos * x - sin * y, y0 + sin * x + cos * y, yaw0 + yaw])


def test_a_start_in_a_map_is_found(guide):
    names, _ = guide
    wrong = names["mapped"].pose - in_the_map(names)
    assert np.hypot(*wrong[:2]) < 0.2
    assert abs(wrong[2]) < 0.05
    assert names["mapped"].health.rejections() == {}


@pytest.mark.parametrize("off", [0.5, 1.0])
def test_position_fixes_tell_a_heading_that_is_not_far_off_if_it_is_not_said_to_be_exact(
    guide, off
):
    names, _ = guide
    start = (names["x0"], names["y0"], names["yaw0"] - off)
    unsure = icreckon.PoseEstimator(names["robot"], start=start, start_sigma=(0.5, 0.5, 3.0))
    sure = icreckon.PoseEstimator(names["robot"], start=start)
    for measurement in names["log"].measurements():
        is_fix = isinstance(measurement, icreckon.PositionFix)
        for estimator in (unsure, sure):
            estimator.feed(names["in_map"](measurement) if is_fix else measurement)
    assert abs(unsure.pose[2] - in_the_map(names)[2]) < 0.1
    assert unsure.health.rejections() == {}
    assert sure.health.rejections()["position: gate"] >= 5


# --- the node ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def node() -> ModuleType:
    spec = importlib.util.spec_from_file_location("ros2_node", NODE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def header(stamp):
    sec, nanosec = divmod(stamp, 10**9)
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id="")


def vector(x=0.0, y=0.0, z=0.0, **more):
    return SimpleNamespace(x=x, y=y, z=z, **more)


def joint_state(stamp, **rates):
    return SimpleNamespace(header=header(stamp), name=list(rates), velocity=list(rates.values()))


def imu(stamp, rate, force, *, has_gyro=True, has_force=True):
    return SimpleNamespace(
        header=header(stamp),
        angular_velocity=vector(*rate),
        linear_acceleration=vector(*force),
        angular_velocity_covariance=[0.0 if has_gyro else -1.0] * 9,
        linear_acceleration_covariance=[0.0 if has_force else -1.0] * 9,
    )


def empty_odometry():
    pose = SimpleNamespace(position=vector(), orientation=vector(w=1.0))
    twist = SimpleNamespace(linear=vector(), angular=vector())
    return SimpleNamespace(
        header=header(0),
        child_frame_id="",
        pose=SimpleNamespace(pose=pose, covariance=None),
        twist=SimpleNamespace(twist=twist, covariance=None),
    )


STAMP = 1_700_000_000_123_456_789


def test_joints_become_track_speeds(node):
    sides = (["a", "b"], ["c"], 0.1)
    message = joint_state(STAMP, b=2.0, c=-4.0, arm=9.0, a=4.0)
    found = node.track_speeds_of(message, *sides)
    assert found == icreckon.TrackSpeeds(STAMP, pytest.approx(0.3), pytest.approx(-0.4))
    assert node.track_speeds_of(joint_state(STAMP, arm=1.0), *sides) is None


def test_imu_messages_become_samples(node):
    message = imu(STAMP, (0.1, 0.2, 0.3), (1.0, 2.0, 9.8))
    assert node.imu_sample_of(message) == icreckon.ImuSample(
        STAMP, (0.1, 0.2, 0.3), (1.0, 2.0, 9.8)
    )
    assert (
        node.imu_sample_of(imu(1, (0, 0, 1), (0, 0, 0), has_force=False)).linear_acceleration
        is None
    )
    assert node.imu_sample_of(imu(1, (0, 0, 1), (0, 0, 0), has_gyro=False)) is None


def test_an_estimate_becomes_odometry(node):
    robot = icreckon.load_robot("auriga-alpha")
    tracks, radius = robot.log["tracks"], robot.vehicle.sprocket_radius
    estimator = icreckon.PoseEstimator(robot, start=(1.0, 2.0, 3.0), start_sigma=(0.1, 0.2, 0.3))
    for k in range(200):
        stamp = STAMP + k * 10_000_000
        rates = {tracks["left"][0]: 0.3 / radius, tracks["right"][0]: 0.6 / radius}
        measured = node.track_speeds_of(
            joint_state(stamp, **rates), tracks["left"], tracks["right"], radius
        )
        assert estimator.feed(measured)
        assert estimator.feed(node.imu_sample_of(imu(stamp, (0.0, 0.0, 0.27), (0.0, 0.11, 9.81))))
    message = node.fill_odometry(empty_odometry(), estimator)
    assert node.stamp_of(message) == estimator.stamp
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    x, y, yaw = estimator.pose
    assert (message.pose.pose.position.x, message.pose.pose.position.y) == (x, y)
    turn = message.pose.pose.orientation
    assert 2.0 * np.arctan2(turn.z, turn.w) == pytest.approx(yaw)
    assert message.twist.twist.linear.x == estimator.twist[0]
    assert message.twist.twist.angular.z == estimator.twist[2]
    for covariance, known in (
        (message.pose.covariance, estimator.pose_covariance),
        (message.twist.covariance, estimator.twist_covariance),
    ):
        assert len(covariance) == 36
        full = np.array(covariance).reshape(6, 6)
        assert (full[np.ix_([0, 1, 5], [0, 1, 5])] == known).all()
        assert (full.diagonal()[2:5] == 1e6).all()
        assert np.linalg.eigvalsh(full).min() > 0.0


@pytest.mark.parametrize(
    ("log", "side"),
    [
        ({}, "left"),
        ({"imu": {"topic": "/imu"}}, "left"),
        ({"tracks": {"topic": "/odom"}}, "left"),
        ({"tracks": {"topic": "/joints", "left": ["a"]}}, "right"),
        ({"tracks": {"topic": "/joints", "left": ["a"], "right": []}}, "right"),
        ({"tracks": {"topic": "/joints", "left": "a", "right": "b"}}, "left"),
    ],
)
def test_a_robot_file_without_joints_is_refused(node, log, side):
    robot = msgspec.structs.replace(icreckon.load_robot("auriga-alpha"), log=log)
    with pytest.raises(icreckon.EstimatorError, match=rf"no joints of the {side} .*\[log.tracks\]"):
        node.joints_of(robot)


class FakeNode:
    """As much of rclpy.node.Node as the node uses before it spins."""

    def __init__(self, name):
        self.name, self.parameters, self.topics = name, {}, []

    def declare_parameter(self, name, value):
        self.parameters[name] = FAKE_PARAMETERS.get(name, value)

    def get_parameter(self, name):
        return SimpleNamespace(value=self.parameters[name])

    def create_publisher(self, _kind, topic, _depth):
        self.topics.append(topic)

    def create_subscription(self, _kind, topic, _callback, _qos):
        self.topics.append(topic)

    def create_timer(self, _period, _callback):
        pass

    def destroy_node(self):
        pass


FAKE_PARAMETERS: dict[str, str] = {}


@pytest.fixture
def fake_ros(monkeypatch):
    """Modules in place of those of ROS; the nodes that were spun."""
    spun = []
    modules = {
        "rclpy": {"init": lambda: None, "spin": spun.append, "try_shutdown": lambda: None},
        "rclpy.node": {"Node": FakeNode},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "nav_msgs": {},
        "nav_msgs.msg": {"Odometry": None},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"Imu": None, "JointState": None},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return spun


def test_the_node_spins_with_a_robot_that_names_its_joints(node, fake_ros, monkeypatch):
    monkeypatch.setitem(FAKE_PARAMETERS, "robot", "auriga-alpha")
    node.main()
    (spun,) = fake_ros
    assert spun.topics == ["odom", "joint_states", "imu"]
    assert (spun.left, spun.right) == node.joints_of(icreckon.load_robot("auriga-alpha"))


def test_the_node_ends_with_a_line_where_the_robot_file_will_not_do(
    node, fake_ros, monkeypatch, tmp_path
):
    path = tmp_path / "robot.toml"
    path.write_text(
        'name = "bare"\n[vehicle]\nmass = 80.0\ntrack_gauge = 0.6\nsprocket_radius = 0.1\n',
        encoding="utf-8",
    )
    monkeypatch.setitem(FAKE_PARAMETERS, "robot", str(path))
    with pytest.raises(SystemExit, match=r"ros2_node: the robot file of 'bare' names no joints"):
        node.main()
    assert fake_ros == []


def test_the_node_is_importable_without_ros_and_says_so_only_when_run(node):
    with pytest.raises(ModuleNotFoundError, match="rclpy"):
        node.main()
