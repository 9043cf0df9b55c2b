"""A robot file against a log: each error is named, alone, and corrected; right files are left alone."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as with_values

from conftest import inspected, sample_log, thorough
from icreckon import (
    Log,
    ReplayError,
    Scenario,
    body_velocities,
    calibrate,
    check_robot,
    compare,
    read_log,
    simulate,
)
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import rotate, rpy_to_matrix
from icreckon.estimator.log.failed_sensors import stuck_sides, working_imu
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, changed_robot, load_robot
from icreckon.replay.checking import robot_check
from icreckon.replay.checking.check import FORWARD, LATENCY, MOUNTING, SCALE, TRACK, Check
from icreckon.replay.checking.robot_check import with_corrected
from icreckon.replay.checking.track_checks import check_scale
from icreckon.replay.checking.worth import judged, worth_of
from icreckon.replay.estimates.wheels import heading_offset

ALPHA = load_robot("auriga-alpha")
MAPPED = with_values(
    ALPHA, log={"tracks": {"topic": "/joint_states", "left": ["l"], "right": ["r"]}}
)
TURNING, BIAS, HEADING = "sense of turning", "gyro bias", "offset of the heading"
RADIUS = ALPHA.vehicle.sprocket_radius


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(Scenario(duration=110.0, seed=3, fix_rate=0.0, trajectory="stop-and-go"), ALPHA)


def problems(log: Log, robot: Robot) -> dict[str, str]:
    return {one.name: one.problem for one in check_robot(log, robot) if one.problem}


def corrected(log: Log, robot: Robot) -> tuple[Log, Robot]:
    for one in check_robot(log, robot):
        if one.correction is not None:
            log, robot = one.correction(log, robot)
    return log, robot


def speeds(log: Log, change) -> Log:
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, change(log.tracks.speeds)))


def late(log: Log, seconds: float) -> Log:
    stamps = log.tracks.stamps + round(seconds * 1e9)
    return replace(log, tracks=TrackSpeedSeries(stamps, log.tracks.speeds))


def turned_imu(log: Log, roll: float, pitch: float, yaw: float) -> Log:
    """Log of an IMU that is mounted otherwise [deg]."""
    by = rpy_to_matrix(*np.radians([roll, pitch, yaw]))
    rates, forces = log.imu.angular_velocity @ by, log.imu.linear_acceleration @ by
    return replace(log, imu=ImuSeries(log.imu.stamps, rates, forces))


def scaled_imu(log: Log, rates: float = 1.0, forces: float = 1.0, bias: float = 0.0) -> Log:
    angular = rates * (log.imu.angular_velocity + np.array([0.0, 0.0, bias]))
    forces = forces * log.imu.linear_acceleration
    return replace(log, imu=ImuSeries(log.imu.stamps, angular, forces))


def scaled(factor: float):
    return lambda log: speeds(log, lambda v: factor * v)


def imu_times(**factors: float):
    return lambda log: scaled_imu(log, **factors)


def same(log_or_robot):
    return log_or_robot


def swapped(log: Log) -> Log:
    return speeds(log, lambda v: v[:, ::-1].copy())


def mounted(*rpy: float):
    return lambda log: turned_imu(log, *rpy)


def with_eta0(robot: Robot, eta0: float) -> Robot:
    indices = with_values(robot.indices, eta0=eta0)
    return with_values(robot, constant_icr=None, indices=indices)


COUNTERS = {"topic": "/t", "left": ["l"], "right": ["r"], "unit": "counts", "counts_per_turn": 512}
FORCE = "mean specific force"
# A log and a robot file with one error, and the quantity and text by which it is named.
ERRORS = {
    "diameter": (
        scaled(2.0),
        lambda robot: changed_robot(robot, {"vehicle.sprocket_radius": 2.0 * RADIUS}),
        SCALE,
        "is the radius a diameter?",
    ),
    "lines of an encoder": (
        scaled(0.25),
        lambda robot: with_values(robot, log={"tracks": COUNTERS}),
        SCALE,
        "is counts_per_turn off",
    ),
    "turns 1.5 times as far": (
        same,
        lambda robot: with_eta0(robot, robot.constant_indices.eta0 / 1.5),
        TRACK,
        "times that of the file",
    ),
    "not in deg/s": (scaled(np.pi / 180.0), same, SCALE, "in rad/s, not deg/s?"),
    "rates in rpm": (scaled(30.0 / np.pi), same, SCALE, "are the rates in rpm?"),
    "left and right": (swapped, same, TURNING, "right are swapped"),
    "backward": (scaled(-1.0), same, TURNING, "both tracks count backward"),
    "left and right, backward": (
        lambda log: scaled(-1.0)(swapped(log)),
        same,
        TURNING,
        "backward where the truth drives forward",
    ),
    "late": (lambda log: late(log, 0.25), same, LATENCY, "s late"),
    "early": (lambda log: late(log, -0.15), same, LATENCY, "s early"),
    "tilted": (mounted(0.0, 10.0, 0.0), same, MOUNTING, "deg off"),
    "upside down": (mounted(180.0, 0.0, 0.0), same, MOUNTING, "upside down"),
    "on its side": (mounted(90.0, 0.0, 90.0), same, MOUNTING, "deg off"),
    "backward IMU": (mounted(0.0, 0.0, 180.0), same, FORWARD, "180 deg"),
    "IMU to the left": (mounted(0.0, 0.0, 90.0), same, FORWARD, "+90 deg"),
    "deg/s": (imu_times(rates=180.0 / np.pi), same, "unit of the gyro", "deg/s"),
    "gyro's signs": (imu_times(rates=-1.0), same, TURNING, "the gyro's signs are wrong"),
    "in g": (imu_times(forces=1.0 / 9.81), same, FORCE, "in g?"),
    "gravity of 9.29": (imu_times(forces=9.29 / 9.81), same, FORCE, "on average, not 9.81"),
    "bias": (imu_times(bias=0.05), same, BIAS, "+0.05"),
}


@pytest.mark.parametrize(
    ("source", "trajectory", "duration"),
    [
        ("by the truth", "slalom", 110.0),
        ("by the truth", "slalom", 60.0),
        ("by the tracks", "aggressive", 110.0),
        ("at standstill", "stop-and-go", 110.0),
    ],
)
def test_a_bias_without_a_standstill_before_the_end_is_named(source, trajectory, duration):
    """A bias of -0.0156 rad/s is within the file's sigma, and no filter learns it soon."""
    options = {"drive": 90.0, "rest": 8.0} if trajectory == "stop-and-go" else {}
    scenario = Scenario(
        duration=duration, seed=3, fix_rate=0.0, trajectory=trajectory, trajectory_options=options
    )
    log = simulate(scenario, ALPHA)
    # Without its first and last seconds, in which the robot stands.
    log = scaled_imu(log.part(6.0, log.duration - 6.0), bias=-0.0156)
    if source == "by the tracks":
        log = replace(log, truth=None)
    (found,) = [one for one in check_robot(log, ALPHA) if one.name == BIAS]
    assert source in found.problem
    assert found.measured.value == pytest.approx(-0.0156, abs=0.004)
    assert found.settings["imu.gyro_bias"] == pytest.approx(-0.0156, abs=0.004)


