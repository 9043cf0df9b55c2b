"""Logs with names, units and signs that the package did not choose."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from test_robot_messages import (
    LEFT,
    RADIUS,
    RIGHT,
    SECONDS,
    SPEED,
    START,
    STEP,
    TRACK,
    TURN,
    YAW,
    X,
    Y,
)

from bag_messages import T, imu, joints, odometry, pose_stamped, robot_with, write_bag
from icreckon import ReplayError, check_robot, inspect, load_robot, read_log, write_log
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.replay.checking.check import SCALE
from icreckon.replay.estimates.imu_mounting import standstill
from icreckon.replay.inspection.filled_in import filled_in_sizes, with_filled_in
from icreckon.replay.mapping.topics import topic_map
from icreckon.replay.reading.tables import are_parts

NAMES = ("mast", "m3", "m1", "m4", "m2")


def slam(k: int):
    q = (0.0, 0.0, float(np.sin(YAW[k] / 2)), float(np.cos(YAW[k] / 2)))
    return "/slam", pose_stamped(START + k * STEP, x=float(X[k]), y=float(Y[k]), q=q)


def bag(path: Path, *, sign: float = 1.0, rate: float = 1.0, force: float = 1.0) -> Path:
    """Four wheels under names that show no side, an IMU, and the true poses."""
    messages = []
    for k in range(len(SECONDS)):
        stamp = START + k * STEP
        wheels = (0.0, RIGHT[k], LEFT[k], sign * RIGHT[k], LEFT[k])
        turn, up = (0.0, 0.0, rate * TURN[k]), (0.0, force * SPEED[k] * TURN[k], force * 9.80665)
        messages += [("/motors", joints(stamp, wheels, NAMES)), ("/imu", imu(stamp, turn, up))]
        messages.append(slam(k))
    return write_bag(path, messages)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag(tmp_path_factory.mktemp("plain") / "bag")


def proposed_with(log: Path, robot: Path) -> dict:
    """A second proposal, with what a person filled in."""
    text = inspect(log, sizes=filled_in_sizes(robot)).proposed_robot_file
    return tomllib.loads(with_filled_in(text, robot)[0])


WHEELS = """
[log.tracks]
topic = "/motors"
left = ["m1", "m2"]
right = ["m3", "m4"]
"""


def test_streams_that_were_filled_in_are_those_that_are_inspected(
    plain: Path, tmp_path: Path
) -> None:
    robot, first = tmp_path / "robot.toml", inspect(plain)
    assert np.isnan(tomllib.loads(first.proposed_robot_file)["vehicle"]["sprocket_radius"])
    text = first.proposed_robot_file.replace("[log.fixes]", "[log.truth]")
    text = text.replace("track_gauge = nan", "track_gauge = 0.6")
    text = text.replace("position_sigma = 0.05", "# ")
    robot.write_text(text + WHEELS, encoding="utf-8")
    found = proposed_with(plain, robot)
    assert found["vehicle"]["sprocket_radius"] == pytest.approx(RADIUS, rel=0.01)
    assert found["indices"]["eta0"] == pytest.approx(TRACK / 0.6, rel=0.01)
    assert found["vehicle"]["track_gauge"] == 0.6
    assert found["log"]["truth"] == {"topic": "/slam"}
    assert "fixes" not in found["log"]


@pytest.mark.parametrize(
    ("rate_unit", "acceleration_unit", "factor"), [("deg/s", "g", 1.0), ("mdps", "mg", 1e3)]
)
def test_an_imu_message_in_other_units(
    tmp_path: Path, rate_unit, acceleration_unit, factor
) -> None:
    log = bag(tmp_path / "bag", rate=factor * 180.0 / np.pi, force=factor / 9.80665)
    found = inspect(log)
    units = {"rate_unit": rate_unit, "acceleration_unit": acceleration_unit}
    assert tomllib.loads(found.proposed_robot_file)["log"]["imu"] == {"topic": "/imu", **units}
    assert not [text for text in found.findings if "suspicious" in text]
    tracks = tomllib.loads(WHEELS)["log"]["tracks"]
    read = read_log(log, robot_with(tracks=tracks, imu={"topic": "/imu", **units})).imu
    np.testing.assert_allclose(read.angular_velocity[:, 2], TURN, atol=1e-12)
    np.testing.assert_allclose(read.linear_acceleration[:, 2], 9.80665)


def test_a_wheel_that_counts_backward_is_named_with_a_minus(tmp_path: Path) -> None:
    log = bag(tmp_path / "bag", sign=-1.0)
    assert "joints here are mast, m3, m1, m4, m2" in str(inspect(log).findings)
    as_it_is = tomllib.loads(WHEELS)["log"]["tracks"]
    read = read_log(log, robot_with(tracks=as_it_is))
    assert 'turn opposite ways: name a reversed one "-m4"' in str(read.notes)
    corrected = as_it_is | {"right": ["m3", "-m4"]}
    read = read_log(log, robot_with(tracks=corrected))
    np.testing.assert_allclose(read.tracks.speeds, 0.5 * np.column_stack([LEFT, RIGHT]))
    written = write_log(read, tmp_path / "written", "mcap", robot_with(tracks=corrected))
    again = read_log(written, robot_with(tracks=corrected))
    np.testing.assert_allclose(again.tracks.speeds, read.tracks.speeds)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_side_that_counts_backward_is_found(plain: Path, side: str) -> None:
    tracks = {"topic": "/motors", "left": ["m1"], "right": ["m3"]}
    tracks[side] = ["-m1" if side == "left" else "-m3"]
    robot = robot_with(tracks=tracks, imu={"topic": "/imu"}, truth={"topic": "/slam"})
    checks = check_robot(read_log(plain, robot), robot)
    found = next(one for one in checks if one.name == "sense of turning")
    assert found.problem.startswith(f"the {side} side counts backward")
    assert f"minus before the names of {side}" in found.remedy


def test_a_clock_set_back_takes_the_truth_with_it(tmp_path: Path) -> None:
    """The same 6 s of the recorder's clock hold two parts of the drive, of the truth as well."""
    messages = []
    for k in range(len(SECONDS)):
        stamp = START + (k if k < 600 else k - 120) * STEP
        messages.append(("/motors", joints(stamp, (LEFT[k], RIGHT[k]))))
        messages.append(("/imu", imu(stamp, (0.0, 0.0, TURN[k]))))
        messages.append(("/slam", pose_stamped(stamp, x=float(k))))
    tracks = {"topic": "/motors", "left": ["l"], "right": ["r"]}
    robot = robot_with(tracks=tracks, imu={"topic": "/imu"}, truth={"topic": "/slam"})
    messages.sort(key=lambda one: (one[1].header.stamp.sec, one[1].header.stamp.nanosec))
    log = read_log(write_bag(tmp_path / "bag", messages), robot)
    assert (np.diff(log.truth.poses.poses[:, 0]) > 0.0).all()
    assert log.dropped["truth: of a time that occurs twice"] >= 240


