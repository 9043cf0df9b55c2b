from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import bag_messages as made
from bag_messages import JOINTS, SPEEDS, STORE, imu, joints, robot_with, write_bag
from conftest import make_log
from icreckon import ReplayError, Robot, changed_robot, inspect, read_log, write_log
from icreckon.replay.mapping.topics import TrackTopic, topic_map


def test_joint_rates_become_track_speeds_and_other_joints_are_passed_over(tmp_path: Path) -> None:
    arm = [("/js", joints(k * 10**9 + 5, (9.0,), ("elbow",))) for k in range(1, 4)]
    log = read_log(write_bag(tmp_path / "bag", SPEEDS + arm), robot_with(tracks=JOINTS))
    np.testing.assert_array_equal(log.tracks.speeds, [[0.5, 1.0]] * 3)
    np.testing.assert_array_equal(log.tracks.stamps, [10**9, 2 * 10**9, 3 * 10**9])
    assert log.dropped == {}


ODD_NAMES = (
    *("left-wheel", "right/wheel", "left wheel"),
    *("right:wheel", "0_left_wheel", "wheel[right]"),
)


@pytest.mark.parametrize("apart", [False, True], ids=["in one message", "a message for each"])
def test_joints_of_any_name_are_inspected_and_replayed(tmp_path: Path, apart: bool) -> None:
    rates = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    parts = list(zip(rates, ODD_NAMES, strict=True)) if apart else [(rates, ODD_NAMES)]
    messages = [
        ("/js", joints(k * 10**9, np.atleast_1d(values), np.atleast_1d(names).tolist()))
        for k in range(1, 4)
        for values, names in parts
    ]
    bag = write_bag(tmp_path / "bag", messages)
    tracks = inspect(bag).mapping.tracks
    assert tracks == TrackTopic("/js", left=ODD_NAMES[::2], right=ODD_NAMES[1::2])
    log = read_log(bag, robot_with(tracks=structs.asdict(tracks)))
    np.testing.assert_array_equal(log.tracks.speeds, [[1.5, 2.0]] * 3)
    assert log.dropped == {}


