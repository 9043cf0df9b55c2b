from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import bag_messages as made
from conftest import inspected, make_log, sample_log
from icreckon import EstimatorError, Inspection, Log, Robot, Vehicle, inspect, load_robot, write_log
from icreckon.estimator.base.frames import rpy_to_matrix
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.estimates.imu_mounting import estimate_mounting
from icreckon.replay.mapping.naming import PLACEHOLDER_SIGMA
from icreckon.replay.mapping.topics import TopicMap, topic_map


def proposed(inspection: Inspection, folder: Path) -> tuple[Robot, TopicMap]:
    """The proposed robot file, completed and read as any robot file."""
    path = folder / "proposed.toml"
    path.write_text(inspection.proposed_robot_file, encoding="utf-8")
    if "nan" in inspection.proposed_robot_file:
        with pytest.raises(EstimatorError, match="not filled in"):
            load_robot(path)
    completed = inspection.proposed_robot_file.replace("= nan", "= 1.0")
    path.write_text(completed, encoding="utf-8")
    robot = load_robot(path)
    return robot, topic_map(robot)


@cache
def driven_log(rpy_deg: tuple[float, float, float], z_only: bool = False) -> Log:
    """A drive of bends, stops and starts, seen by an IMU that is mounted like this."""
    rng = np.random.default_rng(2)
    seconds = np.arange(0.0, 120.0, 0.02)
    stamps = (seconds * 1e9).astype(np.int64) + 10**9
    driving = np.where(seconds % 30.0 < 20.0, 1.0, 0.0)
    gentle = np.convolve(driving, np.ones(50) / 50, "same")
    speed = gentle * (0.8 + 0.5 * np.sin(0.9 * seconds))
    rate = gentle * 0.7 * np.sin(0.4 * seconds)
    forces = np.column_stack(
        [np.gradient(speed, seconds), speed * rate, np.full_like(seconds, 9.81)]
    )
    rates = np.column_stack([0.0 * rate, 0.0 * rate, rate])
    rotation = rpy_to_matrix(*np.radians(rpy_deg))
    noise = rng.normal(0.0, 0.002, rates.shape)
    angular = rates @ rotation + noise + [0.001, -0.002, 0.003]
    if z_only:
        angular[:, :2] = 0.0
    return Log(
        "driven",
        TrackSpeedSeries(
            stamps,
            np.where(driving + gentle > 0, 1.0, 0.0)[:, None]
            * np.column_stack([speed - 0.3 * rate, speed + 0.3 * rate]),
        ),
        ImuSeries(stamps, angular, forces @ rotation + rng.normal(0.0, 0.1, forces.shape)),
    )


@pytest.mark.parametrize("rpy_deg", [(180.0, 12.0, 0.0), (90.0, 0.0, -90.0), (2.0, -5.0, 90.0)])
def test_the_mounting_is_found(rpy_deg: tuple[float, float, float]) -> None:
    mounting = estimate_mounting(driven_log(rpy_deg))
    found = rpy_to_matrix(*np.radians(mounting.rotation_rpy_deg))
    wanted = rpy_to_matrix(*np.radians(rpy_deg))
    off = np.degrees(np.arccos((np.trace(found @ wanted.T) - 1.0) / 2.0))
    assert off < 2.0
    assert mounting.yaw_shown_by == "tracks"
    assert mounting.turning_correlation > 0.9
    assert 30.0 < mounting.still_seconds < 40.0
    np.testing.assert_allclose(mounting.gyro_bias, [0.001, -0.002, 0.003], atol=3e-4)
    assert mounting.gyro_noise_density == pytest.approx(0.002 * np.sqrt(0.02), rel=0.15)
    assert mounting.accelerometer_noise_density == pytest.approx(0.1 * np.sqrt(0.02), rel=0.2)


def without_accelerometers(log: Log) -> Log:
    return replace(log, imu=replace(log.imu, linear_acceleration=None))


@pytest.mark.parametrize("rpy_deg", [(180.0, 12.0, 0.0), (90.0, 0.0, 0.0)])
def test_turning_shows_the_mounting_of_a_gyro_alone(rpy_deg: tuple[float, float, float]) -> None:
    mounting = estimate_mounting(without_accelerometers(driven_log(rpy_deg)))
    assert (mounting.up_shown_by, mounting.yaw_shown_by) == ("turning", "")
    assert mounting.specific_force is None
    found = rpy_to_matrix(*np.radians(mounting.rotation_rpy_deg))[2]
    wanted = rpy_to_matrix(*np.radians(rpy_deg))[2]
    assert np.degrees(np.arccos(min(1.0, found @ wanted))) < 0.5
    np.testing.assert_allclose(mounting.gyro_bias, [0.001, -0.002, 0.003], atol=3e-4)
    assert mounting.gyro_noise_density == pytest.approx(0.002 * np.sqrt(0.02), rel=0.15)
    assert mounting.accelerometer_noise_density is None