def table(path: Path, names: str, *, ticks: bool = False) -> Path:
    """German numbers: ms; rpm or counts of 16 bits; deg/s; g; m and deg of the truth."""
    none = np.zeros_like(SECONDS)
    wheels = [60.0 / (2.0 * np.pi) * one for one in (LEFT, RIGHT)]
    if ticks:
        turns = [np.cumsum(one) * 0.05 / (2.0 * np.pi) for one in (LEFT, RIGHT)]
        wheels = [np.floor(8192.0 * one) % 65536.0 - 32768.0 for one in turns]
    forces = [none, SPEED * TURN / 9.80665, none + 1.0]
    columns = [1e3 * SECONDS, *wheels, none, none, np.degrees(TURN), *forces, X, Y, np.degrees(YAW)]
    rows = (";".join(f"{one:.6f}" for one in row) for row in np.column_stack(columns))
    path.write_text("\n".join([names, *(row.replace(".", ",") for row in rows)]), encoding="utf-8")
    return path


GYRO, FORCE = "gyro x [°/s];gyro y [°/s];gyro z [°/s]", "acc x [g];acc y [g];acc z [g]"
REST = f"{GYRO};{FORCE};true x [m];true y [m];true yaw [°]"


def test_names_with_units_in_brackets(tmp_path: Path) -> None:
    names = f"Time [ms];left speed [U/min];right speed [U/min];{REST}"
    path, robot = table(tmp_path / "own.csv", names), tmp_path / "robot.toml"
    found = inspect(path)
    assert {(one.frame_id, one.count) for one in found.topics} == {("own.csv", len(SECONDS))}
    assert found.duration == pytest.approx(59.95)
    proposed = tomllib.loads(found.proposed_robot_file)
    columns = proposed["log"]["columns"]
    assert (columns["time"], columns["time_unit"]) == ("Time [ms]", "ms")
    assert columns["tracks"]["unit"] == "rpm"
    assert (columns["imu"]["rate_unit"], columns["imu"]["acceleration_unit"]) == ("deg/s", "g")
    assert (columns["truth"]["yaw"], columns["truth"]["yaw_unit"]) == ("true yaw [°]", "deg")
    assert proposed["vehicle"]["sprocket_radius"] == pytest.approx(RADIUS, rel=0.01)
    assert proposed["vehicle"]["track_gauge"] == pytest.approx(TRACK, rel=0.01)
    robot.write_text(found.proposed_robot_file.replace("= nan", "= 1.0"), "utf-8")
    log = read_log(path, load_robot(robot))
    assert len(log.tracks.stamps) == len(log.imu.stamps) == len(log.truth.poses.stamps)


