"""Quick readers give what decoding gives, or nothing."""

from itertools import product

import numpy as np
import pytest
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore

from conftest import make_log, sample_log
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.bags.decoding import decoder
from icreckon.replay.bags.message_types import IMU, JOINT_STATE
from icreckon.replay.bags.records import Channel
from icreckon.replay.export.log_bag import write_log
from icreckon.replay.reading import gather as gathering
from icreckon.replay.reading.fast_rows import quick_reader
from icreckon.replay.reading.message_rows import JointReader, imu_row
from icreckon.replay.reading.read_log import read_log
from icreckon.replay.reading.stream import Stream

STORES = {"cdr": get_typestore(Stores.ROS2_HUMBLE), "ros1": get_typestore(Stores.ROS1_NOETIC)}
FRAMES = ["", "a", "ab", "abc", "imu_link", "imü"]


def channel(encoding: str, msgtype: str) -> Channel:
    if encoding == "cdr":
        return Channel("/t", msgtype, MessageDefinition(MessageDefinitionFormat.NONE, ""), "cdr")
    text, _ = STORES["ros1"].generate_msgdef(msgtype)
    return Channel("/t", msgtype, MessageDefinition(MessageDefinitionFormat.MSG, text), "ros1")


def header(encoding: str, frame: str):
    types = STORES[encoding].types
    stamp = types["builtin_interfaces/msg/Time"](sec=12, nanosec=345)
    more = {"seq": 7} if encoding == "ros1" else {}
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **more)


def raw(encoding: str, message) -> bytes:
    store = STORES[encoding]
    serialise = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
    return bytes(serialise(message, message.__msgtype__))


def imu(encoding: str, frame: str = "imu", absent: tuple[float, float] = (0.0, 0.0)):
    types = STORES[encoding].types
    rng = np.random.default_rng(1)
    vectors = [types["geometry_msgs/msg/Vector3"](*rng.normal(size=3)) for _ in range(2)]
    covariances = [rng.normal(size=9) for _ in range(3)]
    covariances[1][0], covariances[2][0] = absent
    return types[IMU](
        header(encoding, frame),
        types["geometry_msgs/msg/Quaternion"](*rng.normal(size=4)),
        covariances[0],
        vectors[0],
        covariances[1],
        vectors[1],
        covariances[2],
    )


def joints(encoding: str, names, counts=(2, 2, 2), frame: str = ""):
    values = [np.arange(count) + 10.0 * k for k, count in enumerate(counts)]
    return STORES[encoding].types[JOINT_STATE](header(encoding, frame), list(names), *values)


def both(encoding: str, message, reader):
    """Stamp and row as decoding gives them, and as the quick reader does."""
    where = channel(encoding, message.__msgtype__)
    data = raw(encoding, message)
    decoded = decoder(where, "test")(data)
    stamp = decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec
    quick = quick_reader(where, reader)
    assert quick is not None
    return (stamp, reader(decoded)), tuple(quick(data))


@pytest.mark.parametrize("encoding", STORES)
@pytest.mark.parametrize("frame", FRAMES)
def test_imu(encoding: str, frame: str) -> None:
    for absent in product((0.0, -1.0), repeat=2):
        slow, quick = both(encoding, imu(encoding, frame, absent), imu_row)
        assert slow[0] == quick[0]
        np.testing.assert_array_equal(slow[1], quick[1])


@pytest.mark.parametrize("encoding", STORES)
@pytest.mark.parametrize("positions", [False, True])
def test_joints(encoding: str, positions: bool) -> None:
    names = [("l", "r"), ("right_r", "left_l", "l", "r"), ("r", "l"), ("arm",), ()]
    for found, frame in product(names, FRAMES):
        count = len(found)
        for counts in ((count, count, count), (count, count, 0), (count + 1, count, 2)):
            reader = JointReader(["l"], ["r"], positions)
            slow, quick = both(encoding, joints(encoding, found, counts, frame), reader)
            assert slow == quick


