"""Several files as one log; clocks and the order of messages."""

from pathlib import Path

import numpy as np
import pytest

from bag_messages import JOINTS, SPEEDS, halves, joints, odometry, robot_with, write_bag
from conftest import make_log
from icreckon import Log, ReplayError, Robot, load_robot, read_log, write_log
from icreckon.replay.comparison.fixes import parse_part, with_fixes_within
from icreckon.replay.reading.clocks import Evidence, choose_clocks

SECOND = 10**9


@pytest.mark.parametrize("forms", [("mcap", "mcap"), ("ros1", "ros1"), ("sqlite3", "ros1")])
@pytest.mark.parametrize("swapped", [False, True])
def test_the_parts_of_a_recording_are_one_log(tmp_path, robot, forms, swapped):
    whole = make_log()
    paths = [
        write_log(part, tmp_path / f"part{number}", form, robot)
        for number, (part, form) in enumerate(zip(halves(whole), forms, strict=True))
    ]
    log = read_log(paths[::-1] if swapped else paths, robot)
    np.testing.assert_array_equal(log.tracks.stamps, whole.tracks.stamps)
    np.testing.assert_allclose(log.tracks.speeds, whole.tracks.speeds)
    np.testing.assert_array_equal(log.imu.angular_velocity, whole.imu.angular_velocity)
    assert len(log.fixes.stamps) == len(whole.fixes.stamps)
    assert log.truth.source == "random"
    assert log.dropped == {}
    assert log.name == paths[:: -1 if swapped else 1][0].stem


def test_parts_that_overlap_are_counted_once(tmp_path: Path) -> None:
    early = write_bag(tmp_path / "early", SPEEDS[:2])
    late = write_bag(tmp_path / "late", SPEEDS[1:])
    log = read_log([early, late], robot_with(tracks=JOINTS))
    assert len(log.tracks.stamps) == 3
    assert log.dropped == {"tracks: duplicate stamp": 1}


