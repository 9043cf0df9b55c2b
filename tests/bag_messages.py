"""Small bags with messages made by hand."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from icreckon.estimator.robot.robot_file import Robot, Vehicle
from icreckon.replay.live.inputs import LiveInputs, Subscription
from icreckon.replay.mapping.topics import topic_map

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
JOINTS = {"topic": "/js", "left": ["l"], "right": ["r"]}
SECOND = 10**9
KIND = "our_msgs/msg/Drive"
DEFINITION = "std_msgs/Header header\nour_msgs/Wheel[2] wheels\nint32[] ticks\nstring who\n"
WHEEL = "float32 rate\n"
VEHICLE = Vehicle(mass=1.0, track_gauge=0.8, sprocket_radius=0.5)
DRIVES = [(k * SECOND, (1.0, 2.0), (10 * k, 20 * k)) for k in (1, 2, 3)]


def header(stamp: int, frame: str = ""):
    moment = T["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return T["std_msgs/msg/Header"](stamp=moment, frame_id=frame)


def vector(x=0.0, y=0.0, z=0.0):
    return T["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def joints(stamp: int, rates, names=("l", "r"), positions=()):
    at, speeds = (np.array(one, dtype=float) for one in (positions, rates))
    return T["sensor_msgs/msg/JointState"](header(stamp), list(names), at, speeds, np.empty(0))


def odometry(stamp: int, v: float, w: float):
    return T["nav_msgs/msg/Odometry"](
        header(stamp),
        "base_link",
        T["geometry_msgs/msg/PoseWithCovariance"](pose(), np.zeros(36)),
        T["geometry_msgs/msg/TwistWithCovariance"](twist(v, w), np.zeros(36)),
    )


def imu(stamp: int, rate=(0.0, 0.0, 0.1), force=(0.0, 0.0, 9.8), rate_covariance=0.0, frame=""):
    absent, rates, zeros = np.zeros(9), np.zeros(9), np.zeros(9)
    absent[0], rates[0] = -1.0, rate_covariance
    return T["sensor_msgs/msg/Imu"](
        header(stamp, frame),
        T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        absent,
        vector(*rate),
        rates,
        vector(*force),
        zeros,
    )


def mcap_messages(path: Path) -> dict[str, list]:
    """Type, time of recording and content of all messages by topic, by the official reader."""
    found: dict[str, list] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, decoded))
    return found


def write_bag(path: Path, messages, delay: int = 0, raw=(), times=None) -> Path:
    """A bag of (topic, message) pairs, recorded at their header stamps plus a delay, or at times."""
    times = iter(times) if times is not None else None
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            if times is None:
                headed = message.transforms[0] if topic.startswith("/tf") else message
                stamp = headed.header.stamp
            when = stamp.sec * 10**9 + stamp.nanosec + delay if times is None else next(times)
            writer.write(connections[topic], when, STORE.serialize_cdr(message, kind))
        for topic, when, data in raw:
            writer.write(connections[topic], when, data)
    return path


def robot_with(**log) -> Robot:
    return Robot("test", VEHICLE, log=log)


def live_inputs(**log: Any) -> tuple[LiveInputs, dict[str, Subscription]]:
    """Inputs of a robot, and its subscriptions by topic."""
    robot = robot_with(**log)
    inputs = LiveInputs(robot, topic_map(robot))
    return inputs, {one.topic: one for one in inputs.subscriptions()}


def halves(log):
    """A log cut in two; in the second half nothing but track speeds and IMU."""
    cut = int(log.tracks.stamps[100]) - 10**6
    first, second = log.between(log.start, cut), log.between(cut, log.end)
    bare = replace(second, fixes=None, truth=None)
    return replace(first, fixes=log.fixes, truth=log.truth), bare


def drive_bag(path: Path, messages, plugin: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """A bag of Drive messages, (stamp, left and right rate, ticks)."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(
        get_types_from_msg(WHEEL, "our_msgs/msg/Wheel") | get_types_from_msg(DEFINITION, KIND)
    )
    types = store.types
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        at = bag.add_connection("/drive", KIND, typestore=store)
        for stamp, rates, ticks in messages:
            wheels = [types["our_msgs/msg/Wheel"](rate) for rate in rates]
            message = types[KIND](header(stamp), wheels, np.array(ticks, dtype=np.int32), "me")
            bag.write(at, stamp, store.serialize_cdr(message, KIND))
    return path


