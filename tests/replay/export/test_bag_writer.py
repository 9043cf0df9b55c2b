from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

import icreckon
from bag_messages import mcap_messages
from conftest import make_log
from icreckon import ImuSeries, Log, ReplayError, Robot, Vehicle, load_robot, read_log
from icreckon.estimator.base.frames import wrap_angle
from icreckon.replay.bags.writer import Format
from icreckon.replay.export.log_bag import check_place, write_log
from icreckon.replay.export.replay_bag import write_replay_bag
from icreckon.replay.mapping.topics import DEFAULT_TOPICS

FORMATS = ["mcap", "sqlite3", "ros1"]


def assert_same(found: Log, written: Log, radius: float) -> None:
    """Bit for bit, but for what a sprocket radius and a quaternion round."""
    same = np.testing.assert_array_equal
    for one, other in ((found.tracks, written.tracks), (found.truth.tracks, written.truth.tracks)):
        same(one.stamps, other.stamps)
        same(one.speeds, other.speeds / radius * radius)
    for one, other in ((found.fixes, written.fixes), (found.truth.poses, written.truth.poses)):
        same(one.stamps, other.stamps)
        same(one.poses[:, :2], other.poses[:, :2])
        same(np.isnan(one.poses[:, 2]), np.isnan(other.poses[:, 2]))
        assert np.nanmax(np.abs(wrap_angle(one.poses[:, 2] - other.poses[:, 2]))) < 1e-14
    same(found.imu.stamps, written.imu.stamps)
    same(found.imu.angular_velocity, written.imu.angular_velocity)
    same(found.imu.linear_acceleration, written.imu.linear_acceleration)
    same(found.fixes.variances, written.fixes.variances)
    same(found.truth.twists.stamps, written.truth.twists.stamps)
    same(found.truth.twists.twists, written.truth.twists.twists)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("name", ["auriga-alpha", "jackal", "marmotte", "warthog", "wetexplorer"])
def test_a_log_comes_back_as_it_was_written(tmp_path: Path, form, name) -> None:
    # The longest has more IMU samples than are in memory at once.
    robot, log = load_robot(name), make_log(12.0 if name == "auriga-alpha" else 1.0)
    path = write_log(log, tmp_path / "bag", form, robot)
    found = read_log(path, robot)
    assert path.name == ("bag.bag" if form == "ros1" else "bag")
    assert found.name == "bag"
    assert found.dropped == {}
    assert_same(found, log, robot.vehicle.sprocket_radius)
    assert found.truth.source == log.truth.source
    own = "topics as the bag itself names them (/icreckon/topics), not as the robot file does"
    assert found.notes == (() if name == "auriga-alpha" else (own,))


@pytest.mark.parametrize("name", ["auriga-alpha", "warthog"])
def test_fixes_of_an_antenna_come_back_as_such(tmp_path: Path, name: str) -> None:
    robot, log = load_robot(name), make_log(1.0)
    antennas = np.tile([0.4, -0.1, 0.3], (len(log.fixes.stamps), 1))
    log = replace(log, fixes=replace(log.fixes, antennas=antennas))
    found = read_log(write_log(log, tmp_path / "bag", "mcap", robot), robot)
    np.testing.assert_array_equal(found.fixes.lever_arms, antennas)
    antennas = antennas + np.arange(len(antennas))[:, None]
    several = replace(log, fixes=replace(log.fixes, antennas=antennas))
    with pytest.raises(ReplayError, match="a bag holds fixes of one"):
        write_log(several, tmp_path / "several", "mcap", robot)
    assert not (tmp_path / "several").exists()


def test_an_imu_without_accelerometer(tmp_path: Path, robot: Robot) -> None:
    log = make_log(1.0)
    log = replace(log, imu=ImuSeries(log.imu.stamps, log.imu.angular_velocity))
    found = read_log(write_log(log, tmp_path / "bag", "mcap", robot), robot)
    assert_same(found, log, robot.vehicle.sprocket_radius)


def test_a_log_without_imu_fixes_and_truth(tmp_path: Path, robot: Robot) -> None:
    log = replace(make_log(1.0), imu=None, fixes=None, truth=None)
    found = read_log(write_log(log, tmp_path / "bag", "mcap", robot), robot)
    assert found.imu is found.fixes is found.truth is None
    # Each stream that the robot's mapping names and the bag has not.
    missing = [note.partition(" for ")[2].split()[0] for note in found.notes]
    assert missing == ["imu", "fixes", "truth"]


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_what_comes_once_is_latched(kind: Format, tmp_path: Path) -> None:
    log = icreckon.simulate(icreckon.Scenario(duration=3.0), ROBOT)
    bags = [write_log(log, tmp_path / "log", kind, ROBOT)]
    if kind != "sqlite3":
        bags.append(tmp_path / ("odometry.mcap" if kind == "mcap" else "odometry.bag"))
        write_replay_bag(bags[1], kind, icreckon.compare(log, ROBOT, "gyro"), ROBOT)
    latched, others = set(), set()
    for bag in bags:
        with AnyReader([bag]) as reader:
            for one in reader.connections:
                if kind == "ros1":
                    is_latched = bool(one.ext.latching)
                else:
                    durabilities = {profile.durability for profile in one.ext.offered_qos_profiles}
                    is_latched = durabilities == {QosDurability.TRANSIENT_LOCAL}
                (latched if is_latched else others).add(one.topic)
    assert latched == {topic for topic in ONCE if kind != "sqlite3" or "path" not in topic}
    assert {"/imu/data", "/joint_states"} <= others