def test_a_yaw_in_degrees_is_known_by_its_jumps(tmp_path: Path) -> None:
    """Or refused, where a robot file says it is in rad."""
    path, robot = tmp_path / "own.csv", tmp_path / "robot.toml"
    yaw = np.degrees(wrap_angle(YAW + 3.1))
    rows = np.column_stack([SECONDS, LEFT, RIGHT, TURN, X, Y, yaw])
    names = "t,left_rad_s,right_rad_s,gyro_z,true_x,true_y,true_yaw"
    np.savetxt(path, rows, "%.9f", ",", header=names, comments="")
    text = inspect(path).proposed_robot_file.replace("= nan", "= 1.0")
    robot.write_text(text, "utf-8")
    read = read_log(path, load_robot(robot)).truth.poses.poses
    np.testing.assert_allclose(wrap_angle(read[:, 2] - YAW - 3.1), 0.0, atol=1e-9)
    robot.write_text(text.replace('yaw_unit = "deg"', 'yaw_unit = "rad"'), "utf-8")
    with pytest.raises(ReplayError, match="'true_yaw' jumps by 360"):
        read_log(path, load_robot(robot))


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("imu_gyro_{}_dps", True),
        ("gyr_{}_deg_s", True),
        ("{} [m]", False),
        ("{}_m", False),
        ("pos_{}_m", False),
    ],
)
def test_a_gyro_is_told_from_a_position(tmp_path: Path, names: str, found: bool) -> None:
    gyro = ";".join(names.format(axis) for axis in "xyz")
    names = f"t_ms;left_rpm;right_rpm;{gyro};{REST.removeprefix(GYRO + ';')}"
    path = table(tmp_path / "own.csv", names)
    columns = tomllib.loads(inspect(path).proposed_robot_file)["log"]["columns"]
    assert columns["time"] == "t_ms"
    assert ("imu" in columns) == found


@pytest.mark.parametrize("name", ["yaw_rate [rad/s]", "imu_yawrate", "gyro", "cmd_yaw_rate"])
def test_a_yaw_rate_alone_is_a_gyro(tmp_path: Path, name: str) -> None:
    rows = zip(SECONDS, LEFT, RIGHT, TURN, strict=True)
    text = "".join(f"{t:.2f},{left:.4f},{right:.4f},{turn:.5f}\n" for t, left, right, turn in rows)
    path = tmp_path / "own.csv"
    path.write_text(f"t,left_rad_s,right_rad_s,{name}\n{text}", encoding="utf-8")
    columns = tomllib.loads(inspect(path).proposed_robot_file)["log"]["columns"]
    assert columns.get("imu", {}).get("angular_velocity") == (None if "cmd" in name else [name])


