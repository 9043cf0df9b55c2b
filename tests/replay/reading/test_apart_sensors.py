"""Sensors that come apart: rates and accelerations, or both sides, in tables or topics of their own."""

from dataclasses import replace as with_changed
from pathlib import Path

import numpy as np
import pytest
from msgspec import to_builtins
from msgspec.structs import replace

from bag_messages import SECOND, imu, joints, live_inputs, robot_with, write_bag
from icreckon import (
    ImuSample,
    ReplayError,
    Robot,
    Scenario,
    Vehicle,
    check_robot,
    inspect,
    load_robot,
    read_log,
    simulate,
)
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.robot.robot_file import changed_robot
from icreckon.replay.mapping.columns import TrackColumns

TRACKS = {"left": ["left"], "right": ["right"]}
SIDES = robot_with(columns={"time": "time", "tracks": TRACKS})


def test_tables_of_one_sensor_each_are_one_log(tmp_path: Path) -> None:
    """As of a phone: gyros and accelerometers with the same bare names, at stamps of their own."""
    seconds = np.arange(0.0, 20.0, 0.01)
    curves = np.column_stack([np.sin(seconds), np.cos(seconds), 0.3 * np.sin(0.5 * seconds)])
    late = seconds + 0.003
    forces = np.column_stack([np.sin(late), np.cos(late), 9.81 + 0.0 * late])

    def write(name: str, names: str, times: np.ndarray, values: np.ndarray) -> Path:
        rows = np.column_stack([times, values])
        np.savetxt(tmp_path / name, rows, "%.9f", ",", header=f"time,{names}", comments="")
        return tmp_path / name

    paths = [
        # Without gravity, which shows no attitude.
        write("Accelerometer.csv", "x,y,z", late, forces - [0.0, 0.0, 9.81]),
        write("Gyroscope.csv", "x,y,z", seconds, curves),
        write("TotalAcceleration.csv", "x,y,z", late, forces),
        write("left.csv", "left_speed", seconds[::2], 0.5 + 0.1 * curves[::2, :1]),
        write("right.csv", "right_speed", seconds[1::2], 0.5 - 0.1 * curves[1::2, :1]),
    ]
    columns = {
        "time": "time",
        "tracks": {"left": ["left_speed"], "right": ["right_speed"]},
        "imu": {
            "angular_velocity": [f"Gyroscope.{axis}" for axis in "xyz"],
            "linear_acceleration": [f"TotalAcceleration.{axis}" for axis in "xyz"],
        },
    }
    found = read_log(paths, Robot("test", Vehicle(1.0, 0.8, 0.5), log={"columns": columns}))
    assert not found.notes
    at = found.imu.stamps * 1e-9
    np.testing.assert_allclose(found.imu.angular_velocity[:, 1], np.cos(at), atol=1e-6)
    np.testing.assert_allclose(found.imu.linear_acceleration[:, 0], np.sin(at), atol=2e-5)
    at = found.tracks.stamps * 1e-9
    expected = np.column_stack([0.5 + 0.1 * np.sin(at), 0.5 - 0.1 * np.sin(at)])
    np.testing.assert_allclose(found.tracks.speeds, expected, atol=1e-4)
    proposed = inspect(paths).proposed_robot_file
    assert 'linear_acceleration = ["TotalAcceleration.x", ' in proposed


def test_parts_of_a_recording_may_have_tables_of_one_sensor_each(tmp_path: Path) -> None:
    paths = []
    for part, side in ((0, "left"), (0, "right"), (100, "left"), (100, "right")):
        rows = "".join(f"{part + k},{k}\n" for k in range(10))
        paths.append(tmp_path / f"{side}_{part}.csv")
        paths[-1].write_text(f"time,{side}\n{rows}")
    found = read_log(paths, SIDES).tracks
    assert found.stamps[[0, -1]].tolist() == [0, 109 * SECOND]


def test_gyros_and_accelerometers_on_two_topics_are_one_imu(tmp_path: Path) -> None:
    """As of a camera; live samples are those of a replay."""
    messages = []
    for k in range(400):
        stamp = SECOND + k * SECOND // 200
        time = stamp / SECOND
        messages.append(("/gyro", imu(stamp, (0.0, 0.1, np.sin(time)), (0.0, 0.0, 0.0))))
        if k % 3 == 0:
            at = stamp + SECOND // 500
            force = (np.sin(at / SECOND), 0.2, 9.8)
            messages.append(("/accel", imu(at, (0.0, 0.0, 0.0), force)))
        if k % 4 == 0:
            messages.append(("/js", joints(stamp, (1.0, 2.0))))
    bag = write_bag(tmp_path / "bag", messages)
    proposed = inspect(bag).proposed_robot_file
    assert 'topic = "/gyro"\nacceleration_topic = "/accel"' in proposed
    mapped = {"topic": "/gyro", "acceleration_topic": "/accel"}
    robot = robot_with(tracks={"topic": "/js", "left": ["l"], "right": ["r"]}, imu=mapped)
    found = read_log(bag, robot).imu
    at = found.stamps / SECOND
    np.testing.assert_allclose(found.angular_velocity[:, 2], np.sin(at), atol=1e-9)
    np.testing.assert_allclose(found.linear_acceleration[:, 0], np.sin(at), atol=1e-4)

    (inputs, topics), live = live_inputs(**robot.log), []
    for topic, message in messages:
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        live += inputs.take(topics[topic], message.__msgtype__, message, stamp)
    samples = [one for one in live if isinstance(one, ImuSample)]
    assert [one.stamp for one in samples] == found.stamps.tolist()
    forces = [one.linear_acceleration for one in samples]
    np.testing.assert_allclose(forces, found.linear_acceleration, atol=1e-12)


