"""Tables as logs: CSV and Parquet by a column map."""

import gzip
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet

import bag_messages
from icreckon import HeadingFix, Log, ReplayError, Robot, inspect, read_log
from icreckon.replay.mapping.topics import topic_map
from icreckon.replay.reading.gather import as_paths, log_files

START = 1_700_000_000_123_456_789


def robot_with(**columns: object) -> Robot:
    return bag_messages.robot_with(columns={"time": "t", **columns})


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def read(path: Path, **columns: object) -> Log:
    return read_log(path, robot_with(**columns))


SPEEDS = {"left": ["l"], "right": ["r"]}
RUN = "t,l,r\n1.5,0.1,0.2\n1.6,0.3,0.4\n"


def test_track_speeds(tmp_path: Path) -> None:
    log = read(write(tmp_path / "run.csv", RUN), tracks=SPEEDS)
    np.testing.assert_array_equal(log.tracks.stamps, [1_500_000_000, 1_600_000_000])
    np.testing.assert_array_equal(log.tracks.speeds, [[0.1, 0.2], [0.3, 0.4]])
    assert log.name == "run"
    assert log.dropped == {}
    assert log.notes == ()


def test_times_below_zero_by_a_latency_are_left_out(tmp_path: Path) -> None:
    """Clocks of tables begin at 0, and bags have no stamps below."""
    table = write(tmp_path / "run.csv", "t,l,r\n0.0,0.1,0.2\n0.1,0.1,0.2\n0.2,0.3,0.4\n")
    log = read(table, tracks=SPEEDS | {"latency": 0.15})
    np.testing.assert_array_equal(log.tracks.stamps, [50_000_000])
    assert log.dropped == {"tracks: stamp less latency is below zero": 2}


@pytest.mark.parametrize(("step", "unit"), [(20, "s"), (0.02, "ms")])
def test_a_wrong_unit_of_time_is_named(tmp_path: Path, step: float, unit: str) -> None:
    rows = "".join(f"{k * step:.2f},0.1,0.2\n" for k in range(50))
    path = write(tmp_path / "run.csv", f"t,l,r\n{rows}")
    assert read(path, time_unit=unit, tracks=SPEEDS).notes[0].endswith("s: is time_unit right?")


def test_rows_that_go_back_in_time_are_noted(tmp_path: Path) -> None:
    log = read(write(tmp_path / "run.csv", f"{RUN}1.2,0.1,0.2\n"), tracks=SPEEDS)
    assert log.notes == ("times of tracks go back (1 x): rows are sorted by them",)
    assert log.tracks.stamps[0] == 1_200_000_000
    log = read(write(tmp_path / "two.csv", f"{RUN}0.2,0.1,0.2\n"), tracks=SPEEDS)
    assert "if a restart set them back by 1.4 s after row 2, cut the file there" in log.notes[0]


def test_stamps_of_too_few_digits_are_named(tmp_path: Path) -> None:
    """As by '%g': all are equal; as by '%.1f': most are repeated, which all commands name first."""
    times = 1_700_000_000.0 + 0.02 * np.arange(100)

    def written(form: str) -> Path:
        rows = "".join(f"{form % one},0.1,0.2\n" for one in times)
        return write(tmp_path / "run.csv", f"t,l,r\n{rows}")

    with pytest.raises(ReplayError, match=r"column 't' has a resolution of 1e.06 s: .* digits"):
        read(written("%.5g"), tracks=SPEEDS)
    with pytest.raises(ReplayError, match=r"All 100 times are"):
        inspect(written("%.5g"))
    log = read(written("%.1f"), tracks=SPEEDS)
    assert "column 't' has a resolution of 0.1 s: written with too few digits?" in log.notes[0]
    assert inspect(written("%.1f")).notes[0] == log.notes[0]
    assert read(written("%.3f"), tracks=SPEEDS).notes == ()


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("rad/s", 0.5), ("rpm", 0.5 * 2.0 * np.pi / 60.0), ("mm/s", 1e-3), ("km/h", 1.0 / 3.6)],
)
def test_units_of_speed(tmp_path: Path, unit: str, factor: float) -> None:
    log = read(write(tmp_path / "run.csv", RUN), tracks=SPEEDS | {"unit": unit})
    np.testing.assert_allclose(log.tracks.speeds[1], [0.3 * factor, 0.4 * factor])