def test_a_bag_and_a_table(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", SPEEDS)
    table = tmp_path / "imu.csv"
    table.write_text("t,gz\n1.5,0.25\n", encoding="utf-8")
    columns = {"time": "t", "imu": {"angular_velocity": ["gz"]}}
    log = read_log([bag, table], robot_with(tracks=JOINTS, columns=columns))
    assert len(log.tracks.stamps) == 3
    assert log.imu.angular_velocity[0, 2] == 0.25


def test_no_file_and_one_twice(tmp_path: Path, robot: Robot) -> None:
    bag = write_bag(tmp_path / "bag", SPEEDS)
    with pytest.raises(ReplayError, match="at least one file"):
        read_log([], robot)
    with pytest.raises(ReplayError, match="given twice"):
        read_log([bag, tmp_path / "." / "bag"], robot)


def test_late_messages_are_sorted(tmp_path: Path) -> None:
    order = [1, 2, 5, 3, 4, 6, 7, 8]
    messages = [("/js", joints(k * SECOND // 10, (float(k), 0.0))) for k in order]
    # They are recorded in the order given, 1 ms apart.
    path = write_bag(tmp_path / "bag", messages, times=range(0, 8_000_000, 1_000_000))
    log = read_log(path, robot_with(tracks=JOINTS))
    np.testing.assert_array_equal(log.tracks.stamps, np.arange(1, 9) * SECOND // 10)
    np.testing.assert_allclose(log.tracks.speeds[:, 0], 0.5 * np.arange(1, 9))
    assert log.dropped == {}
    assert "out of order" in log.notes[0]
    assert "were sorted" in log.notes[0]


def evidence(*rows) -> dict[str, Evidence]:
    return {f"s{k}": Evidence(*row) for k, row in enumerate(rows)}


@pytest.mark.parametrize(
    ("streams", "clocks"),
    [
        (evidence(("auto", -0.01), ("auto", 0.2)), ["header", "header"]),
        # A bag that was recorded anew: all headers agree, if not with the recorder.
        (evidence(("auto", -5e6), ("auto", -5e6 - 0.3)), ["header", "header"]),
        (evidence(("auto", 0.01), ("auto", 1.6e6)), ["header", "recording"]),
        (evidence(("auto", 40.0), ("auto", 1.6e6)), ["recording", "recording"]),
        (evidence(("auto", None), ("auto", 0.1)), ["recording", "header"]),
        (evidence(("auto", None), ("auto", 40.0)), ["recording", "recording"]),
        (evidence(("auto", 0.0, True), ("auto", 0.1)), ["recording", "header"]),
        (evidence(("recording", 0.0), ("auto", 40.0)), ["recording", "recording"]),
        (evidence(("header", 1.6e6), ("auto", 0.1)), ["header", "header"]),
    ],
)
def test_clocks(streams: dict[str, Evidence], clocks: list[str]) -> None:
    chosen = choose_clocks(streams)
    assert [choice.clock for choice in chosen.values()] == clocks
    assert all(choice.reason for choice in chosen.values())


def test_progress_of_reading(tmp_path: Path, robot: Robot) -> None:
    paths = [
        write_log(part, tmp_path / f"part{number}", "mcap", robot)
        for number, part in enumerate(halves(make_log(seconds=40.0)))
    ]
    shares: list[float] = []
    read_log(paths, robot, progress=shares.append)
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < 0.75
    assert 0.75 < shares[-1] <= 1.0


def test_files_that_carry_two_types_on_one_topic(tmp_path: Path) -> None:
    one = write_bag(tmp_path / "one", SPEEDS)
    other = write_bag(tmp_path / "other", [("/js", odometry(5 * SECOND, 1.0, 0.0))])
    with pytest.raises(ReplayError, match=r"JointState' in .*one, and of type .*Odometry' in"):
        read_log([one, other], robot_with(tracks=JOINTS))


@pytest.mark.parametrize(
    ("other", "match"),
    [
        (make_log(seed=2), "both hold .* for the same 4 s: two recordings"),
        (make_log(start=make_log().start + 3 * 86_400 * SECOND), "3 days apart"),
    ],
    ids=["of the same time", "days apart"],
)
def test_what_is_not_one_recording_is_refused(tmp_path: Path, other: Log, match: str) -> None:
    robot = load_robot("marmotte")
    logs = {"one": make_log(), "other": other}
    paths = [write_log(log, tmp_path / name, "mcap", robot) for name, log in logs.items()]
    with pytest.raises(ReplayError, match=match):
        read_log(paths, robot)


def test_a_part_without_fixes_is_refused() -> None:
    with pytest.raises(ReplayError, match=r"has none of the log's \d+ fixes, which are from"):
        with_fixes_within(make_log(6.0), parse_part("500:600"))


COUNT, PERIOD = 400, SECOND // 20
NOW = 500_000_000 * SECOND
REGULAR = [NOW + k * PERIOD for k in range(COUNT)]


def read_table(path: Path, head: str, rows: list[str], **columns: object) -> Log:
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    speeds = {"left": ["l"], "right": ["r"]}
    return read_log(path, robot_with(columns={"time": "t", "tracks": speeds, **columns}))


@pytest.mark.parametrize(
    ("stamps", "lost"),
    [
        ([one - NOW for one in REGULAR[:40]] + REGULAR[40:], 40),
        ([*REGULAR[:-1], NOW + 50 * 365 * 86_400 * SECOND], 1),
        ([NOW + k * 20 * 3600 * SECOND for k in range(COUNT)], 0),
    ],
    ids=["set after the start", "last is damaged", "hours apart"],
)
def test_the_larger_part_is_read(tmp_path: Path, stamps: list[int], lost: int) -> None:
    rows = [f"{one / SECOND:.3f},{k % 7},1,{0.05 * k},0.0,0.0" for k, one in enumerate(stamps)]
    truth = {"x": "x", "y": "y", "yaw": "yaw"}
    log = read_table(tmp_path / "log.csv", "t,l,r,x,y,yaw", rows, truth=truth)
    assert len(log.tracks.stamps) == COUNT - lost
    lines = {f"{one}: stamp is days from most others": lost for one in ("tracks", "truth")}
    assert log.dropped == (lines if lost else {})


def test_fixes_of_another_clock_are_left_out_and_named(tmp_path: Path) -> None:
    fixes = {"time": "utc", "x": "x", "y": "y", "position_sigma": 1.0}
    rows = [f"{0.1 * k:.1f},1,1,{3600.0 + 0.1 * k:.1f},{0.1 * k:.1f},0" for k in range(50)]
    log = read_table(tmp_path / "log.csv", "t,l,r,utc,x,y", rows, fixes=fixes)
    assert log.fixes is None or not len(log.fixes.stamps)
    assert log.dropped == {"fixes: stamp of another clock": 50}
    assert any("stamps: no fix is within the time of tracks and IMU" in note for note in log.notes)


@pytest.mark.parametrize("unit", ["ms", "us"])
def test_a_timer_of_32_bits_may_wrap(tmp_path: Path, unit: str) -> None:
    rows = [f"{time},1,1" for time in (2**32 - 300 + 10 * np.arange(90)) % 2**32]
    log = read_table(tmp_path / "log.csv", "t,l,r", rows, time_unit=unit)
    assert set(np.diff(log.tracks.stamps)) == {10 * (1_000_000 if unit == "ms" else 1000)}
    assert not log.dropped


@pytest.mark.parametrize("cell", ["1e300", "-7e9", "1e10"])
def test_a_cell_that_is_no_time_is_dropped(tmp_path: Path, cell: str) -> None:
    log = read_table(tmp_path / "log.csv", "t,l,r", ["1,1,1", f"{cell},1,1", "3,1,1"])
    assert log.tracks.stamps.tolist() == [SECOND, 3 * SECOND]
    assert log.dropped == {"tracks: no time": 1}