def test_joints_whose_names_change() -> None:
    reader = JointReader(["l"], ["r"])
    quick = quick_reader(channel("cdr", JOINT_STATE), reader)
    assert quick is not None
    for names, row in (
        (("l", "r"), (10.0, 11.0)),
        (("l", "r"), (10.0, 11.0)),
        (("r", "l"), (11.0, 10.0)),
        (("x", "y"), None),
        (("l", "r"), (10.0, 11.0)),
    ):
        assert quick(raw("cdr", joints("cdr", names)))[1] == row
    assert reader.seen == {"l", "r", "x", "y"}


@pytest.mark.parametrize("encoding", STORES)
def test_bytes_that_are_no_message(encoding: str) -> None:
    for message, reader in (
        (imu(encoding), imu_row),
        (joints(encoding, ("l", "r")), JointReader(["l"], ["r"])),
    ):
        data = raw(encoding, message)
        quick = quick_reader(channel(encoding, message.__msgtype__), reader)
        assert quick is not None
        for wrong in (b"", data[:3], data[:20], data[:-9], data + bytes(8), b"\0\0" + data[2:]):
            if encoding == "ros1" and wrong[:2] == b"\0\0":
                continue
            with pytest.raises(Exception):  # noqa: B017, PT011 - whatever it is, it is caught
                quick(wrong)


def test_big_endian_is_decoded() -> None:
    store = STORES["cdr"]
    message = imu("cdr")
    data = bytes(store.serialize_cdr(message, IMU, little_endian=False))
    stream = Stream("imu", "/t", "bag", "auto", {IMU: imu_row}, quick=quick_reader)
    from icreckon.replay.bags.records import Record

    stream.take(Record(channel("cdr", IMU), 5, data))
    stamps, rows = stream.arrays("header")
    assert stamps.tolist() == [12 * 10**9 + 345]
    np.testing.assert_array_equal(rows[0], imu_row(message))


@pytest.mark.parametrize("form", ["mcap", "sqlite3", "ros1"])
def test_bags_are_read_quickly_and_right(tmp_path, robot, form, monkeypatch):
    path = write_log(make_log(), tmp_path / "bag", form, robot)
    taken = []

    def counted(where, reader):
        quick = quick_reader(where, reader)

        def count(data):
            result = quick(data)
            taken.append(where.topic)
            return result

        return count if quick is not None else None

    monkeypatch.setattr(gathering, "quick_reader", counted)
    log = read_log(path, robot)
    assert taken.count("/imu/data_raw") == len(log.imu.stamps)
    assert taken.count("/joint_states") == len(log.tracks.stamps)
    monkeypatch.setattr(gathering, "quick_reader", lambda *_: None)
    slow = read_log(path, robot)
    np.testing.assert_array_equal(slow.imu.angular_velocity, log.imu.angular_velocity)
    np.testing.assert_array_equal(slow.tracks.speeds, log.tracks.speeds)
    np.testing.assert_array_equal(slow.tracks.stamps, log.tracks.stamps)


@pytest.mark.parametrize(
    ("name", "robot_name"), [("marmotte_part1", "marmotte"), ("husky_test1.bag", "husky")]
)
def test_sample_logs_are_the_same(data_dir, name, robot_name, monkeypatch):
    robot, path = load_robot(robot_name), sample_log(data_dir, name)
    quick = read_log(path, robot)
    monkeypatch.setattr(gathering, "quick_reader", lambda *_: None)
    slow = read_log(path, robot)
    for one, other in (
        (quick.imu.angular_velocity, slow.imu.angular_velocity),
        (quick.imu.linear_acceleration, slow.imu.linear_acceleration),
        (quick.imu.stamps, slow.imu.stamps),
        (quick.tracks.speeds, slow.tracks.speeds),
    ):
        np.testing.assert_array_equal(one, other)