def test_a_truth_that_is_late_is_no_wrong_radius(log: Log) -> None:
    poses = replace(log.truth.poses, stamps=log.truth.poses.stamps + 3_000_000_000)
    truth = replace(log.truth, poses=poses, twists=None, tracks=None)
    late_truth, in_time = (
        next(one for one in check_robot(each, ALPHA) if one.name == SCALE)
        for each in (replace(log, truth=truth), log)
    )
    assert not late_truth.problem
    assert late_truth.measured.value == pytest.approx(in_time.measured.value, abs=0.005)


@pytest.mark.parametrize("name", ERRORS)
def test_an_error_is_named_alone_and_mended(log: Log, name: str):
    of_log, of_robot, quantity, text = ERRORS[name]
    wrong, robot = of_log(log), of_robot(ALPHA)
    found = problems(wrong, robot)
    assert list(found) == [quantity]
    assert text in found[quantity]
    assert problems(*corrected(wrong, robot)) == {}


@pytest.mark.parametrize("name", ["left and right", "gyro's signs"])
def test_without_a_truth_either_tracks_or_gyro_may_be_wrong(log: Log, name: str):
    found = problems(replace(ERRORS[name][0](log), truth=None), ALPHA)[TURNING]
    assert "left and right are swapped, or the gyro's signs are wrong" in found