def test_a_time_in_another_language_is_all_that_is_filled_in(tmp_path: Path) -> None:
    robot = tmp_path / "own.toml"
    log = table(tmp_path / "own.csv", f"Zeit;left_rpm;right_rpm;{REST}")
    assert "log" not in tomllib.loads(inspect(log).proposed_robot_file)
    robot.write_text('[log.columns]\ntime = "Zeit"\ntime_unit = "ms"\n', encoding="utf-8")
    found = proposed_with(log, robot)
    assert {"tracks", "imu", "truth"} <= set(found["log"]["columns"])
    assert found["vehicle"]["sprocket_radius"] == pytest.approx(RADIUS, rel=0.01)


def test_tables_with_times_in_different_units(tmp_path: Path) -> None:
    """And one without a time, which hides no other."""
    rows = np.column_stack([1e3 * SECONDS, LEFT, RIGHT, TURN])
    names = "t_ms,left_rad_s,right_rad_s,yaw_rate"
    np.savetxt(tracks := tmp_path / "tracks.csv", rows, "%.6f", ",", header=names, comments="")
    fixes = np.column_stack([SECONDS, 46.0 + 1e-6 * SECONDS, 7.0 + 1e-6 * SECONDS])
    names = "t_s,latitude,longitude"
    np.savetxt(gps := tmp_path / "gps.csv", fixes, "%.9f", ",", header=names, comments="")
    (settings := tmp_path / "settings.csv").write_text("gain,offset\n1.0,2.0\n", "utf-8")
    found = inspect([tracks, gps, settings])
    assert inspect(tmp_path).mapping.columns.fixes.latitude == "latitude"
    assert any("looks like a time, not used: settings.csv" in note for note in found.notes)
    columns = tomllib.loads(found.proposed_robot_file)["log"]["columns"]
    assert (columns["time"], columns["time_unit"]) == ("t_ms", "ms")
    assert (columns["fixes"]["time"], columns["fixes"]["time_unit"]) == ("t_s", "s")
    text = found.proposed_robot_file.replace("position_sigma = nan", "position_sigma = 1.0")
    for key in ("mass", "sprocket_radius", "track_gauge"):
        text = text.replace(f"{key} = nan", f"{key} = 0.5")
    text = text.replace("eta0 = nan", "eta0 = 1.5")
    (robot := tmp_path / "robot.toml").write_text(text, "utf-8")
    log = read_log(tmp_path, load_robot(robot))
    assert log.name == tmp_path.name
    assert log.fixes.stamps.tolist() == log.tracks.stamps.tolist()