def definition_files(folder: Path) -> list[Path]:
    files = [folder / "our_msgs" / "msg" / "Drive.msg", folder / "our_msgs" / "msg" / "Wheel.msg"]
    files[0].parent.mkdir(parents=True)
    for file, text in zip(files, (DEFINITION, WHEEL), strict=True):
        file.write_text(text, encoding="utf-8")
    return files


def pose(x=0.0, y=0.0, q=(0.0, 0.0, 0.0, 1.0)):
    return T["geometry_msgs/msg/Pose"](
        T["geometry_msgs/msg/Point"](x, y, 0.0), T["geometry_msgs/msg/Quaternion"](*q)
    )


def pose_stamped(stamp: int, **fields):
    return T["geometry_msgs/msg/PoseStamped"](header(stamp, "map"), pose(**fields))


def pose_with_covariance(stamp: int, covariance, **fields):
    full = np.zeros(36)
    full[[0, 7, 35]] = covariance
    inner = T["geometry_msgs/msg/PoseWithCovariance"](pose(**fields), full)
    return T["geometry_msgs/msg/PoseWithCovarianceStamped"](header(stamp), inner)


def twist(v=0.0, w=0.0):
    return T["geometry_msgs/msg/Twist"](vector(v), vector(z=w))


def twist_with_covariance(stamp: int, v: float, w: float):
    full = T["geometry_msgs/msg/TwistWithCovariance"](twist(v, w), np.zeros(36))
    return T["geometry_msgs/msg/TwistWithCovarianceStamped"](header(stamp), full)


SPEEDS = [("/js", joints(k * 10**9, (1.0, 2.0))) for k in range(1, 4)]


def transform(stamp: int, parent: str, child: str, x=0.0, y=0.0, yaw=0.0, q=None):
    quaternion = q if q is not None else (0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
    turn = T["geometry_msgs/msg/Quaternion"](*map(float, quaternion))
    step = T["geometry_msgs/msg/Transform"](vector(x, y, 0.0), turn)
    return T["geometry_msgs/msg/TransformStamped"](header(stamp, parent), child, step)


def tf_bag(path: Path, moving, static=(), speeds=SPEEDS) -> Path:
    """A bag of track speeds and of transforms on /tf and /tf_static."""
    made = T["tf2_msgs/msg/TFMessage"]
    steps = [("/tf_static", made([one])) for one in static] + [
        ("/tf", made([one])) for one in moving
    ]
    return write_bag(path, [*speeds, *steps])


def navsatfix(
    stamp: int,
    latitude: float,
    longitude: float,
    altitude: float = 0.0,
    status: int = 0,
    variances: tuple[float, float] = (0.04, 0.09),
    known: int = 2,
):
    covariance = np.diag([*variances, 1.0]).ravel()
    return T["sensor_msgs/msg/NavSatFix"](
        header(stamp, "gps"),
        T["sensor_msgs/msg/NavSatStatus"](status, 1),
        latitude,
        longitude,
        altitude,
        covariance,
        known,
    )


def orientation(stamp: int, yaw: float, covariance: float = 0.01, absent: bool = False):
    full = np.diag([1.0, 1.0, covariance]).ravel() if covariance else np.zeros(9)
    if absent:
        full[0] = -1.0
    none = np.array([-1.0, *[0.0] * 8])
    return T["sensor_msgs/msg/Imu"](
        header(stamp),
        T["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)),
        full,
        vector(),
        none,
        vector(),
        none,
    )