def test_a_mirrored_truth_does_not_blame_the_gyro(log: Log):
    """Its y axis points to the right, as in NED; tracks and gyro agree."""
    poses = replace(log.truth.poses, poses=log.truth.poses.poses * [1.0, -1.0, -1.0])
    assert TURNING not in problems(replace(log, truth=replace(log.truth, poses=poses)), ALPHA)


@pytest.mark.parametrize(
    ("error", "table"), [("left and right", "tracks"), ("backward", "tracks"), ("deg/s", "imu")]
)
def test_the_remedy_names_the_table_of_the_file(log: Log, error: str, table: str):
    columns = {"time": "t", "tracks": {"left": ["l"], "right": ["r"], "unit": "m/s"}}
    robot = with_values(ALPHA, log={"columns": columns})
    (found,) = (one for one in check_robot(ERRORS[error][0](log), robot) if one.problem)
    assert f"[log.columns.{table}]" in found.remedy


def dead_from(log: Log, side: int, share: float, factor: float = 0.0) -> Log:
    """Log of which a side repeats a reading, a factor times its own, after a share of its samples."""
    first = int(share * len(log.tracks.stamps))

    def change(found):
        found = found.copy()
        found[first:, side] = factor * found[first, side]
        return found

    return speeds(log, change)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("turns_alike", [False, True])
def test_signs_of_a_twist_are_those_of_its_driver(log: Log, backward, turns_alike) -> None:
    """It has no sides to exchange."""
    robot = with_values(ALPHA, log={"tracks": {"topic": "/odom"}})
    sign, order = -1.0 if backward else 1.0, -1 if backward == turns_alike else 1
    wrong = speeds(log, lambda v: sign * v[:, ::order])
    found = problems(wrong, robot)
    if turns_alike and not backward:
        assert found == {}
        return
    said = "forward speed" in found[TURNING], "yaw rate" in found[TURNING]
    assert said == (backward, not turns_alike)
    assert problems(*corrected(wrong, robot)) == {}


def test_an_offset_of_gravity_within_the_bias_of_the_file_is_no_error(log: Log) -> None:
    biased = scaled_imu(log, forces=9.4 / 9.81)
    imu = with_values(ALPHA.imu, accelerometer_bias_sigma=0.2)
    assert problems(biased, with_values(ALPHA, imu=imu)) == {}
    assert problems(biased, ALPHA) != {}


def test_an_antenna_that_is_elsewhere_is_named() -> None:
    scenario = Scenario(duration=110.0, seed=3, fix_rate=5.0, trajectory="stop-and-go")
    log = simulate(scenario, ALPHA)
    assert problems(log, MAPPED) == {}
    late = replace(log.fixes, stamps=log.fixes.stamps + 300_000_000)
    (found,) = [one for one in check_robot(replace(log, fixes=late), MAPPED) if one.problem]
    assert found.settings["log.fixes.latency"] == pytest.approx(0.3, abs=0.1)
    assert problems(*found.correction(replace(log, fixes=late), MAPPED)) == {}
    wrong = replace(log.fixes, antennas=np.tile([0.9, 0.0, 0.4], (len(log.fixes.stamps), 1)))
    (found,) = [one for one in check_robot(replace(log, fixes=wrong), MAPPED) if one.problem]
    assert found.settings["log.fixes.position"] == pytest.approx([0.0, 0.0, 0.4], abs=0.2)
    assert problems(*found.correction(replace(log, fixes=wrong), MAPPED)) == {}