def test_tables_of_ardupilot_and_px4(tmp_path: Path) -> None:
    """Axes forward, right, down; wheels by numbers, 0 left or right; two IMUs in one table."""
    none, us = np.zeros_like(SECONDS), np.round(1e6 * SECONDS) + 12_345_678
    rates, forces = (none, none, -TURN), (none, -SPEED * TURN, none - 9.80665)
    places = [48.0 + Y / 111_200.0, 11.0 + X / 74_630.0, none + 520.0]
    distances = [np.cumsum(one) * RADIUS * 0.05 for one in (LEFT, RIGHT)]
    vector = ",".join(
        f"{name}[{k}]" for name in ("gyro_rad", "accelerometer_m_s2") for k in range(3)
    )
    second = [us + 700.0, us * 1e-6 + 0.0007, none + 1.0, *(none + 0.5 for _ in range(6))]
    first = [us, us * 1e-6, none, *rates, *forces]
    both = np.hstack([np.column_stack(first), np.column_stack(second)]).reshape(-1, len(first))
    tables = {
        "ap/IMU": ("TimeUS,timestamp,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", both),
        "ap/WENC": (
            "timestamp,Dist0,Qual0,Dist1,Qual1",
            [us * 1e-6, distances[0], none, distances[1], none],
        ),
        "ap/GPS": ("timestamp,Status,Lat,Lng,Alt", [us * 1e-6, none + 3.0, *places]),
        "px4/sensor_combined_0": (f"timestamp,{vector}", [us, *rates, *forces]),
        "px4/wheel_encoders_0": ("timestamp,wheel_speed[0],wheel_speed[1]", [us, RIGHT, LEFT]),
        "px4/vehicle_gps_position_0": (
            "timestamp,lat,lon,alt",
            [us, *(np.round(one) for one in (1e7 * places[0], 1e7 * places[1], 1e3 * places[2]))],
        ),
    }
    for file, (names, columns) in tables.items():
        rows = columns if isinstance(columns, np.ndarray) else np.column_stack(columns)
        (tmp_path / file).parent.mkdir(exist_ok=True)
        # Whole numbers have no decimals, as in the originals.
        lines = (",".join(f"{one:.9f}".rstrip("0").rstrip(".") for one in row) for row in rows)
        (tmp_path / f"{file}.csv").write_text("\n".join([names, *lines]), "utf-8")
    for folder, left in (("ap", "Dist0"), ("px4", "wheel_speed[1]")):
        found = inspect(tmp_path / folder)
        assert f"tracks: taken for the left side: {left!r}, by the gyro" in found.notes
        text = found.proposed_robot_file.replace("radius = nan", f"radius = {RADIUS}")
        (robot := tmp_path / f"{folder}.toml").write_text(text.replace("= nan", "= 1.0"), "utf-8")
        log = read_log(tmp_path / folder, load_robot(robot))
        assert not log.dropped
        speeds = np.column_stack([LEFT, RIGHT]) * RADIUS
        np.testing.assert_allclose(log.tracks.speeds, speeds[-len(log.tracks.speeds) :], atol=0.003)
        np.testing.assert_allclose(log.imu.angular_velocity[:, 2], -TURN, atol=1e-9)
        np.testing.assert_allclose(
            log.fixes.poses[:, :2], np.column_stack([X, Y]) - [X[0], Y[0]], atol=0.05
        )
        assert abs(load_robot(robot).imu.rotation_rpy_deg[0]) == pytest.approx(180.0, abs=0.1)


@pytest.mark.parametrize("names", ["enc_l;enc_r", "encL;encR"])
def test_counters_of_16_bits(tmp_path: Path, names: str) -> None:
    robot = tmp_path / "own.toml"
    log = table(tmp_path / "own.csv", f"t [ms];{names};{REST}", ticks=True)
    found = inspect(log)
    text = found.proposed_robot_file
    assert not found.dropped  # without their counts of a turn, no speed is too fast
    assert tomllib.loads(text)["log"]["columns"]["tracks"]["wrap"] == 65536.0
    marked = with_filled_in(text, robot)[0]
    robot.write_text(marked.replace("per_turn = nan", "per_turn = 8192.0"), encoding="utf-8")
    vehicle = proposed_with(log, robot)["vehicle"]
    assert vehicle["sprocket_radius"] == pytest.approx(RADIUS, rel=0.01)
    assert vehicle["max_track_speed"] == pytest.approx(1.2 * RADIUS * RIGHT.max(), rel=0.1)


def test_the_scale_of_an_odometry_has_a_place(tmp_path: Path) -> None:
    """A controller whose wheels are 10 % too large."""
    messages = []
    for k in range(len(SECONDS)):
        stamp = START + k * STEP
        messages.append(("/odom", odometry(stamp, SPEED[k] / 0.9, TURN[k] / 0.9)))
        messages += [("/imu", imu(stamp, (0.0, 0.0, TURN[k]))), slam(k)]
    log = write_bag(tmp_path / "bag", messages)
    streams = {"imu": {"topic": "/imu"}, "truth": {"topic": "/slam"}}
    robot = robot_with(tracks={"topic": "/odom", "gauge": TRACK}, **streams)
    found = next(one for one in check_robot(read_log(log, robot), robot) if one.name == SCALE)
    scale = found.settings["log.tracks.scale"]
    assert scale == pytest.approx(0.9, rel=0.01)
    assert found.remedy == f"scale = {scale:g} in [log.tracks]"
    robot = robot_with(tracks={"topic": "/odom", "gauge": TRACK, "scale": 0.9}, **streams)
    speeds = 0.2 * np.column_stack([LEFT, RIGHT])
    np.testing.assert_allclose(read_log(log, robot).tracks.speeds, speeds, atol=1e-12)