def test_counts_become_speeds_across_a_wrap(tmp_path: Path) -> None:
    text = "t,l,r\n0.0,250,10\n0.1,2,4\n0.2,12,254\n5.0,12,254\n5.1,13,254\n"
    counts = {"unit": "counts", "counts_per_turn": 100.0, "wrap": 256.0}
    log = read(write(tmp_path / "run.csv", text), tracks=SPEEDS | counts)
    turn = 2.0 * np.pi * 0.5
    np.testing.assert_allclose(
        log.tracks.speeds * 0.1 * 100.0 / turn, [[8, -6], [10, -6], [1, 0]], atol=1e-9
    )
    np.testing.assert_array_equal(log.tracks.stamps, [100_000_000, 200_000_000, 5_100_000_000])
    assert log.dropped == {"tracks: counter not read for 1 s": 1}


def test_a_counter_that_jumps(tmp_path: Path) -> None:
    text = "t,l,r\n0.0,0.0,0.0\n0.1,0.1,0.1\n0.2,-700.0,0.2\n0.3,-699.9,0.3\n"
    log = read(write(tmp_path / "run.csv", text), tracks=SPEEDS | {"unit": "m"})
    np.testing.assert_allclose(log.tracks.speeds, [[1.0, 1.0], [1.0, 1.0]])
    assert log.dropped == {"tracks: counter jumps": 1}


def test_one_table_with_empty_cells_for_several_streams(tmp_path: Path) -> None:
    text = (
        "t,l,r,gz,ax,ay,az,x,y,yaw\n"
        "0.00,1,2,,,,,,,\n"
        "0.01,,,90,0,0,1,,,\n"
        "0.02,3,,,,,,,,\n"
        "0.03,,,180,0,0,1,,,\n"
        "0.04,5,6,,,,,7,8,0.5\n"
        ",1,1,,,,,,,\n"
    )
    log = read(
        write(tmp_path / "run.csv", text),
        tracks=SPEEDS,
        imu={
            "angular_velocity": ["gz"],
            "linear_acceleration": ["ax", "ay", "az"],
            "rate_unit": "deg/s",
            "acceleration_unit": "g",
        },
        truth={"x": "x", "y": "y", "yaw": "yaw", "source": "tape measure"},
    )
    np.testing.assert_array_equal(log.tracks.speeds, [[1, 2], [5, 6]])
    assert log.dropped == {"tracks: not finite": 1, "tracks: no time": 1}
    np.testing.assert_allclose(log.imu.angular_velocity[:, 2], [np.pi / 2, np.pi])
    np.testing.assert_allclose(log.imu.linear_acceleration[0], [0.0, 0.0, 9.80665])
    np.testing.assert_allclose(log.truth.poses.poses, [[7.0, 8.0, 0.5]])
    assert log.truth.source == "tape measure"


@pytest.mark.parametrize("name", ["truth.tum", "groundtruth.txt"])
def test_a_trajectory_is_a_truth(tmp_path: Path, name: str) -> None:
    """Its times are seconds, whatever the unit of the other tables."""
    tracks = write(tmp_path / "tracks.csv", "t,l,r\n1500,0.1,0.2\n1600,0.3,0.4\n")
    poses = "# timestamp tx ty tz qx qy qz qw\n1.5 1 2 9 0 0 0.6 0.8\n1.6 1.5 2.5 9 0 0 0.8 0.6\n"
    truth = {"x": "true_x", "y": "true_y", "yaw": "true_yaw", "time": "time"}
    robot = robot_with(time_unit="ms", tracks=SPEEDS, truth=truth)
    found = read_log([tracks, write(tmp_path / name, poses)], robot).truth.poses
    np.testing.assert_array_equal(found.stamps, [1_500_000_000, 1_600_000_000])
    yaws = 2.0 * np.arctan2([0.6, 0.8], [0.8, 0.6])
    np.testing.assert_allclose(found.poses, np.column_stack([[1.0, 1.5], [2.0, 2.5], yaws]))
    with pytest.raises(ReplayError, match=f"{name}: the trajectory cannot be read: .* row"):
        read_log([tracks, write(tmp_path / name, f"{poses}1.7 2 3\n")], robot)