@pytest.mark.parametrize("backward", [False, True])
def test_a_heading_off_the_direction_of_driving_is_named(backward: bool) -> None:
    scenario = Scenario(duration=110.0, seed=3, fix_rate=5.0, trajectory="slalom")
    log = replace(simulate(scenario, ALPHA), others=())
    poses = log.truth.poses
    drives = replace(scaled(-1.0)(swapped(log)) if backward else log, truth=None)
    robot = with_values(ALPHA, log={"heading": {"topic": "/heading", "sigma": 0.01}, **MAPPED.log})

    def headed(off) -> Log:
        """The log with a compass that is off by an angle, which may depend on the stamp."""
        turned = np.pi if backward else 0.0
        return replace(
            drives,
            others=tuple(
                HeadingFix(int(stamp), float(pose[2]) + turned + off(stamp), 1e-4)
                for stamp, pose in zip(poses.stamps[::20], poses.poses[::20], strict=True)
            ),
        )

    right = headed(lambda _: 0.0)
    assert HEADING not in problems(right, robot)
    # An antenna ahead drives other courses than the robot in bends.
    at_fixes = interpolate_poses(poses, drives.fixes.stamps)[:, 2] + np.pi * backward
    places = drives.fixes.poses + np.column_stack([rotate((1.0, 0.0), at_fixes), 0.0 * at_fixes])
    antennas = np.tile([1.0, 0.0, 0.0], (len(places), 1))
    ahead = replace(right, fixes=replace(drives.fixes, poses=places, antennas=antennas))
    assert heading_offset(ahead).value == pytest.approx(heading_offset(right).value, abs=0.5)
    holed = ahead.fixes.poses.copy()
    holed[50] = np.nan
    holed_log = replace(ahead, fixes=replace(ahead.fixes, poses=holed))
    assert heading_offset(holed_log).value == pytest.approx(heading_offset(ahead).value, abs=0.5)
    wrong = headed(lambda _: -0.5 * np.pi)
    (found,) = [one for one in check_robot(wrong, robot) if one.name == HEADING]
    assert "deg right of the direction of driving" in found.problem
    assert found.settings["log.heading.offset_deg"] == pytest.approx(90.0, abs=5.0)
    assert HEADING not in problems(*found.correction(wrong, robot))
    # A compass that drifts has no right offset.
    drifting = headed(lambda stamp: 0.5 * (stamp - log.start) / (log.duration * 1e9))
    assert re.search(r"turn by (2[5-9]|3[0-2]) ± ", problems(drifting, robot)[HEADING])


@pytest.mark.parametrize(
    ("keys", "factor", "named", "right"),
    [
        ({}, 1.0, "", {}),
        ({"position": [0.4, -0.3]}, 1.0, "from the place in the file", {"position": [0.0, 0.0]}),
        ({"yaw_deg": 90.0}, 1.0, "off the direction of driving", {"yaw_deg": 0.0}),
        ({}, 0.7, "times that of the tracks", {}),
        ({"sigma": 0.01}, 1.0, "scatters", {"sigma": 0.05}),
    ],
)
def test_the_velocity_of_another_odometry(keys, factor, named, right) -> None:
    log, rng = simulate(Scenario(duration=60.0, seed=3), ALPHA), np.random.default_rng(3)
    frames = log.truth.poses.rows(np.arange(0, len(log.truth.poses.stamps), 10))
    noise = rng.normal(0.0, 0.003, (len(frames.stamps), 2))
    frames.poses[:, :2] = factor * frames.poses[:, :2] + noise
    mapped = {"topic": "/vo", "sigma": 0.06} | keys
    robot = with_values(ALPHA, log={"velocity": mapped, **MAPPED.log})
    place = mapped.get("position", (0.0, 0.0)), np.radians(mapped.get("yaw_deg", 0.0))
    seen = replace(log, others=tuple(body_velocities(frames, mapped["sigma"], *place)))
    (check,) = [one for one in check_robot(seen, robot) if one.name.startswith("velocity")]
    assert named in check.problem
    assert check.measured.value == pytest.approx(factor, abs=0.03)
    assert check.settings.keys() == {f"log.velocity.{key}" for key in right}
    for key, value in right.items():  # this robot turns some centimetres from its middle
        assert check.settings[f"log.velocity.{key}"] == pytest.approx(value, abs=0.12)
    assert not check_robot(*with_corrected(seen, robot, [check]))[-1].problem


