"""Track speeds of joints that count, of other types of message, and with definitions of one's own."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

import bag_messages as made
from bag_messages import (
    JOINTS,
    SECOND,
    STORE,
    T,
    drive_bag,
    joints,
    odometry,
    robot_with,
    write_bag,
)
from icreckon import Log, ReplayError, read_log
from icreckon.replay.bags.decoding import read_definitions
from icreckon.replay.reading.message_rows import BODY_READERS


def read(path: Path, **tracks: object) -> Log:
    return read_log(path, robot_with(tracks={"topic": "/drive", **tracks}))


def test_fields_of_a_type_of_ones_own(tmp_path: Path) -> None:
    path = drive_bag(tmp_path / "bag", made.DRIVES)
    log = read(path, left=["wheels[0].rate"], right=["wheels[1].rate"])
    np.testing.assert_allclose(log.tracks.speeds, [[0.5, 1.0]] * 3)
    np.testing.assert_array_equal(log.tracks.stamps, [SECOND, 2 * SECOND, 3 * SECOND])


def test_a_type_with_a_row_among_the_readers_needs_no_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def speed_and_yaw_rate(message):
        return message.wheels[0].rate, message.wheels[1].rate

    monkeypatch.setitem(BODY_READERS, made.KIND, speed_and_yaw_rate)
    speed, half_turn = 1.0, 0.5 * made.VEHICLE.track_gauge * 2.0
    log = read(drive_bag(tmp_path / "bag", made.DRIVES))
    np.testing.assert_allclose(log.tracks.speeds, [[speed - half_turn, speed + half_turn]] * 3)


def test_an_odometry_without_a_speed_is_refused_for_that(tmp_path: Path) -> None:
    """The names of joints, which it ignores, are another matter."""
    path = write_bag(tmp_path / "bag", [("/js", odometry(SECOND, np.nan, 0.0))])
    with pytest.raises(ReplayError, match="no usable message for tracks on topic '/js'"):
        read_log(path, robot_with(tracks=JOINTS))


def test_an_array_that_is_too_short_is_counted(tmp_path: Path) -> None:
    path = drive_bag(tmp_path / "bag", [*made.DRIVES, (4 * SECOND, (1.0, 2.0), (1,))])
    log = read(path, left=["ticks[0]"], right=["ticks[1]"], unit="rad/s")
    assert len(log.tracks.stamps) == 3
    assert log.dropped == {"tracks: cannot be decoded": 1}


@pytest.mark.parametrize(
    ("left", "part"),
    [
        ("wheel[0].rate", r"no field 'wheel' of .* our_msgs/msg/Drive has header, wheels, ticks"),
        ("wheels[0].speed", r"no field 'speed' .* our_msgs/msg/Wheel has rate"),
        ("header", r"'header' is no number; std_msgs/msg/Header has stamp, frame_id"),
        ("who", "'who' is no number; it is of type str"),
        ("wheels[0]..rate", "no path of a field"),
        ("[x]", "no path of a field"),
    ],
)
def test_fields_that_are_not_there(tmp_path: Path, left: str, part: str) -> None:
    path = drive_bag(tmp_path / "bag", made.DRIVES)
    with pytest.raises(ReplayError, match=part) as caught:
        read(path, left=[left], right=["wheels[1].rate"])
    assert "\n" not in str(caught.value)


def test_messages_without_a_header_go_by_the_time_of_recording(tmp_path: Path) -> None:
    kind = "std_msgs/msg/Float64MultiArray"
    layout = T["std_msgs/msg/MultiArrayLayout"]([], 0)
    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        at = bag.add_connection("/drive", kind, typestore=STORE)
        for k in (1, 2):
            message = T[kind](layout, np.array([1.0 * k, 2.0 * k]))
            bag.write(at, k * SECOND, STORE.serialize_cdr(message, kind))
    log = read(path, left=["data[0]"], right=["data[1]"], unit="m/s")
    np.testing.assert_array_equal(log.tracks.speeds, [[1.0, 2.0], [2.0, 4.0]])
    np.testing.assert_array_equal(log.tracks.stamps, [SECOND, 2 * SECOND])
    assert log.notes == ("tracks by the time of recording: the messages have no header",)
    with pytest.raises(ReplayError, match='no header; set time = "recording"'):
        read(path, left=["data[0]"], right=["data[1]"], time="header")


def test_definitions_that_the_bag_lacks(tmp_path: Path) -> None:
    # sqlite3 bags of older versions of rosbag2 hold no definitions.
    path = drive_bag(tmp_path / "bag", made.DRIVES, StoragePlugin.SQLITE3)
    with sqlite3.connect(path / "bag.db3") as database:
        database.execute("DELETE FROM message_definitions")
    database.close()
    sides = {"left": ["wheels[0].rate"], "right": ["wheels[1].rate"]}
    with pytest.raises(ReplayError, match=r"holds no definition of this type; give .* --msg"):
        read(path, **sides)
    definitions = read_definitions(made.definition_files(tmp_path))
    assert [name for name, _ in definitions] == [made.KIND, "our_msgs/msg/Wheel"]
    robot = robot_with(tracks={"topic": "/drive", **sides})
    log = read_log(path, robot, definitions=definitions)
    np.testing.assert_allclose(log.tracks.speeds, [[0.5, 1.0]] * 3)
    with pytest.raises(ReplayError, match="Wheel"):
        read_log(path, robot, definitions=definitions[:1])


def test_files_that_are_no_definitions(tmp_path: Path) -> None:
    wrong = tmp_path / "Wrong.msg"
    wrong.write_text("%%%", encoding="utf-8")
    for file, part in ((wrong, "not a message definition"), (tmp_path / "A.msg", "cannot be read")):
        with pytest.raises(ReplayError, match=part) as caught:
            read_definitions([file])
        assert "\n" not in str(caught.value)


def test_joints_that_count(tmp_path: Path) -> None:
    messages = [
        ("/js", joints(k * SECOND // 10, (), positions=angles))
        for k, angles in enumerate([(0.0, 6.2), (0.1, 0.1), (0.2, 0.2)], start=1)
    ]
    mapped = JOINTS | {"unit": "rad", "wrap": 2.0 * np.pi}
    log = read_log(write_bag(tmp_path / "bag", messages), robot_with(tracks=mapped))
    np.testing.assert_allclose(
        log.tracks.speeds, [[0.5, (2.0 * np.pi - 6.1) * 5.0], [0.5, 0.5]], atol=1e-9
    )
    np.testing.assert_array_equal(log.tracks.stamps, [SECOND // 5, 3 * SECOND // 10])


@pytest.mark.parametrize(
    ("wrap", "note"),
    [
        (None, "start again after 65536: set wrap = 65536.0"),
        (65536.0, None),
        (1200.0, "start again after 65536: set wrap = 65536.0"),
    ],
)
def test_a_range_that_the_counters_contradict_is_noted(wrap, note, tmp_path: Path) -> None:
    counts = [(65000 + 100 * k) % 65536 for k in range(20)]
    drives = [(k * SECOND // 10, (0.0, 0.0), (one, one)) for k, one in enumerate(counts, start=1)]
    path = drive_bag(tmp_path / "bag", drives)
    mapped = {"unit": "counts", "counts_per_turn": 1e4} | ({"wrap": wrap} if wrap else {})
    notes = read(path, left=["ticks[0]"], right=["ticks[1]"], **mapped).notes
    assert [one for one in notes if "counters" in one] == (
        [] if note is None else [f"robot file: the counters of the tracks {note}"]
    )


def test_counters_of_which_one_never_comes_have_no_range(tmp_path: Path) -> None:
    """The missing joint is reported; its readings, which are none, have no span."""
    stream = [("/js", joints(k * SECOND, (), ["l"], [float(k)])) for k in range(1, 5)]
    mapped = JOINTS | {"unit": "counts", "counts_per_turn": 1e4, "wrap": 100.0}
    with pytest.raises(ReplayError, match="wanted are the positions of the joints l, r"):
        read_log(write_bag(tmp_path / "bag", stream), robot_with(tracks=mapped))