def test_texts_of_a_folder_are_read_if_they_are_trajectories(tmp_path: Path) -> None:
    tracks = write(tmp_path / "tracks.csv", "t,l,r\n1.5,0.1,0.2\n1.6,0.3,0.4\n")
    poses = "1.5 1 2 9 0 0 0.6 0.8\n1.6 1.5 2.5 9 0 0 0.8 0.6\n"
    truth = write(tmp_path / "GroundTruth.TXT", f"# timestamp tx ty tz qx qy qz qw\n{poses}")
    write(tmp_path / "README.txt", "Recorded on grass.\n")
    write(tmp_path / "notes.txt", "1 2 3\n")
    write(tmp_path / "estimate.txt", poses)
    write(tmp_path / "empty.txt", "")
    (tmp_path / "more.txt").mkdir()
    assert log_files(tmp_path) == as_paths(tmp_path) == [truth, tracks]
    poses_of_file = {"x": "true_x", "y": "true_y", "yaw": "true_yaw", "time": "time"}
    log = read_log(tmp_path, robot_with(tracks=SPEEDS, truth=poses_of_file))
    np.testing.assert_array_equal(log.truth.poses.stamps, log.tracks.stamps)
    # Next to a bag, whose robot file has no [log.columns], it is not taken.
    bag = write(tmp_path / "run.mcap", "")
    assert log_files(tmp_path) == [bag, tracks]


@pytest.mark.parametrize("kind", ["csv", "parquet", "named otherwise"])
@pytest.mark.parametrize("unit", ["s", "ns", "date"])
def test_times_since_1970(tmp_path: Path, kind: str, unit: str) -> None:
    stamps = START + np.arange(3) * 10_000_001
    times = {
        "s": pa.array(stamps * 1e-9),
        "ns": pa.array(stamps),
        "date": pa.array(stamps, pa.timestamp("ns", "UTC")),
    }[unit]
    table = pa.table({"t": times, "l": [0.1, 0.2, 0.3], "r": [1, 2, 3]})
    path = tmp_path / (
        "run.csv" if kind == "csv" else "run.parquet" if kind == "parquet" else "run"
    )
    if kind == "csv":
        csv.write_csv(table, path)
    else:
        parquet.write_table(table, path)
    log = read(path, tracks=SPEEDS, time_unit="ns" if unit == "ns" else "s")
    np.testing.assert_allclose(
        (log.tracks.stamps - stamps).astype(float), 0.0, atol=0 if unit != "s" else 240
    )


def test_fixes_in_the_plane(tmp_path: Path) -> None:
    text = "t,l,r,x,y,h\n0.0,0,0,1,2,0.5\n0.1,0,0,3,4,\n"
    fixes = {"x": "x", "y": "y", "yaw": "h", "position_sigma": 0.1, "heading_sigma": 0.2}
    log = read(write(tmp_path / "run.csv", text), tracks=SPEEDS, fixes=fixes)
    np.testing.assert_allclose(log.fixes.poses, [[1, 2, 0.5], [3, 4, np.nan]])
    np.testing.assert_allclose(log.fixes.variances, [[0.01, 0.04], [0.01, 0.04]])
    with pytest.raises(ReplayError, match=r"position_sigma .* \[log.columns.fixes\]"):
        read(tmp_path / "run.csv", tracks=SPEEDS, fixes={"x": "x", "y": "y"})