@pytest.mark.parametrize(("side", "name"), [(0, "left"), (1, "right")])
@pytest.mark.parametrize(("share", "factor"), [(0.0, 0.0), (0.5, 0.0), (0.52, 1.0)])
def test_a_stuck_side_is_named_alone_and_replaced_by_the_gyro(log, side, name, share, factor):
    dead = dead_from(log, side, share, factor)
    found = problems(dead, ALPHA)
    assert list(found) == ["sides"]
    assert f"the {name} side repeats one reading" in found["sides"]
    skipped = {one.name for one in check_robot(dead, ALPHA) if one.in_log.startswith("not checked")}
    assert skipped == {TURNING, LATENCY, TRACK}
    mended, _ = corrected(dead, ALPHA)
    error = (mended.tracks.speeds - log.tracks.speeds).std()
    assert error < 0.2 * (dead.tracks.speeds - log.tracks.speeds).std()
    with pytest.raises(EstimatorError, match=f"the {name} side repeats one reading"):
        calibrate([dead], ALPHA)


@pytest.mark.parametrize("share", [0.0, 0.5])
@pytest.mark.parametrize(("side", "name"), [(0, "left"), (1, "right")])
def test_half_the_counts_of_a_side_are_no_radius(log, side, name, share):
    halved, begin = log.tracks.speeds.copy(), round(share * len(log.tracks.stamps))
    halved[begin:, side] *= 0.5
    broken = speeds(log, lambda _: halved)
    found = problems(broken, ALPHA)
    assert list(found) == ["ratio of the sides"]
    assert f"the {name} side reads 0.5" in found["ratio of the sides"]
    assert ("s on" in found["ratio of the sides"]) == (share > 0.0)
    mended, _ = corrected(broken, ALPHA)
    errors = [np.abs(one.tracks.speeds - log.tracks.speeds).mean() for one in (mended, broken)]
    # Samples before the first straight stretch with half the counts are not corrected.
    assert errors[0] < (0.4 if share else 0.1) * errors[1]


def test_a_robot_that_turns_about_a_side_that_it_holds_has_no_fault() -> None:
    stamps = np.arange(0, 60_000_000_000, 20_000_000)
    right = 0.5 + 0.2 * np.sin(1e-9 * stamps)
    tracks = TrackSpeedSeries(stamps, np.column_stack([0.0 * right, right]))
    assert stuck_sides(tracks, right) == []
    assert [one.side for one in stuck_sides(tracks, 0.3 * right)] == [0]