def test_several_joints_on_a_side(tmp_path: Path) -> None:
    robot = Robot(
        "four-wheels",
        Vehicle(1.0, 1.0, 0.25),
        log={"tracks": {"topic": "/js", "left": ["fl", "rl"], "right": ["fr", "rr"]}},
    )
    log = Log("made", make_log().tracks)
    found = read_log(write_log(log, tmp_path / "bag", "mcap", robot), robot)
    np.testing.assert_array_equal(found.tracks.speeds, log.tracks.speeds)


def test_a_mapping_in_the_bag_names_only_what_the_log_has(tmp_path: Path) -> None:
    robot = Robot("bare", Vehicle(1.0, 1.0, 0.1))
    log = replace(make_log(1.0), fixes=None, truth=None)
    path = write_log(log, tmp_path / "bag", "mcap", robot)
    assert len(read_log(path, robot).notes) == 1
    explicit = read_log(path, robot, topics=DEFAULT_TOPICS)
    np.testing.assert_array_equal(explicit.imu.stamps, log.imu.stamps)
    assert not [note for note in explicit.notes if "/icreckon/topics" in note.split(";")[0]]


def test_a_file_that_is_no_bag_is_never_replaced(tmp_path: Path, robot: Robot) -> None:
    precious = tmp_path / "afile"
    precious.write_text("a\n")
    for write in (check_place, partial(write_log, make_log(1.0))):
        with pytest.raises(ReplayError, match="that icreckon did not write"):
            write(precious, "mcap", robot, overwrite=True)
    assert precious.read_text() == "a\n"
    for form, name in (("mcap", "one.mcap"), ("sqlite3", "one.db3"), ("ros1", "one.bag")):
        path = tmp_path / name
        path.touch()
        for seconds in (1.0, 2.0):
            write_log(make_log(seconds), path, form, robot, overwrite=True)
            assert len(read_log(path, robot).tracks.stamps) == 50 * seconds


@pytest.mark.parametrize("name", ["bag", "bag.mcap", "bag.db3", "bag.bag"])
def test_only_own_bags_are_replaced(name: str, tmp_path: Path, robot: Robot) -> None:
    """A recording of somebody else's is refused, a bag of ten thousand messages is known again."""
    path = tmp_path / name
    kinds = {".db3": "sqlite3", ".bag": "ros1"}
    kind = kinds.get(path.suffix, "mcap")
    write_log(make_log(50.0), path, kind, robot)
    check_place(path, kind, robot, overwrite=True)
    for file in path.iterdir() if path.is_dir() else [path]:
        file.write_bytes(file.read_bytes().replace(b"written_by_icreckon", b"x" * 19))
    for write in (check_place, partial(write_log, make_log(1.0))):
        with pytest.raises(ReplayError, match="that icreckon did not write"):
            write(path, kind, robot, overwrite=True)
    assert path.exists()


def test_what_cannot_be_written_is_refused_beforehand(tmp_path: Path, robot: Robot) -> None:
    check_place(tmp_path / "run", "ros1", robot)
    write_log(make_log(1.0), tmp_path / "run", "ros1", robot)
    with pytest.raises(ReplayError, match=r"run\.bag exists already; give --overwrite"):
        check_place(tmp_path / "run", "ros1", robot)
    bad = Robot("bad", Vehicle(1.0, 1.0, 0.1), log={"tracks": {"topik": "/js"}})
    with pytest.raises(ReplayError, match="did you mean 'topic'"):
        check_place(tmp_path / "other", "mcap", bad)


def test_the_official_reader_finds_standard_messages(tmp_path: Path, robot: Robot) -> None:
    log = make_log()
    path = write_log(log, tmp_path / "bag", "mcap", robot)
    rows = mcap_messages(path / "bag.mcap")
    ((_, _, source),) = rows.pop("/ground_truth/source")
    assert source.data == log.truth.source
    for _, time, decoded in (one for found in rows.values() for one in found):
        assert decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec == time
    assert {(topic, found[0][0]): len(found) for topic, found in rows.items()} == {
        ("/joint_states", "sensor_msgs/msg/JointState"): len(log.tracks.stamps),
        ("/imu/data_raw", "sensor_msgs/msg/Imu"): len(log.imu.stamps),
        ("/fix/pose", "geometry_msgs/msg/PoseWithCovarianceStamped"): len(log.fixes.stamps),
        ("/ground_truth/pose", "geometry_msgs/msg/PoseStamped"): len(log.truth.poses.stamps),
        ("/ground_truth/twist", "geometry_msgs/msg/TwistStamped"): len(log.truth.twists.stamps),
        ("/ground_truth/joint_states", "sensor_msgs/msg/JointState"): len(log.truth.tracks.stamps),
    }
    _, _, joints = rows["/joint_states"][3]
    assert joints.name == ["left_track_joint", "right_track_joint"]
    radius = robot.vehicle.sprocket_radius
    np.testing.assert_array_equal(joints.velocity, log.tracks.speeds[3] / radius)
    _, _, imu = rows["/imu/data_raw"][5]
    assert imu.header.frame_id == "imu_link"
    assert imu.orientation_covariance[0] == -1
    assert imu.linear_acceleration.z == log.imu.linear_acceleration[5, 2]
    _, _, fix = rows["/fix/pose"][0]
    assert fix.header.frame_id == "odom"
    covariance = np.reshape(fix.pose.covariance, (6, 6))
    np.testing.assert_array_equal(covariance, np.diag(np.diag(covariance)))
    assert covariance[5, 5] == 1e6
    assert np.isfinite(covariance).all()


ROBOT = icreckon.load_robot("jackal")
ONCE = {"/icreckon/topics", "/ground_truth/source", "/gyro/path", "/ground_truth/path"}