def test_a_clock_of_another_origin_is_found_by_the_yaw_rates(tmp_path: Path) -> None:
    """As of a microcontroller that counts from its own start, beside a phone."""
    robot = load_robot("auriga-alpha")
    log = simulate(Scenario(duration=100.0, seed=2, fix_rate=0.0), robot)
    since = log.imu.stamps[0]
    rows = np.column_stack([log.imu.stamps, log.imu.angular_velocity, log.imu.linear_acceleration])
    names = [f"{kind}_{axis}" for kind in ("gyro", "acc") for axis in "xyz"]
    np.savetxt(
        tmp_path / "imu.csv", rows, "%.17g", ",", header=f"time,{','.join(names)}", comments=""
    )

    def found(late: float, drift: float) -> tuple[str, TrackColumns]:
        millis = (log.tracks.stamps - since) * 1e-6 * (1.0 + drift) + 1000.0 * late
        poses = interpolate_poses(log.truth.poses, log.tracks.stamps)
        tracks = np.column_stack([millis, log.tracks.speeds, poses])
        path = tmp_path / f"tracks{late}.csv"
        header = "millis,left_speed,right_speed,truth_x,truth_y,truth_yaw"
        np.savetxt(path, tracks, "%.17g", ",", header=header, comments="")
        inspection = inspect([tmp_path / "imu.csv", path])
        proposed = inspection.mapping.columns
        mapped = {"log": {"columns": to_builtins(proposed)}}
        with_it = read_log([tmp_path / "imu.csv", path], changed_robot(robot, mapped))
        assert np.abs(with_it.tracks.stamps - log.tracks.stamps).max() < 0.02 * SECOND
        # The truth has the clock of the tracks.
        assert proposed.truth.clock_offset == proposed.tracks.clock_offset
        assert abs(int(with_it.truth.poses.stamps[0] - log.tracks.stamps[0])) < 0.02 * SECOND
        apart = replace(proposed, truth=replace(proposed.truth, clock_offset=0.0))
        mapped = {"log": {"columns": to_builtins(apart)}}
        lacks_truth = read_log([tmp_path / "imu.csv", path], changed_robot(robot, mapped))
        assert lacks_truth.truth is None
        assert any(
            "clock_offset in [log.columns.truth]; truth left out" in n for n in lacks_truth.notes
        )
        without = replace(proposed, tracks=replace(proposed.tracks, clock_offset=0.0))
        mapped = {"log": {"columns": to_builtins(without)}}
        with pytest.raises(ReplayError, match="do not overlap in time: they have two clocks"):
            read_log([tmp_path / "imu.csv", path], changed_robot(robot, mapped))
        return " ".join(inspection.findings), proposed.tracks

    text, tracks = found(20.0, 0.0)
    assert tracks.clock_offset == pytest.approx(20.0 - since / SECOND, abs=0.02)
    assert tracks.clock_drift == 0.0
    assert "off the IMU's, by yaw rates" in text
    # A resonator of a board, 0.5 % fast.
    text, tracks = found(20.0, 0.005)
    assert tracks.clock_drift == pytest.approx(0.005, abs=2e-4)
    assert "gains 5." in text or "gains 4.9" in text


def test_check_names_clocks_that_are_apart() -> None:
    robot = load_robot("auriga-alpha")
    log = simulate(Scenario(duration=150.0, seed=2, fix_rate=0.0), robot)
    stamps = log.tracks.stamps + 41 * SECOND
    late = with_changed(log, tracks=TrackSpeedSeries(stamps, log.tracks.speeds))
    (found,) = [one for one in check_robot(late, robot) if "clock" in one.problem]
    assert "+41.00 s off" in found.problem
    corrected, _ = found.correction(late, robot)
    assert not [one.problem for one in check_robot(corrected, robot) if one.problem]


def test_a_table_without_rows_is_left_out_of_several(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("time,left,right\n1.0,0.1,0.2\n1.1,0.3,0.4\n")
    (tmp_path / "marks.csv").write_text("time,text\n")
    log = read_log([tmp_path / "run.csv", tmp_path / "marks.csv"], SIDES)
    assert len(log.tracks.stamps) == 2
    assert any("marks.csv: the table has no rows: not used" in note for note in log.notes)
    assert inspect(tmp_path).mapping.columns.tracks.left == ("left",)


def test_a_part_without_rows_joins_nothing(tmp_path: Path) -> None:
    (tmp_path / "left.csv").write_text("time,left\n" + "".join(f"{k},0.1\n" for k in range(1, 9)))
    (tmp_path / "right.csv").write_text("time,right\n1,\n2,\n")
    with pytest.raises(ReplayError, match="track"):
        read_log([tmp_path / "left.csv", tmp_path / "right.csv"], SIDES)