def test_an_imu_that_stops_is_named_alone(log: Log):
    rows = slice(0, len(log.imu.stamps) // 2)
    forces = log.imu.linear_acceleration[rows]
    half = ImuSeries(log.imu.stamps[rows], log.imu.angular_velocity[rows], forces)
    stopped = replace(log, imu=half)
    assert list(problems(stopped, ALPHA)) == ["IMU's span"]
    # With a stuck side, too, each is corrected in a log that the other correction has not cut.
    both = dead_from(stopped, 0, 0.2)
    checks = check_robot(both, ALPHA)
    assert [one.name for one in checks if one.problem] == ["IMU's span", "sides"]
    assert len(worth_of(both, ALPHA, checks).costs) == 2


def test_a_frozen_gyro_is_named_alone_and_estimates_use_the_rest(log: Log):
    rates, times = log.imu.angular_velocity.copy(), (log.imu.stamps - log.start) * 1e-9
    rows = (times > 0.6 * log.duration) & (times < 0.8 * log.duration)
    rates[rows] = rates[rows][0] + 0.5
    frozen = replace(log, imu=replace(log.imu, angular_velocity=rates))
    assert list(problems(frozen, ALPHA)) == ["IMU's span"]
    assert working_imu(frozen)[0].duration == pytest.approx(0.6 * log.duration, abs=0.1)
    # A robot may drive straight on with repeated readings, with noisy encoders and a spike.
    noise = np.random.default_rng(1).normal(0.4, 0.02, log.tracks.speeds.shape)
    noise[len(noise) // 2, 0] = 1.0
    straight = speeds(frozen, lambda v: 0.0 * v + noise)
    assert working_imu(straight) == (straight, "")
    # One axis may be frozen alone, and an IMU that hardly works is none.
    upright = log.imu.angular_velocity * [1.0, 1.0, 0.0]
    flat = replace(log, imu=replace(log.imu, angular_velocity=upright))
    assert list(problems(flat, ALPHA)) == ["IMU's span"]
    rates[2:] = rates[2]
    dead = replace(log, imu=replace(log.imu, angular_velocity=rates))
    assert working_imu(dead)[0].imu is None


@pytest.mark.parametrize(
    ("trajectory", "imu", "rates"),
    [
        ("random", {}, {}),
        ("straight", {}, {}),
        ("spin", {}, {}),
        ("random", {"imu.gyro_noise_density": 2e-3, "imu.gyro_bias_sigma": 0.02}, {}),
        ("random", {}, {"imu_rate": 20.0, "track_rate": 40.0}),
    ],
)
def test_a_right_file_is_left_in_peace(trajectory: str, imu: dict, rates: dict):
    robot = changed_robot(ALPHA, imu)
    scenario = Scenario(duration=60.0, seed=1, fix_rate=1.0, trajectory=trajectory, **rates)
    log = simulate(scenario, robot)
    assert problems(log, robot) == {}
    assert problems(replace(log, truth=None, fixes=None), robot) == {}


def test_a_truth_in_millimetres_is_to_be_converted_and_the_radius_stays(log: Log) -> None:
    poses = replace(log.truth.poses, poses=log.truth.poses.poses * (1000.0, 1000.0, 1.0))
    found = check_robot(replace(log, truth=replace(log.truth, poses=poses)), ALPHA)
    (wrong,) = (one for one in found if one.problem)
    assert "is the truth in mm?" in wrong.problem
    assert wrong.remedy == "convert the positions of the truth to metres"
    assert not wrong.settings


@pytest.mark.parametrize(
    ("scale", "noise", "is_found"), [(1.0, 0.0, False), (3.0, 0.0, True), (1.0, 0.12, False)]
)
def test_noise_of_encoders_is_no_scale(scale: float, noise: float, is_found: bool) -> None:
    """It reduces the slope of force on tracks to 0.5, as that of counters stamped to 1 ms does."""
    stamps = np.arange(0, 600_000_000_000, 20_000_000)
    seconds, rng = 1e-9 * stamps, np.random.default_rng(1)
    speed = 0.5 + 0.2 * np.sin(0.9 * seconds) + 0.15 * np.sin(1.7 * seconds)
    measured = scale * speed[:, None] + rng.normal(0.0, noise, (len(stamps), 1))
    forces = np.column_stack([np.gradient(speed, seconds), 0.0 * speed, np.full(len(speed), 9.81)])
    imu = ImuSeries(stamps, np.zeros((len(stamps), 3)), forces)
    log = Log("noisy", TrackSpeedSeries(stamps, np.repeat(measured, 2, axis=1)), imu)
    (check,) = check_scale(log, ALPHA)
    assert bool(check.problem) == is_found


def test_swapped_tracks_and_a_turned_imu_are_told_from_tracks_that_count_backward(log: Log):
    wrong = turned_imu(swapped(log), 0.0, 0.0, 180.0)
    found = problems(wrong, ALPHA)
    assert found.keys() == {TURNING, FORWARD}
    assert "left and right are swapped" in found[TURNING]
    assert problems(*corrected(wrong, ALPHA)) == {}
    # Without a truth, both are possible.
    bare = [one for one in check_robot(replace(wrong, truth=None), ALPHA) if one.problem]
    assert [one.name for one in bare] == [TURNING]
    assert "the IMU is turned by 180 deg" in bare[0].remedy


def test_what_is_missing_is_no_error(log: Log):
    imu, none = log.imu, TrackSpeedSeries(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    assert problems(replace(log, imu=None), ALPHA).keys() == {"IMU"}
    assert problems(replace(log, tracks=none), ALPHA).keys() == {"track speeds"}
    holed = imu.linear_acceleration.copy()
    holed[::3] = np.nan
    for some in (
        ImuSeries(imu.stamps, imu.angular_velocity, None),
        ImuSeries(imu.stamps, imu.angular_velocity, holed),
        ImuSeries(imu.stamps[:1], imu.angular_velocity[:1], imu.linear_acceleration[:1]),
    ):
        assert problems(replace(log, imu=some), ALPHA) == {}


def test_costs_are_those_of_each_error_alone(log: Log):
    robot = changed_robot(ALPHA, {"imu.gyro_bias": -0.03, "imu.gyro_bias_sigma": 0.001})
    wrong = late(speeds(log, lambda v: 1.5 * v), 0.2)
    checks = check_robot(wrong, robot)
    assert [one.name for one in checks if one.problem] == [LATENCY, SCALE, BIAS]
    worth = worth_of(wrong, robot, checks)
    of_latency, of_scale, of_bias = worth.costs
    assert worth.horizon == 30.0
    assert worth.corrected < 3.0 < 20.0 < worth.as_it_is
    # Half as much again of the way, and a rate that is soon learnt at standstill.
    assert 30.0 < of_scale < 60.0
    assert abs(of_latency) < 0.3 * of_scale
    assert abs(of_bias) < 0.3 * of_scale


def test_costs_without_a_truth_are_distances_from_the_mended_path(log: Log):
    wrong = replace(late(log, 0.2), truth=None)
    worth = worth_of(wrong, ALPHA, check_robot(wrong, ALPHA))
    assert np.isnan(worth.corrected)
    assert worth.as_it_is == worth.costs[0] > 0.1


@pytest.mark.parametrize(
    ("name", "own", "other"),
    [
        ("husky_deflated_part1", "husky-deflated", "warthog"),
        thorough("marmotte_part1", "marmotte", "husky-deflated"),
        ("warthog_grass_2024_8_8_15h56s39", "warthog", "marmotte"),
    ],
)
def test_real_logs(data_dir: Path, name: str, own: str, other: str):
    path = sample_log(data_dir, name)
    robot = load_robot(own)
    log = read_log(path, robot)
    assert problems(log, robot) == {}
    swapped = with_values(load_robot(other), log=robot.log)
    wrong = read_log(path, swapped)
    assert robot_check.is_of_another(check_robot(wrong, swapped))
    assert problems(*corrected(wrong, swapped)) == {}
    doubled = changed_robot(robot, {"vehicle.sprocket_radius": 2.0 * robot.vehicle.sprocket_radius})
    assert "diameter" in problems(read_log(path, doubled), doubled)[SCALE]


def test_a_truth_that_stays_is_named_and_not_mended(log: Log):
    poses = np.zeros_like(log.truth.poses.poses)
    truth = replace(log.truth, poses=replace(log.truth.poses, poses=poses), twists=None)
    stays = replace(log, truth=truth.positions_alone())
    (found,) = (one for one in check_robot(stays, ALPHA) if one.problem)
    assert (found.name, found.correction) == (SCALE, None)
    assert "one of them shows no motion" in found.problem
    with pytest.raises(EstimatorError, match="its truth moves 0 m while the tracks drive"):
        calibrate([stays], ALPHA)


def test_sensors_that_show_nothing_are_named(log: Log):
    still = scaled_imu(log, rates=0.0)
    assert "repeats one reading" in problems(still, ALPHA)["IMU's span"]
    absurd = scaled_imu(log, rates=1e300)
    assert problems(absurd, ALPHA).keys() == {"gyro"}
    first = TrackSpeedSeries(log.tracks.stamps[:1], log.tracks.speeds[:1])
    assert "too few" in problems(replace(log, tracks=first), ALPHA)["track speeds"]


def test_speeds_that_the_filter_refuses_have_no_result_and_no_traceback(log: Log):
    wrong = speeds(log, lambda v: 1e3 * np.abs(v) + 1e3)
    with pytest.raises(ReplayError, match="no variant has a result"):
        worth_of(wrong, ALPHA, check_robot(wrong, ALPHA))
    with pytest.raises(ReplayError, match=r"no track speeds were used: rejected .* absurdly fast"):
        compare(wrong, ALPHA, "gyro")


def test_both_report_the_jackal(data_dir: Path) -> None:
    path, robot = sample_log(data_dir, "jackal_test2.bag"), load_robot("jackal")
    (found,) = (one for one in inspected(path).findings if "odometry's yaw rate" in one)
    (one,) = (one for one in check_robot(read_log(path, robot), robot) if one.name == TURNING)
    times = found.partition(" times")[0].rpartition(" ")[2]
    assert f"the odometry's yaw rate is {times} times the gyro's" in one.problem
    assert "gauge in [log.tracks]" in one.remedy


def test_a_contradiction_whose_mending_drifts_more_is_a_note(log: Log, robot: Robot) -> None:
    """Latency by the gyro may differ from that by the path, which decides."""

    def shifted(log: Log, robot: Robot) -> tuple[Log, Robot]:
        stamps = log.tracks.stamps - 500_000_000
        return replace(log, tracks=replace(log.tracks, stamps=stamps)), robot

    wrong = Check(LATENCY, "0 s", "0.5 s").contradicted("tracks are late", "add", shifted)
    (kept,), worth, notes = judged(log, robot, [wrong])
    assert not kept.problem
    assert worth.costs == ()
    assert notes[0].startswith("tracks are late; but with that set inertia-online drifts")
    # What is no matter of the path is not decided by it.
    (kept,), _, notes = judged(log, robot, [replace(wrong, name="unit")])
    assert kept.problem
    assert not notes


def test_a_turning_centre_beyond_the_contact_is_noted(robot: Robot) -> None:
    assert robot_check.far_centre(robot) == []
    far = changed_robot(robot, {"indices.zeta0": -0.9})
    assert "is [imu] position right?" in robot_check.far_centre(far)[0]


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "mm"), (30.0 / np.pi, "rpm"), (3.6, "km/h")])
def test_a_unit_of_the_tracks_is_found_without_a_truth(log, factor, unit) -> None:
    fast = with_values(ALPHA, vehicle=with_values(ALPHA.vehicle, max_track_speed=5e3))
    wrong = scaled(factor)(replace(log, truth=None))
    (check,) = [one for one in check_robot(wrong, fast) if one.problem]
    assert (check.name, f"in {unit}?" in check.problem) == (SCALE, True)
    bare = replace(wrong, imu=replace(wrong.imu, linear_acceleration=None))
    (check,) = [one for one in check_robot(bare, fast) if one.problem]
    assert "no slip explains" in check.problem
    assert f"in {unit}?" in check.remedy


def test_track_speeds_of_commands_are_named(log) -> None:
    def of_topic(name: str) -> Robot:
        return with_values(ALPHA, log={"tracks": {"topic": name}})

    (note,) = robot_check.commanded(of_topic("/cmd_vel"))
    assert "a robot that stalls" in note
    assert robot_check.commanded(of_topic("/odom")) == []
    # It is a note, and no value that the log does not show.
    assert [one.name for one in check_robot(log, of_topic("/cmd_vel"))] == [
        one.name for one in check_robot(log, of_topic("/odom"))
    ]
