"""Live messages become the measurements that a replay of their bag reads."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import bag_messages as made
from bag_messages import JOINTS, SECOND, STORE, T, joints, live_inputs, robot_with, write_bag
from icreckon import ImuSample, Measurement, ReplayError, Robot, TrackSpeeds, read_log
from icreckon.replay.live.apart_messages import ApartMessages

T0 = 1_700_000_000 * SECOND
STAMPS = [T0 + k * SECOND // 20 for k in range(40)]
TRACKS = [("/js", joints(stamp, (1.0 + 0.1 * k, 2.0))) for k, stamp in enumerate(STAMPS)]


def through(bag: Path, robot: Robot) -> list[Measurement]:
    """Measurements of all messages of a bag, one after the other."""
    inputs, topics = live_inputs(**robot.log)
    found: list[Measurement] = []
    with AnyReader([bag], default_typestore=STORE) as reader:
        when = 0
        for connection, when, raw in reader.messages(
            [one for one in reader.connections if one.topic in topics]
        ):
            message = reader.deserialize(raw, connection.msgtype)
            kind = connection.msgtype
            found += inputs.take(topics[connection.topic], kind, message, when)
        found += inputs.flush(when + 10 * SECOND)
    return found


def read_alike(bag: Path, robot: Robot, since: int = 0) -> list[Measurement]:
    """Measurements of a replay from a time on, which are those of a live run."""
    replayed, live = (
        sorted(found, key=lambda one: (one.stamp, type(one).__name__))
        for found in (read_log(bag, robot).measurements(), through(bag, robot))
    )
    replayed, live = ([one for one in found if one.stamp > since] for found in (replayed, live))
    assert [type(one) for one in live] == [type(one) for one in replayed]
    for one, other in zip(live, replayed, strict=True):
        for name in type(one).__match_args__:
            mine, theirs = getattr(one, name), getattr(other, name)
            if mine is None or theirs is None:
                assert mine is theirs
            else:
                assert np.asarray(mine) == pytest.approx(np.asarray(theirs), abs=1e-12), name
    return replayed


def gps(stamp: int, north: float, status: int = 0):
    height = float("nan") if north > 3.0 else 100.0
    return made.navsatfix(stamp, 52.0 + north / 111_000.0, 13.0, height, status)


def twist_stamped(stamp: int, v: float, w: float):
    return T["geometry_msgs/msg/TwistStamped"](made.header(stamp), made.twist(v, w))


def moved(stamp: int, x: float):
    message = made.odometry(stamp, 9.0, 9.0)  # the twist of an odometry is not used
    message.pose.pose.position.x = x
    return message


def point(stamp: int, x: float):
    return T["geometry_msgs/msg/PointStamped"](
        made.header(stamp, "map"), T["geometry_msgs/msg/Point"](x, 2.0, 0.3)
    )


def stream(topic: str, make: Callable[[int, int], Any], every: int = 4) -> list[tuple[str, Any]]:
    """Messages of a topic, each made of its number and stamp."""
    return [(topic, make(k, stamp)) for k, stamp in enumerate(STAMPS[::every])]


UNITS = {"rate_unit": "deg/s", "acceleration_unit": "g"}
IMU = stream("/imu", lambda k, at: made.imu(at, rate=(0.0, 0.0, 0.01 * k)), 1)
GPS = stream("/gps", lambda k, at: gps(at, 0.5 * k))
GYRO = {
    "topic": "/gyro",
    "angular_velocity": ["twist.angular.z"],
    "linear_acceleration": [f"twist.linear.{axis}" for axis in "xyz"],
}
POINT = {"topic": "/p", "x": "point.x", "y": "point.y", "yaw": "point.z", "sigma": "point.z"}
PLACE = {"topic": "/gps", "latitude": "latitude", "longitude": "longitude", "position_sigma": 0.5}
# Mapping beside that of the tracks, and messages beside theirs.
CASES: dict[str, tuple[dict[str, Any], list[tuple[str, Any]]]] = {
    "latency": (
        {"tracks": JOINTS | {"latency": 0.21}, "imu": {"topic": "/imu", "latency": -0.01}},
        IMU,
    ),
    "units, and a side that counts backward": (
        {"tracks": JOINTS | {"right": ["-r"], "unit": "rpm"}, "imu": {"topic": "/imu"} | UNITS},
        IMU,
    ),
    "odometry with its own gauge": (
        {"tracks": {"topic": "/o", "gauge": 1.1, "scale": 0.95}},
        stream("/o", lambda k, at: made.odometry(at, 1.0, 0.01 * k), 1),
    ),
    "twist": (
        {"tracks": {"topic": "/t"}},
        stream("/t", lambda k, at: twist_stamped(at, 0.5, 0.02 * k), 1),
    ),
    "GPS": ({"fixes": {"topic": "/gps", "position": [0.3, -0.1]}}, GPS),
    "GPS, origin, without a fix": (
        {"fixes": {"topic": "/gps", "origin": [52.0, 13.0, 90.0]}},
        stream("/gps", lambda k, at: gps(at, 1.0 * k, -(k % 2))),
    ),
    "poses with covariance": (
        {"fixes": {"topic": "/pose", "least_sigma": 0.5}},
        stream("/pose", lambda k, at: made.pose_with_covariance(at, (0.01, 0.3, 0.02), x=1.0 * k)),
    ),
    "poses without covariance": (
        {"fixes": {"topic": "/pose", "position_sigma": 0.2}},
        stream("/pose", lambda _, at: made.pose_stamped(at, x=0.1, y=2.0)),
    ),
    "IMU by its fields": (
        {"imu": GYRO | UNITS},
        stream("/gyro", lambda k, at: twist_stamped(at, 0.1, 5.0 * k), 1),
    ),
    "fixes by their fields": (
        {"fixes": POINT | {"heading_sigma": 0.1}},
        stream("/p", lambda k, at: point(at, 0.1 * k)),
    ),
    "GPS by its fields": ({"fixes": PLACE}, GPS),
    "another odometry by its poses": (
        {"velocity": {"topic": "/vo", "sigma": 0.1, "position": [0.3, 0.1], "yaw_deg": 30.0}},
        stream("/vo", lambda k, at: moved(at, 0.01 * k), 1),
    ),
    "another odometry by its twists": (
        {"velocity": {"topic": "/vo", "sigma": 0.1, "latency": 0.06}},
        stream("/vo", lambda k, at: twist_stamped(at, 0.5, 0.02 * k)),
    ),
    "headings": (
        {"heading": {"topic": "/compass", "offset_deg": 90.0}},
        stream("/compass", lambda k, at: made.orientation(at, 0.1 * k)),
    ),
}


def by_stamp(messages: Iterable[tuple[str, Any]]) -> list[tuple[str, Any]]:
    stamps = {id(one): one[1].header.stamp for one in messages}
    return sorted(messages, key=lambda one: (stamps[id(one)].sec, stamps[id(one)].nanosec))


def case(name: str, folder: Path) -> tuple[Path, Robot]:
    """The bag and the robot of a case."""
    log, messages = CASES[name]
    bag = write_bag(folder / "bag", by_stamp(TRACKS + messages), delay=3_000_000)
    return bag, robot_with(**{"tracks": JOINTS} | log)


@pytest.mark.parametrize("name", CASES)
def test_a_live_run_reads_what_a_replay_reads(name: str, tmp_path: Path) -> None:
    assert len(read_alike(*case(name, tmp_path))) >= len(STAMPS)


def test_counters_wrap_and_pause_as_in_a_replay(tmp_path: Path) -> None:
    stream = []
    for k, stamp in enumerate(STAMPS):
        late = 3 * SECOND // 2 if k >= 20 else 0
        positions = 7.0 * k % 100.0, -9.0 * k % 100.0
        stream.append(("/js", joints(stamp + late, (0.0, 0.0), positions=positions)))
    robot = robot_with(tracks=JOINTS | {"unit": "counts", "counts_per_turn": 1e3, "wrap": 100.0})
    bag = write_bag(tmp_path / "bag", stream)
    assert len(read_alike(bag, robot)) == len(STAMPS) - 2


@pytest.mark.parametrize("every", [1, 2])
@pytest.mark.parametrize("unit", ["rad/s", "counts"])
def test_wheels_in_messages_of_their_own_are_interpolated(every, unit, tmp_path: Path) -> None:
    """Wheels 17 ms apart, the right one in each message or in every second one."""
    stream = []
    for k, stamp in enumerate(STAMPS):
        found = [(stamp, "l", 1.0 + 0.5 * k)]
        found += [(stamp + 17_000_000, "r", 2.0 - 0.2 * k)] if k % every == 0 else []
        for when, name, value in found:
            stream.append(("/js", joints(when, (value,), (name,), (7.0 * value % 100.0,))))
    given = {} if unit == "rad/s" else {"unit": unit, "counts_per_turn": 1e3, "wrap": 100.0}
    robot = robot_with(tracks=JOINTS | given)
    bag = write_bag(tmp_path / "bag", stream)
    assert len(read_alike(bag, robot, since=STAMPS[20])) > 15 / every


@pytest.mark.parametrize("kind", ["Float32", "Int16"])
def test_a_topic_of_each_side(kind, tmp_path: Path) -> None:
    """Numbers without a header: the left wheel 17 ms before the right one."""
    stream, times = [], []
    for k, stamp in enumerate(STAMPS):
        for topic, when, value in (
            ("/lwheel", stamp, 50 * k),
            ("/rwheel", stamp + 17_000_000, 90 * k),
        ):
            wrapped = (value + 32768 - 1000) % 65536 - 32768
            stream.append((topic, T[f"std_msgs/msg/{kind}"](wrapped if kind == "Int16" else value)))
            times.append(when)
    counts = {"unit": "counts", "counts_per_turn": 1e3, "wrap": 65536.0} if kind == "Int16" else {}
    sides = {"topic": "/lwheel", "right_topic": "/rwheel", "left": ["data"], "right": ["-data"]}
    robot = robot_with(tracks=sides | counts)
    bag = write_bag(tmp_path / "bag", stream, times=times)
    found = read_alike(bag, robot)
    assert len(found) > 36
    if kind == "Int16":
        radians = 2.0 * np.pi / 1e3 * 20.0
        speeds = [(one.left, one.right) for one in found[2:-2]]
        np.testing.assert_allclose(speeds, 0.5 * radians * np.array([[50.0, -90.0]] * len(speeds)))
    with pytest.raises(
        ReplayError, match=r"topic '/right' for tracks is not in the bag; there is /l"
    ):
        read_log(bag, robot_with(tracks=sides | {"right_topic": "/right"}))


def test_a_wheel_that_pauses_or_a_clock_that_is_set_ends_the_interpolation() -> None:
    inputs, topics = live_inputs(tracks=JOINTS)
    found: list[Measurement] = []
    for k in range(80):
        back = 3600 * SECOND if k >= 60 else 0
        for turn, name in enumerate("lr"):
            if name == "r" and 20 <= k < 40:
                continue
            stamp = T0 + (2 * k + turn) * SECOND // 20 - back
            message = joints(stamp, (1.0,), (name,))
            found += inputs.take(topics["/js"], message.__msgtype__, message, stamp + back)
    stamps = [(one.stamp - T0) / SECOND for one in found]
    assert not [one for one in stamps if 2.0 <= one < 4.0]
    assert [one for one in stamps if 4.2 < one < 5.8]
    assert [one for one in stamps if one < 0.0]


def test_a_wheel_that_never_comes_fills_no_memory() -> None:
    wheels = ApartMessages()
    for k in range(1000):
        assert wheels.take(k * SECOND // 50, np.array([1.0, np.nan]), None) == []
    assert len(wheels._rows) <= 51


def test_fields_of_any_message_are_read(tmp_path: Path) -> None:
    robot = robot_with(
        tracks={"topic": "/drive", "left": ["wheels[0].rate"], "right": ["wheels[1].rate"]}
    )
    bag = made.drive_bag(tmp_path / "bag", made.DRIVES)
    read_alike(bag, robot)


def test_transforms_are_fixes(tmp_path: Path) -> None:
    moving = []
    for k, stamp in enumerate(STAMPS):
        moving.append(made.transform(stamp, "odom", "lidar", 0.1 * k, 0.5, 0.05 * k))
        moving += [made.transform(stamp, "map", "odom", 1.0, 0.5, 0.01 * k)] if k % 4 == 0 else []
    static = [made.transform(T0 - 1, "lidar", "base_link", 0.4, 0.5, np.pi / 2)]
    bag = made.tf_bag(tmp_path / "bag", moving, static, TRACKS)
    robot = robot_with(
        tracks=JOINTS,
        fixes={"topic": "/tf", "frames": ["map", "base_link"]}
        | {"position_sigma": 0.1, "heading_sigma": 0.05},
    )
    found = read_alike(bag, robot)
    assert sum(type(one).__name__ == "HeadingFix" for one in found) == 10


def test_fixes_in_another_frame_are_placed_in_the_map() -> None:
    inputs, subscriptions = live_inputs(
        tracks=JOINTS, fixes={"topic": "/fix", "position_sigma": 0.1}
    )
    inputs.place_of_frame = {"hall": (1.0, 2.0, np.pi / 2)}.__getitem__
    found = []
    for stamp in STAMPS:
        message = made.pose_stamped(stamp, x=3.0, y=0.5)
        message.header.frame_id = "hall"
        found += inputs.take(subscriptions["/fix"], "geometry_msgs/msg/PoseStamped", message, stamp)
    found += inputs.flush(STAMPS[-1] + 10 * SECOND)
    assert len(found) == len(STAMPS)
    np.testing.assert_allclose([(one.x, one.y) for one in found], [(0.5, 5.0)] * len(found))


def test_clocks_that_disagree_are_replaced_by_the_time_of_arrival(tmp_path: Path) -> None:
    robot = robot_with(tracks=JOINTS, imu={"topic": "/imu"})
    since_boot = [("/imu", made.imu(stamp - T0 + 5 * SECOND)) for stamp in STAMPS]
    messages = [pair for both in zip(TRACKS, since_boot, strict=True) for pair in both]
    times = [stamp + off for stamp in STAMPS for off in (0, 1_000_000)]
    bag = write_bag(tmp_path / "bag", messages, times=times)
    assert min(one.stamp for one in read_alike(bag, robot)) >= T0


@pytest.mark.parametrize("offset", [0, -100 * 86_400 * SECOND])
def test_a_busy_start_does_not_cost_the_header_stamps(offset: int) -> None:
    """Messages of the IMU wait for 1.5 s at first, then they come five times as fast; any clock."""
    inputs, topics = live_inputs(tracks=JOINTS, imu={"topic": "/imu"})
    arrivals = [("/js", stamp, message) for stamp, (_, message) in zip(STAMPS, TRACKS, strict=True)]
    for k, stamp in enumerate(STAMPS):
        waited = max(0.0, 1.5 - 0.04 * k)
        arrivals.append(("/imu", stamp + round(waited * SECOND), made.imu(stamp)))
    found: list[Measurement] = []
    for topic, when, message in sorted(arrivals, key=lambda one: one[1]):
        found += inputs.take(topics[topic], message.__msgtype__, message, when + offset)
    found += inputs.flush(STAMPS[-1] + 3 * SECOND + offset)
    assert {choice.clock for choice in inputs.clocks.values()} == {"header"}
    for kind in (TrackSpeeds, ImuSample):
        assert sorted(one.stamp for one in found if isinstance(one, kind)) == STAMPS


def test_clocks_are_chosen_although_a_stream_is_missing() -> None:
    inputs, topics = live_inputs(tracks=JOINTS, imu={"topic": "/imu"})
    tracks = topics["/js"]
    for _, message in TRACKS[:10]:
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        assert inputs.take(tracks, "sensor_msgs/msg/JointState", message, stamp) == []
    assert inputs.flush(STAMPS[9]) == []
    assert len(inputs.flush(STAMPS[0] + 2 * SECOND)) == 10
    _, late = TRACKS[10]
    assert len(inputs.take(tracks, "sensor_msgs/msg/JointState", late, STAMPS[10])) == 1


def test_unusable_messages_are_counted_and_wrong_types_refused() -> None:
    inputs, topics = live_inputs(tracks=JOINTS, imu={"topic": "/imu"}, fixes={"topic": "/gps"})
    fix = gps(T0, 1.0, status=-1)
    assert inputs.take(topics["/gps"], fix.__msgtype__, fix, T0) == []
    short = joints(T0, (1.0,))
    assert inputs.take(topics["/js"], short.__msgtype__, short, T0) == []
    assert inputs.lost == {"fixes: receiver without a fix": 1, "tracks: cannot be read": 1}
    with pytest.raises(ReplayError, match=r"/imu.*sensor_msgs/msg/JointState.*readable are"):
        inputs.take(topics["/imu"], short.__msgtype__, short, T0)


def test_a_robot_without_track_speeds_is_refused() -> None:
    with pytest.raises(ReplayError, match=r"maps no track speeds: add \[log.tracks\]"):
        live_inputs(imu={"topic": "/imu"})


def test_fields_are_converted_to_si(tmp_path: Path) -> None:
    """Axes, units and places of fields of any type, against hand-made figures."""
    readings = read_log(*case("IMU by its fields", tmp_path / "imu")).imu
    assert readings.angular_velocity[3] == pytest.approx((0.0, 0.0, np.radians(15.0)))
    assert readings.linear_acceleration[3] == pytest.approx((0.1 * 9.80665, 0.0, 0.0))
    fixes = read_log(*case("fixes by their fields", tmp_path / "fixes")).fixes
    assert fixes.poses[3] == pytest.approx((0.3, 2.0, 0.3))
    assert fixes.variances[3] == pytest.approx((0.09, 0.01))