@pytest.mark.parametrize(
    ("keys", "yaw"),
    [
        ({}, 1.5),
        ({"unit": "deg"}, np.radians(1.5)),
        ({"unit": "deg", "clockwise": True}, np.radians(88.5)),
        ({"offset_deg": 180.0}, 1.5 - np.pi),
    ],
)
def test_headings_without_a_position(tmp_path: Path, keys: dict[str, object], yaw: float) -> None:
    text = "t,l,r,h\n1.0,0.1,0.2,1.5\n1.1,0.1,0.2,\n1.2,0.1,0.2,1.5\n"
    heading = {"yaw": "h", "sigma": 0.2, "latency": 0.5, **keys}
    log = read(write(tmp_path / "run.csv", text), tracks=SPEEDS, heading=heading)
    first, second = log.others
    assert isinstance(first, HeadingFix)
    assert isinstance(second, HeadingFix)
    assert (first.stamp, second.stamp) == (500_000_000, 700_000_000)
    assert first.yaw == pytest.approx(yaw)
    assert first.variance == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("t,l,rr\n1,2,3\n", r"columns t, l, r for tracks .* run.csv: rr"),
        ("t,l,r\n1,2,fast\n", r"column 'r' holds string, not numbers \(such as 'fast'\)"),
        ("t,l,r\n1,2,3\n2,2,x\n3,2,3\n", r"column 'r' holds text in 1 of 3 rows \(row 2: 'x'\)"),
        ("t,l,r\n1.7e18,2,3\n", "too much for times in s; set time_unit"),
        ("t,l,r\n", "no rows"),
        ("t,l,l,r\n1,2,3,4\n", "several columns are named 'l'"),
        ("0.0,1.5,-2,\n0.1,2,3,4\n", "add a line of names, as time,left,right,gyro_z"),
        ("0\t1\t1\t0.1\t0.2\t9.8\t0\t0\n", "add a line of names"),  # eight numbers, no trajectory
        ("t,l,r\n1,2\n1,2,3\n", "cannot be read"),
        ("", "cannot be read"),
    ],
)
def test_what_is_no_table_of_track_speeds(tmp_path: Path, text: str, part: str) -> None:
    path = write(tmp_path / "run.csv", text)
    with pytest.raises(ReplayError, match=part) as caught:
        read(path, tracks=SPEEDS)
    assert "run.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_table_needs_a_column_map(tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", RUN)
    with pytest.raises(ReplayError, match=r"\[log.columns\] .* its columns are t, l, r"):
        read_log(path, bag_messages.robot_with())


@pytest.mark.parametrize(
    ("columns", "part"),
    [
        ({"tracks": {"left": ["l"], "rigth": ["r"]}}, "did you mean 'right'"),
        ({"tracks": SPEEDS | {"unit": "counts"}}, "counts_per_turn"),
        ({"tracks": SPEEDS | {"wrap": 9.0}}, "wrap is for what adds up"),
        ({"tracks": SPEEDS | {"right": SPEEDS["left"]}}, "left and right must not share"),
        ({"imu": {"angular_velocity": ["x", "y"]}}, "three columns"),
        ({"truth": {"latitude": "a", "yaw": "b"}}, "or else latitude and longitude"),
        ({"truth": {"x": "a", "y": "b", "wander_sigma": 1.0, "wander_time": 9.0}}, "no wander"),
    ],
)
def test_a_wrong_column_map(columns: dict[str, object], part: str) -> None:
    with pytest.raises(ReplayError, match=part):
        topic_map(robot_with(**columns))


ROWS = [f"{0.1 * k:.1f},0.25,0.5" for k in range(200)]