def test_a_spike_makes_no_standstill() -> None:
    """A counter that wraps unnoticed: nearly all speeds are small against its jump."""
    speeds = 0.2 * np.column_stack([LEFT, RIGHT])
    speeds[400] = 500.0
    stamps = START + STEP * np.arange(len(SECONDS))
    still = standstill(TrackSpeedSeries(stamps, speeds), stamps, np.zeros(len(stamps)))
    assert not still[SECONDS > 5.0].any()
    assert still[SECONDS < 4.0].mean() > 0.8


def counters(path: Path, left: str = "/enc_left", right: str = "/enc_right", **types: str) -> Path:
    """Counters of two encoder boards, with currents of the same type, and an IMU."""
    messages, times = [], []
    ticks = np.cumsum(np.column_stack([LEFT, RIGHT]) * 0.05 * 2000.0 / (2.0 * np.pi), axis=0)
    for k in range(len(SECONDS)):
        stamp = START + k * STEP
        turn, up = (0.0, 0.0, TURN[k]), (0.0, SPEED[k] * TURN[k], 9.80665)
        for topic, one in zip((left, right), ticks[k].round().astype(int) % 2**32, strict=True):
            kind = types.get(topic[1:], "UInt32")
            messages.append((topic, T[f"std_msgs/msg/{kind}"](int(one))))
        messages += [(f"/current_{one}", T["std_msgs/msg/UInt32"](k)) for one in ("left", "right")]
        messages.append(("/imu", imu(stamp, turn, up)))
        times += [stamp] * 5
    return write_bag(path, messages, times=times)


def test_a_number_for_each_side_on_two_topics(tmp_path: Path) -> None:
    """Counters are proposed, currents are none; nothing is said in radians before counts are known."""
    log, robot = counters(tmp_path / "bag"), tmp_path / "robot.toml"
    found = inspect(log)
    tracks = tomllib.loads(found.proposed_robot_file)["log"]["tracks"]
    assert (tracks["topic"], tracks["right_topic"]) == ("/enc_left", "/enc_right")
    assert (tracks["left"], tracks["right"], tracks["unit"]) == (["data"], ["data"], "counts")
    assert tracks["wrap"] == 2.0**32
    assert any("fill in counts_per_turn" in one for one in found.findings)
    assert not any("effective radius" in one or "joint rates" in one for one in found.findings)
    filled_in = found.proposed_robot_file.replace("counts_per_turn = nan", "counts_per_turn = 2000")
    robot.write_text(filled_in, "utf-8")
    again = proposed_with(log, robot)
    assert again["log"]["tracks"]["counts_per_turn"] == 2000
    assert again["log"]["tracks"]["right_topic"] == "/enc_right"


def test_ticks_of_both_wheels_in_an_array(tmp_path: Path) -> None:
    layout = T["std_msgs/msg/MultiArrayLayout"]([], 0)
    ticks = np.cumsum(np.column_stack([LEFT, RIGHT]) * 20.0, axis=0).astype(np.int32)
    messages, times = [], []
    for k in range(len(SECONDS)):
        stamp = START + k * STEP
        messages.append(("/wheel_ticks", T["std_msgs/msg/Int32MultiArray"](layout, ticks[k])))
        messages.append(("/imu", imu(stamp, (0.0, 0.0, TURN[k]))))
        times += [stamp] * 2
    found = inspect(write_bag(tmp_path / "bag", messages, times=times))
    tracks = tomllib.loads(found.proposed_robot_file)["log"]["tracks"]
    assert (tracks["left"], tracks["right"], tracks["unit"]) == (["data[0]"], ["data[1]"], "counts")