def test_wheels_with_messages_of_their_own_are_interpolated(tmp_path: Path) -> None:
    """Both wheels speed up alike, and their messages alternate: paired, the robot would seem to turn."""
    ticks = range(20, 60)
    messages = [
        ("/js", joints(k * 10**8 // 2, (0.1 * k,), ("l" if k % 2 else "r",))) for k in ticks
    ]
    log = read_log(write_bag(tmp_path / "bag", messages), robot_with(tracks=JOINTS))
    assert len(log.tracks.stamps) == 19
    np.testing.assert_allclose(log.tracks.speeds[:, 0], log.tracks.speeds[:, 1])
    np.testing.assert_allclose(log.tracks.speeds[:, 0], 0.5 * 0.1 * log.tracks.stamps / (10**8 / 2))


@pytest.mark.parametrize(("gauge", "half"), [(None, 0.4), (2.0, 1.0)])
@pytest.mark.parametrize("kind", [made.odometry, made.twist_with_covariance])
def test_odometry_becomes_track_speeds(tmp_path: Path, gauge, half, kind) -> None:
    path = write_bag(tmp_path / "bag", [("/odom", kind(7, 1.5, 0.5))])
    mapped = {"topic": "/odom"} | ({"gauge": gauge} if gauge else {})
    log = read_log(path, robot_with(tracks=mapped))
    np.testing.assert_allclose(log.tracks.speeds, [[1.5 - half * 0.5, 1.5 + half * 0.5]])


def test_fixes(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    fixes = [
        ("/fix", made.pose_with_covariance(1, (0.04, 0.09, 0.01), x=1.0, q=(0, 0, half, half))),
        ("/fix", made.pose_with_covariance(2, (0.04, 0.04, 1e6), x=2.0)),
        ("/fix", made.pose_with_covariance(3, (0.04, 0.04, 0.01), x=3.0, q=(0.0, 0.0, 0.0, 0.0))),
        ("/fix", made.pose_with_covariance(4, (-1.0, -1.0, 0.01), x=4.0)),
        ("/fix", made.pose_with_covariance(5, (0.0, 0.0, 0.0), x=5.0)),
        ("/fix", made.pose_with_covariance(6, (0.04, 0.04, 0.01), x=float("nan"))),
        ("/fix", made.pose_with_covariance(2, (0.04, 0.04, 0.01), x=7.0)),
        # As of a GPS receiver: no variance of a yaw is no yaw.
        ("/fix", made.pose_with_covariance(8, (0.04, 0.04, 0.0), x=8.0)),
    ]
    path = write_bag(tmp_path / "bag", [*fixes, *SPEEDS])
    log = read_log(path, robot_with(tracks=JOINTS, fixes={"topic": "/fix"}))
    np.testing.assert_allclose(log.fixes.poses[:, 0], [1.0, 2.0, 3.0, 8.0])
    np.testing.assert_allclose(log.fixes.poses[:, 2], [np.pi / 2, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(log.fixes.variances[:, 0], [0.09, 0.04, 0.04, 0.04])
    assert log.dropped == {
        "fixes: not finite": 1,
        "fixes: no covariance, and no position_sigma given": 1,
        "fixes: variance not positive": 1,
        "fixes: duplicate stamp": 1,
    }


def test_fixes_without_covariance_need_a_sigma(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", [*SPEEDS, ("/fix", made.pose_stamped(1, x=1.0))])
    with pytest.raises(ReplayError, match="position_sigma"):
        read_log(path, robot_with(tracks=JOINTS, fixes={"topic": "/fix"}))
    mapped = {"topic": "/fix", "position_sigma": 0.5}
    log = read_log(path, robot_with(tracks=JOINTS, fixes=mapped))
    assert log.fixes.variances[0, 0] == 0.25
    assert np.isnan(log.fixes.poses[0, 2])
    log = read_log(path, robot_with(tracks=JOINTS, fixes=mapped | {"heading_sigma": 0.1}))
    np.testing.assert_allclose(log.fixes.variances, [[0.25, 0.01]])
    assert log.fixes.poses[0, 2] == 0.0


@pytest.mark.parametrize(
    ("stated", "used"), [((0.04, 0.04, 0.0), (0.04, 0.01)), ((0.0, 0.0, 0.02), (0.25, 0.02))]
)
def test_each_missing_variance_is_filled_in_alone(tmp_path: Path, stated, used) -> None:
    """Zero is unset: a stated position with an unset yaw keeps its heading, and the reverse."""
    fix = made.pose_with_covariance(made.SECOND, stated, q=(0.0, 0.0, 1.0, 0.0))
    path = write_bag(tmp_path / "bag", [*SPEEDS, ("/fix", fix)])
    mapped = {"topic": "/fix", "position_sigma": 0.5, "heading_sigma": 0.1}
    log = read_log(path, robot_with(tracks=JOINTS, fixes=mapped))
    np.testing.assert_allclose(log.fixes.variances, [used])
    assert abs(log.fixes.poses[0, 2]) == pytest.approx(np.pi)


def test_names_of_wheels_in_an_odometry_are_said_to_be_ignored(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", [("/odom", made.odometry(k, 1.5, 0.5)) for k in (7, 8)])
    log = read_log(path, robot_with(tracks=JOINTS | {"topic": "/odom"}))
    assert any("left and right of [log.tracks] are ignored" in note for note in log.notes)


def test_odometry_as_truth(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", [*SPEEDS, ("/odom", made.odometry(made.SECOND, 1.5, 0.5))])
    log = read_log(path, robot_with(tracks=JOINTS, truth={"topic": "/odom", "source": "rail"}))
    np.testing.assert_array_equal(log.truth.twists.twists, [[1.5, 0.0, 0.5]])
    assert log.truth.source == "rail"


def test_bad_samples_are_counted(tmp_path: Path) -> None:
    samples = [
        imu(10**9),
        imu(10**9),
        imu(2 * 10**9, rate=(float("nan"), 0.0, 0.0)),
        imu(3 * 10**9, force=(np.inf, 0.0, 0.0)),
        imu(4 * 10**9),
    ]
    messages = [*SPEEDS, *(("/imu", one) for one in samples)]
    path = write_bag(tmp_path / "bag", messages, raw=[("/imu", 5 * 10**9, b"\0\1\0\0rubbish")])
    log = read_log(path, robot_with(tracks=JOINTS, imu={"topic": "/imu"}))
    assert len(log.imu.stamps) == 2
    reasons = {"cannot be decoded": 1, "not finite": 2, "duplicate stamp": 1}
    assert log.dropped == {f"imu: {reason}": count for reason, count in reasons.items()}


def test_samples_without_what_the_filter_does_not_use_are_kept(tmp_path: Path) -> None:
    nan = float("nan")
    samples = [
        imu(10**9, rate=(nan, 0.0, 0.1)),
        imu(2 * 10**9, rate=(nan, nan, 0.1), force=(nan, 0.0, 9.8)),
        imu(3 * 10**9, rate=(0.0, 0.0, 0.1), force=(nan, nan, nan)),
        imu(4 * 10**9, rate=(0.0, 0.0, 0.1)),
    ]
    path = write_bag(tmp_path / "bag", [*SPEEDS, *(("/imu", one) for one in samples)])
    robot = robot_with(tracks=JOINTS, imu={"topic": "/imu"})
    assert read_log(path, robot).imu.stamps.tolist() == [3 * 10**9, 4 * 10**9]
    log = read_log(path, changed_robot(robot, {"imu.gyro_axes": "z"}))
    assert not log.dropped
    assert log.imu.angular_velocity.tolist() == [[0.0, 0.0, 0.1]] * 4
    assert np.isnan(log.imu.linear_acceleration).any(axis=1).tolist() == [False, True, True, False]


def test_an_imu_that_only_knows_orientation_is_left_out(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [*SPEEDS, ("/imu", imu(1, rate_covariance=-1.0))])
    log = read_log(bag, robot_with(tracks=JOINTS, imu={"topic": "/imu"}))
    assert log.imu is None
    assert "no usable message for imu" in log.notes[0]


def test_an_imu_that_the_robot_file_leaves_out_is_noted(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [*SPEEDS, ("/imu", imu(1)), ("/imu", imu(2))])
    (note,) = read_log(bag, robot_with(tracks=JOINTS)).notes
    assert note.startswith("the log holds an IMU on /imu, which the file leaves out")
    assert 'topic = "/imu" in [log.imu]' in note
    assert read_log(bag, robot_with(tracks=JOINTS, imu={"topic": "/imu"})).notes == ()


def test_a_log_without_mapped_tracks(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [("/imu", imu(1))])
    log = read_log(bag, robot_with(imu={"topic": "/imu"}))
    assert len(log.tracks.stamps) == 0
    assert len(log.imu.stamps) == 1
    assert "no track speeds" in log.notes[0]


def test_a_type_of_ones_own_elsewhere_in_the_bag_does_no_harm(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float64 rate", "our_msgs/msg/Rate"))
    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        own = writer.add_connection("/own", "our_msgs/msg/Rate", typestore=store)
        message = store.types["our_msgs/msg/Rate"](1.0)
        writer.write(own, 1, store.serialize_cdr(message, "our_msgs/msg/Rate"))
        at = writer.add_connection("/js", "sensor_msgs/msg/JointState", typestore=store)
        for _, message in SPEEDS:
            writer.write(at, 1, STORE.serialize_cdr(message, message.__msgtype__))
    assert len(read_log(path, robot_with(tracks=JOINTS)).tracks.stamps) == 3
    with pytest.raises(ReplayError, match="our_msgs/msg/Rate"):
        read_log(path, robot_with(tracks={"topic": "/own"}))


def test_a_misspelt_key_of_the_mapping() -> None:
    for log, part in (
        ({"tracks": JOINTS | {"gage": 1.0}}, "did you mean 'gauge'"),
        ({"track": JOINTS}, "did you mean 'tracks'"),
        ({"tracks": {"topic": "/js", "left": ["l"]}}, "left and right"),
        ({"fixes": {"topic": "/f", "position_sigma": -1.0}}, "positive"),
        ({"imu": {"topic": "/i", "time": "sensor"}}, "time"),
        ({"truth": {"topic": "/t", "tracks": "/tt"}}, "needs the joints"),
        ({"fixes": {"topic": "/f", "wander_sigma": -1.2, "wander_time": 60.0}}, "from 0 to 1000 m"),
        ({"fixes": {"topic": "/f", "wander_sigma": 1.2}}, "needs wander_time"),
        ({"tracks": JOINTS | {"left": ["a", "b"], "unit": "rad", "wrap": 6.3}}, "counter a side"),
    ):
        with pytest.raises(ReplayError, match=part):
            topic_map(robot_with(**log))


def test_a_journal_that_was_not_merged_is_noted(tmp_path: Path, robot: Robot) -> None:
    path = write_log(make_log(), tmp_path / "bag", "sqlite3", robot)
    (path / "bag.db3-wal").write_bytes(b"frames")
    assert "never merged" in read_log(path, robot).notes[0]


ZERO = ("/z", joints(0, (1.0, 2.0)))


@pytest.mark.parametrize(
    ("messages", "log", "said"),
    [
        ([], {"tracks": {"topic": "/js", "left": ["a"], "right": ["b"]}}, "a, b, found were l, r"),
        ([ZERO, ZERO], {"tracks": JOINTS | {"topic": "/z", "time": "header"}}, '"recording"'),
        ([], {"tracks": JOINTS | {"topic": "/w"}}, r"'/w' .* /js \(sensor_msgs/msg/JointState\)"),
        ([], {"tracks": JOINTS, "imu": {"topic": "/js"}}, "'/js' is of type .*JointState'.*Imu"),
    ],
    ids=["other joints", "stamps of zero", "no such topic", "another type"],
)
def test_what_the_bag_has_not_is_refused(tmp_path: Path, messages, log, said) -> None:
    bag = write_bag(tmp_path / "bag", [*SPEEDS, *messages])
    with pytest.raises(ReplayError, match=said):
        read_log(bag, robot_with(**log))


def test_wheels_whose_messages_are_missing_leave_gaps(tmp_path: Path) -> None:
    came = [(k, "l") for k in (1, 2, 3, 4, 20, 21)] + [(k, "r") for k in (1, 3, 4, 12, 21)]
    messages = [("/js", joints(k * 10**8, (k,), (name,))) for k, name in sorted(came)]
    log = read_log(write_bag(tmp_path / "bag", messages), robot_with(tracks=JOINTS))
    assert log.tracks.stamps.tolist() == [k * 10**8 for k in (1, 3, 4, 21)]
    np.testing.assert_allclose(log.tracks.speeds, [[0.5 * k, 0.5 * k] for k in (1, 3, 4, 21)])