def test_a_gyro_alone_that_hardly_turns_is_taken_as_upright() -> None:
    log = without_accelerometers(driven_log((90.0, 0.0, 0.0)))
    straight = np.repeat(log.tracks.speeds.mean(axis=1)[:, None], 2, axis=1)
    for tracks in (straight, straight[:1], 1e9 * log.tracks.speeds):
        stamps = log.tracks.stamps[: len(tracks)]
        mounting = estimate_mounting(replace(log, tracks=TrackSpeedSeries(stamps, tracks)))
        assert (mounting.up_shown_by, mounting.rotation_rpy_deg) == ("", (0.0, 0.0, 0.0))


def test_a_table_with_a_gyro_alone(tmp_path: Path) -> None:
    log = driven_log((180.0, 0.0, 0.0), z_only=True)
    there = np.arange(len(log.imu.stamps)) % 2000 < 1800
    seconds = (log.imu.stamps - log.imu.stamps[0]) * 1e-9
    places = np.where(np.arange(len(seconds)) % 50 == 0, seconds, np.nan)
    table = np.column_stack([seconds, log.tracks.speeds, log.imu.angular_velocity[:, 2], places])
    path = tmp_path / "run.csv"
    head = "time,v_left,v_right,gyro_z,place"
    lines = [
        ",".join("" if np.isnan(one) else repr(one) for one in row) for row in table[there].tolist()
    ]
    path.write_text("\n".join([head, *lines]), encoding="utf-8")
    found = inspect(path)
    assert found.mounting.up_shown_by == "turning"
    reports = {report.topic: report for report in found.topics}
    for name in ("time", "v_left", "gyro_z"):
        assert reports[name].mean_rate == pytest.approx(50.0, rel=0.01)
        assert (reports[name].gaps, reports[name].largest_gap) == (2, pytest.approx(4.02))
    assert reports["place"].mean_rate == pytest.approx(1.0, abs=0.05)
    text = found.proposed_robot_file
    assert "about which the gyro turns as the tracks do (correlation 1.00)" in text
    robot, _ = proposed(found, tmp_path)
    assert abs(robot.imu.rotation_rpy_deg[0]) == 180.0
    assert robot.vehicle.track_gauge == pytest.approx(0.6, rel=0.02)
    # The bias of the z axis, seen from below.
    assert robot.imu.gyro_bias == pytest.approx(-0.003, abs=3e-4)


def test_a_made_bag(tmp_path: Path, robot: Robot) -> None:
    path = write_log(make_log(), tmp_path / "bag", "mcap", robot)
    found = inspect(path)
    by_name = {report.topic: report for report in found.topics}
    assert list(by_name) == sorted(by_name)
    imu = by_name["/imu/data_raw"]
    assert (imu.msgtype, imu.frame_id, imu.count) == ("sensor_msgs/msg/Imu", "imu_link", 400)
    assert imu.mean_rate == pytest.approx(100.0, rel=1e-3)
    assert imu.largest_gap == pytest.approx(0.01, rel=1e-3)
    assert imu.clock_offset == 0.0
    assert by_name["/joint_states"].repeated_share == 0.0
    assert found.duration == pytest.approx(4.0, abs=0.05)
    _, topics = proposed(found, tmp_path)
    assert topics == topic_map(robot)


def test_a_bag_with_nothing_of_use(tmp_path: Path) -> None:
    mapped = Robot(
        "x", Vehicle(1.0, 1.0, 1.0), log={"tracks": {"topic": "/j", "left": ["a"], "right": ["b"]}}
    )
    log = Log("x", make_log().tracks)
    found = inspect(write_log(log, tmp_path / 'odd "name" \\ here', "mcap", mapped))
    assert found.mapping == TopicMap()
    assert "no track speeds" in found.proposed_robot_file
    robot, _ = proposed(found, tmp_path)
    assert robot.name == 'odd "name" \\ here'


def test_a_bag_without_messages_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReplayError, match="no topic has a message"):
        inspect(made.write_bag(tmp_path / "bag", []))