@pytest.mark.parametrize(
    ("row", "text", "note"),
    [
        (-1, "19.9,0.2", r"left out 1 of 200 rows with another number of cells than names \(2"),
        (70, "7.0,0.25,0.5,0.75", r"left out 1 of 200 rows .*4 instead of 3, in '7.0,0.25"),
        (0, "s,m/s,m/s", r"column 'r' holds text in 1 of 200 rows \(row 1: 'm/s'\): left out"),
        (50, "5.0,-,0.5", r"column 'l' holds text in 1 of 200 rows \(row 51: '-'\): left out"),
        (50, "5.0, ,--", r"column 'r' holds text in 1 of 200 rows \(row 51: '--'\)"),
    ],
)
def test_a_damaged_row_is_left_out_and_noted(tmp_path, row, text, note):
    rows = list(ROWS)
    rows[row] = text
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress("\n".join(["t,l,r", *rows]).encode()))
    log = read(path, tracks=SPEEDS)
    assert len(log.tracks.stamps) == 199
    np.testing.assert_array_equal(log.tracks.speeds, np.tile([0.25, 0.5], (199, 1)))
    assert len(log.notes) == 1
    assert any(re.search(note, one) for one in log.notes), log.notes
    assert any(re.search(note, one) for one in inspect(path).notes)


def test_many_damaged_rows_are_an_error(tmp_path: Path) -> None:
    ragged = [f"{row},7" if place % 50 == 0 else row for place, row in enumerate(ROWS)]
    path = write(tmp_path / "run.csv", "\n".join(["t,l,r", *ragged]))
    with pytest.raises(ReplayError, match=r"cannot be read: it has 4 of 200 rows with another"):
        read(path, tracks=SPEEDS)
    worded = [row.replace("0.5", "x") if place % 50 == 0 else row for place, row in enumerate(ROWS)]
    write(path, "\n".join(["t,l,r", *worded]))
    with pytest.raises(ReplayError, match="holds text in 4 of 200 rows"):
        read(path, tracks=SPEEDS)


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff# t, l, r\n1.5, 0.1, 0.2\n1.6, 0.3, 0.4\n",
        f"# v1.2\n{RUN}",
        f"# a, b, c\n# radius: 0.2 m\n{RUN}",
        f"# v1.2\n# {RUN}",
    ],
)
def test_spaces_a_byte_order_mark_and_comments_are_passed_over(tmp_path: Path, text: str) -> None:
    log = read(write(tmp_path / "run.csv", text), tracks=SPEEDS)
    np.testing.assert_array_equal(log.tracks.speeds, [[0.1, 0.2], [0.3, 0.4]])


@pytest.mark.parametrize(
    ("text", "encoding", "said"),
    [
        ("t,links [°],r\n1,1,1\n", "latin-1", "names of its columns are not UTF-8; `iconv"),
        ("t,l,r\n1,2,3\n", "utf-16", "UTF-16; `iconv"),
        ("\ufefft,l,r\n1,2,3\n", "utf-16-be", "UTF-16; `iconv"),
    ],
)
def test_another_encoding_than_utf_8_is_named(tmp_path, text, encoding, said):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding=encoding)
    with pytest.raises(ReplayError, match=said):
        read(path, tracks=SPEEDS)


def test_fixes_on_the_globe(tmp_path: Path) -> None:
    places = ("52.0,13.0,0.5", "52.001,13.0,0.5", "0.0,0.0,0.5", "52.0,13.001,0.7")
    rows = "".join(f"0.{k},0,0,{place}\n" for k, place in enumerate(places))
    fixes = {"latitude": "lat", "longitude": "lon", "sigma": "s", "origin": [52.0, 13.0, 0.0]}
    path = write(tmp_path / "run.csv", f"t,l,r,lat,lon,s\n{rows}")
    log = read(path, tracks=SPEEDS, fixes=fixes)
    # By the lengths of a degree at this latitude on WGS 84.
    expected = [[0, 0], [0, 111.267], [68.677, 0]]
    np.testing.assert_allclose(log.fixes.poses[:, :2], expected, atol=0.01)
    np.testing.assert_allclose(log.fixes.variances[:, 0], [0.25, 0.25, 0.49])
    assert log.dropped == {"fixes: not a place on the globe": 1}