def test_swapped_topics_are_reported(tmp_path: Path) -> None:
    findings = inspect(counters(tmp_path / "bag", "/enc_right", "/enc_left")).findings
    assert any("turn the other way than the gyro" in one for one in findings)


def test_numbers_on_topics_that_name_no_side_are_listed(tmp_path: Path) -> None:
    findings = inspect(counters(tmp_path / "bag", "/enc/a", "/enc/b")).findings
    (found,) = (one for one in findings if one.startswith("no track speeds"))
    assert "topics with a number: /enc/a, /enc/b" in found


def test_sides_with_messages_of_two_types(tmp_path: Path) -> None:
    """One robot file fits a log with counters of one type, and another one with two."""
    one, two = counters(tmp_path / "one"), counters(tmp_path / "two", enc_right="Int64")
    text = inspect(one).proposed_robot_file.replace("per_turn = nan", "per_turn = 2000")
    robot = tmp_path / "robot.toml"
    robot.write_text(text.replace("= nan", "= 1.5"), "utf-8")
    logs = [read_log(log, load_robot(robot)) for log in (one, two)]
    np.testing.assert_array_equal(logs[0].tracks.speeds, logs[1].tracks.speeds)


def test_a_stream_that_cannot_be_read_is_refused(plain: Path, tmp_path: Path) -> None:
    """A wrong name by a person must not make a proposal without all that the log shows."""
    robot = tmp_path / "robot.toml"
    robot.write_text(WHEELS.replace("m1", "m9"), "utf-8")
    with pytest.raises(ReplayError, match=r"streams of the robot file: .* m9"):
        inspect(plain, sizes=filled_in_sizes(robot))


def test_a_bag_and_a_trajectory_are_one_log(tmp_path: Path) -> None:
    """The usual dataset: a bag of the robot, and its ground truth as a TUM file."""
    log, robot = counters(tmp_path / "bag"), tmp_path / "robot.toml"
    none, stamps = np.zeros_like(X), START * 1e-9 + SECONDS
    rows = np.column_stack([stamps, X, Y, none, none, none, np.sin(YAW / 2), np.cos(YAW / 2)])
    np.savetxt(truth := tmp_path / "truth.tum", rows, fmt="%.9f")
    found = inspect([log, truth])
    assert any("fill in counts_per_turn" in one for one in found.findings)
    filled_in = found.proposed_robot_file.replace("counts_per_turn = nan", "counts_per_turn = 2000")
    robot.write_text(filled_in.replace("mass = nan", "mass = 50.0"), "utf-8")
    text = inspect([log, truth], sizes=filled_in_sizes(robot)).proposed_robot_file
    robot.write_text(with_filled_in(text, robot)[0], "utf-8")
    known = load_robot(robot)
    assert known.vehicle.sprocket_radius == pytest.approx(RADIUS, rel=0.01)
    assert are_parts([[log], [truth]], topic_map(known).columns)
    assert not are_parts([[log], [log]], topic_map(known).columns)
    assert len(read_log([log, truth], known).truth.poses.stamps) == len(rows)


@pytest.mark.parametrize(("name", "is_truth"), [("prism", True), ("wheel_odometry", False)])
def test_a_table_of_positions_alone_is_a_truth(tmp_path: Path, name: str, is_truth: bool) -> None:
    """A total station writes time, x, y, z; the path of an odometry measures nothing."""
    log = counters(tmp_path / "bag")
    rows = np.column_stack([START * 1e-9 + SECONDS, X, Y, np.zeros_like(X)])
    header = {"delimiter": ",", "header": "time,x,y,z", "comments": ""}
    np.savetxt(table := tmp_path / f"{name}.csv", rows, fmt="%.9f", **header)
    truth = inspect([log, table]).mapping.columns.truth
    assert (truth is not None and (truth.x, truth.y) == ("x", "y")) == is_truth