def test_static_transforms_give_positions_and_what_the_log_does_not_show(tmp_path: Path) -> None:
    """The IMU by way of its plate; the antenna on gps; a contradiction by gravity is a finding."""
    seconds = [made.SECOND * k // 50 for k in range(50, 200)]
    samples = [("/imu", made.imu(stamp, frame="imu_link")) for stamp in seconds]
    samples += [("/js", made.joints(stamp, (1.0, 1.2))) for stamp in seconds]
    samples += [("/gps/fix", made.navsatfix(stamp, 48.0, 11.0)) for stamp in seconds[::25]]

    def with_frames(
        name: str, frames: tuple[str, str] = ("map", "world"), **turn: object
    ) -> tuple[Inspection, Robot, TopicMap]:
        static = [
            made.transform(made.SECOND, "base_link", "plate", x=0.1, yaw=np.radians(30.0)),
            made.transform(made.SECOND, "plate", "imu_link", y=0.2, **turn),
            made.transform(made.SECOND, "/base_link", "gps", x=-0.2, y=0.1),
            made.transform(made.SECOND, *frames),
        ]
        found = inspect(made.tf_bag(tmp_path / name, [], static, samples))
        return found, *proposed(found, tmp_path)

    found, robot, topics = with_frames("level")
    assert robot.imu.rotation_rpy_deg == (0.0, 0.0, 30.0)
    assert robot.imu.position == pytest.approx((0.0, 0.173, 0.0))
    assert (topics.fixes.topic, topics.fixes.position) == ("/gps/fix", (-0.2, 0.1, 0.0))
    assert not any("see [imu]" in finding for finding in found.findings)
    found, robot, _ = with_frames("loop", frames=("imu_link", "base_link"))
    assert robot.imu.position == (0.0, 0.0, 0.0)
    assert "imu: no chain of /tf_static leads to its frame 'imu_link'" in found.findings
    found, robot, _ = with_frames("upside_down", q=(1.0, 0.0, 0.0, 0.0))
    assert robot.imu.rotation_rpy_deg == (0.0, 0.0, 0.0)
    (said,) = [finding for finding in found.findings if "see [imu]" in finding]
    assert "imu_link in base_link by /tf_static is turned by (180, 0, 30) deg; the log" in said


def test_fixes_without_a_usable_variance_cost_nothing_else(tmp_path: Path) -> None:
    stamps = [made.SECOND * k // 50 for k in range(50, 200)]
    samples = [("/imu", made.imu(stamp)) for stamp in stamps]
    samples += [("/js", made.joints(stamp, (1.0, 1.2))) for stamp in stamps]
    unknown = float("nan"), float("nan")
    samples += [("/fix", made.navsatfix(at, 48.0, 11.0, variances=unknown)) for at in stamps[::25]]
    found = inspect(made.write_bag(tmp_path / "bag", samples))
    assert found.mounting is not None
    assert found.mapping.fixes.position_sigma == PLACEHOLDER_SIGMA
    assert "position_sigma = 0.05    # not in the log: fill in" in found.proposed_robot_file


def test_positions_that_are_not_used_are_named(tmp_path: Path) -> None:
    stamps = [made.SECOND * k for k in (1, 2, 3)]
    messages = [*made.SPEEDS]
    messages += [("/initialpose", made.pose_with_covariance(stamps[0], (0.2, 0.2, 0.1)))]
    messages += [("/gps/fix", made.navsatfix(stamp, 48.0, 11.0)) for stamp in stamps]
    messages += [("/slam", made.pose_stamped(stamp)) for stamp in stamps]
    found = inspect(made.write_bag(tmp_path / "bag", messages))
    assert found.mapping.fixes.topic == "/slam"
    (said,) = [finding for finding in found.findings if "not used" in finding]
    assert "not used: /gps/fix;" in said


# name: roll, pitch, yaw [deg]; gyro axes; topic of the track speeds; standstill that shows the bias
EXPECTED = {
    "husky_deflated_part1": ((-1, 0, 180), "z", "/joint_states", False),
    "husky_test1.bag": ((90, 1, -90), "xyz", "/husky_velocity_controller/odom", True),
    "jackal_test2.bag": ((-1, 0, 0), "xyz", "/jackal_velocity_controller/odom", False),
    "marmotte_part1": ((180, 13, 0), "z", "/joint_states", False),
    "warthog_asphalt_2024_9_25_12h8s57": ((0, 3, 0), "xyz", "/joint_states", True),
    "warthog_grass_2024_8_8_15h56s39": ((-1, 1, 0), "xyz", "/joint_states", True),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_sample_logs(data_dir: Path, tmp_path: Path, name: str) -> None:
    rpy_deg, gyro_axes, tracks, stood = EXPECTED[name]
    found = inspected(sample_log(data_dir, name))
    robot, topics = proposed(found, tmp_path)
    np.testing.assert_allclose(robot.imu.rotation_rpy_deg, rpy_deg, atol=1.0)
    assert robot.imu.gyro_axes == gyro_axes
    assert topics.tracks.topic == tracks
    assert found.mounting.turning_correlation > 0.5
    assert (found.mounting.gyro_bias is not None) == stood
    assert "not in the log: fill in" in found.proposed_robot_file


def test_wetexplorer(data_dir: Path, tmp_path: Path) -> None:
    found = inspected(sample_log(data_dir, "wetexplorer_2024-07-05-13-33-58.bag"))
    robot, topics = proposed(found, tmp_path)
    assert topics.tracks is None
    assert topics.imu.topic == "/imu/data_raw"
    assert abs(abs(robot.imu.rotation_rpy_deg[0]) - 180.0) < 2.0
    assert "no track speeds" in found.proposed_robot_file
    assert (topics.fixes.topic, topics.fixes.time) == ("/gps/fix", "recording")
    assert "19.0 days" in found.proposed_robot_file
    assert any(said.startswith("fixes: time of recording; ") for said in found.findings)
    assert any(said.startswith("imu: header stamps; ") for said in found.findings)
    assert topics.heading.topic == "/gps/navheading"
    # The README beside the logs: driving direction = heading - 90 degrees.
    assert topics.heading.offset_deg == pytest.approx(-90.0, abs=5.0)
    offsets = {report.topic: report.clock_offset for report in found.topics}
    assert offsets["/gps/fix"] > 18 * 86400
    assert abs(offsets["/gps/navheading"]) < 0.1
