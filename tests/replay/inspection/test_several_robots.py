"""Bags of several robots, odometries of cameras, names of wheels, and tracks that turn otherwise."""

import sqlite3
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from test_inspection import driven_log

import bag_messages as made
from icreckon import Scenario, check_robot, inspect, load_robot, simulate, write_log
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.replay.bags.decoding import read_definitions
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.wheels import wheel_estimates
from icreckon.replay.mapping.naming import is_truth, sides

ALPHA = load_robot("auriga-alpha")
STAMPS = [made.SECOND + k * made.SECOND // 20 for k in range(60)]


def bag_of(path: Path, topics) -> Path:
    """A bag with a JointState or an Imu on each topic, or another message made of a stamp."""
    messages = []
    for stamp in STAMPS:
        for topic, make in topics.items():
            messages.append((topic, make(stamp)))
    return made.write_bag(path, messages)


def wheels(*names: str):
    return lambda stamp: made.joints(stamp, (1.0, 1.5), names or ("l", "r"))


def test_topics_of_one_robot_of_several_are_proposed(tmp_path: Path) -> None:
    topics = {f"/{name}/js": wheels() for name in ("r1", "r2")}
    topics |= {f"/{name}/imu": made.imu for name in ("r2", "r1")}
    found = inspect(bag_of(tmp_path / "bag", topics))
    assert (found.mapping.tracks.topic, found.mapping.imu.topic) == ("/r1/js", "/r1/imu")
    assert any("topics of 2 robots (r1, r2)" in finding for finding in found.findings)
    # Wheels of all robots on one topic: the IMU is that of the same robot.
    joined = {"/js": wheels("r2/wheel_l", "r2/wheel_r"), "/r1/imu": made.imu, "/r2/imu": made.imu}
    found = inspect(bag_of(tmp_path / "joined", joined))
    assert found.mapping.imu.topic == "/r2/imu"
    # One robot whose sensors have names of their own.
    found = inspect(bag_of(tmp_path / "one", {"/base/js": wheels(), "/sensors/imu": made.imu}))
    assert found.mapping.imu.topic == "/sensors/imu"
    assert not any("robots" in finding for finding in found.findings)


def test_an_odometry_of_a_camera_is_none_of_the_wheels(tmp_path: Path) -> None:
    seen = {"/zed/odom": lambda stamp: made.odometry(stamp, 1.0, 0.1), "/imu": made.imu}
    found = inspect(bag_of(tmp_path / "bag", seen))
    assert found.mapping.tracks is None
    assert any("[log.velocity]" in finding for finding in found.findings)
    both = seen | {"/wheel/odom": lambda stamp: made.odometry(stamp, 1.0, 0.1)}
    assert inspect(bag_of(tmp_path / "both", both)).mapping.tracks.topic == "/wheel/odom"


@pytest.mark.parametrize(
    ("names", "left"),
    [
        (["r1_left_wheel", "r1_right_wheel"], ("r1_left_wheel",)),
        (["r1/wheel_l", "r1/wheel_r"], ("r1/wheel_l",)),
        (["L/left_arm", "L/left_track", "L/right_track"], ("L/left_track",)),
        (["fl", "fr", "rl", "rr"], ("fl", "rl")),
        (["fl_joint", "rr_joint", "rl_joint", "fr_joint"], ("fl_joint", "rl_joint")),
        (["LeftWheel", "RightWheel"], ("LeftWheel",)),
        (["wheel_l1", "wheel_l2", "wheel_r1", "wheel_r2"], ("wheel_l1", "wheel_l2")),
        (["motor"], ()),
        ([], ()),
    ],
)
def test_a_name_that_all_joints_share_is_no_side(names, left) -> None:
    found, right = sides(names)
    assert found == left
    assert not {*found} & {*right}


def test_the_ground_is_no_truth() -> None:
    assert not is_truth("/ground_robot/imu")
    for topic in ("/ground_truth", "/groundtruth/pose", "/mocap/pose", "/vicon/base", "/gt"):
        assert is_truth(topic)


def test_tracks_and_gyro_that_turn_apart_show_neither_radius_nor_antenna(tmp_path: Path) -> None:
    log = simulate(Scenario(duration=60.0, seed=3, fix_rate=2.0, trajectory="slalom"), ALPHA)
    other = simulate(Scenario(duration=60.0, seed=8, trajectory="random"), ALPHA)
    foreign = replace(
        log,
        imu=ImuSeries(
            log.imu.stamps,
            *(getattr(other.imu, name) for name in ("angular_velocity", "linear_acceleration")),
        ),
    )
    backward = replace(
        log, tracks=TrackSpeedSeries(log.tracks.stamps, log.tracks.speeds * (1.0, -1.0))
    )
    for number, (wrong, said) in enumerate(
        ((foreign, "another robot's topic"), (backward, "the right side counts backward"))
    ):
        bag = write_log(wrong, tmp_path / f"{number}", "mcap", ALPHA)
        found = inspect(bag)
        assert any("not together" in one and said in one for one in found.findings)
        proposed = tomllib.loads(found.proposed_robot_file)
        assert not any(proposed["log"]["fixes"].get("position", ()))
        assert np.isnan(proposed["vehicle"]["sprocket_radius"])
    (check,) = [one for one in check_robot(foreign, ALPHA) if one.name == "sense of turning"]
    assert "not together" in check.problem


def test_a_bias_that_changes_from_standstill_to_standstill_walks(tmp_path: Path) -> None:
    log = driven_log((0.0, 0.0, 0.0))
    seconds = (log.imu.stamps - log.start) * 1e-9
    rates = log.imu.angular_velocity.copy()
    rates[:, 2] += 0.006 * seconds / seconds[-1]
    warming = replace(log, imu=ImuSeries(log.imu.stamps, rates, log.imu.linear_acceleration))
    for one, walks in ((log, False), (warming, True)):
        bag = write_log(one, tmp_path / "bag", "mcap", ALPHA, overwrite=True)
        found = inspect(bag)
        proposed = tomllib.loads(found.proposed_robot_file)["imu"].get("gyro_bias_walk")
        assert (proposed is not None) == walks
        assert any("changes over the log" in one for one in found.findings) == walks
    # 0.006 rad/s in 110 s from the first standstill to the last: a few changes, known to a third.
    assert proposed == pytest.approx(0.006 / np.sqrt(110.0), rel=0.3)


def test_noise_of_encoders_makes_the_effective_track_no_wider() -> None:
    log = driven_log((0.0, 0.0, 0.0))
    noise = np.random.default_rng(1).normal(0.0, 0.1, log.tracks.speeds.shape)
    noisy = replace(log, tracks=replace(log.tracks, speeds=log.tracks.speeds + noise))
    rates = YawRates(log.imu.stamps, log.imu.angular_velocity[:, 2])
    for one in (log, noisy):
        track = wheel_estimates(one, rates, 0.9).track
        assert track.value == pytest.approx(0.6, abs=max(0.01, 3.0 * track.sigma))
        assert track.sigma < 0.02


def test_a_message_definition_is_found_by_the_name_of_its_type(tmp_path: Path) -> None:
    bag = made.drive_bag(tmp_path / "bag", made.DRIVES, StoragePlugin.SQLITE3)
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute("DELETE FROM message_definitions")
    database.close()
    assert any(
        "no definition of /drive (our_msgs/msg/Drive)" in one for one in inspect(bag).findings
    )
    drive, wheel = made.definition_files(tmp_path)
    elsewhere = drive.rename(tmp_path / drive.name)
    found = inspect(bag, definitions=read_definitions([elsewhere, wheel]))
    assert found.mapping.tracks.topic == "/drive"
    # Two of that name are no answer, and neither replaces the one of the right package.
    other = tmp_path / "their_msgs" / "msg" / "Drive.msg"
    other.parent.mkdir(parents=True)
    other.write_text("float64 voltage\n", encoding="utf-8")
    unclear = inspect(bag, definitions=read_definitions([elsewhere, other, wheel]))
    assert unclear.mapping.tracks is None
    right = elsewhere.rename(drive)
    for files in ([right, other, wheel], [other, right, wheel]):
        assert inspect(bag, definitions=read_definitions(files)).mapping.tracks.topic == "/drive"
