"""Calibration finds what is true of simulated robots, and says what their drives do not show.

Coverage over a hundred seeds is measured by benchmarks/calibration.py; here are a few short runs.
"""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from calibration import Case, compared, make_case

from conftest import sample, thorough
from icreckon import (
    Calibration,
    EstimatorError,
    Log,
    Robot,
    Scenario,
    Terrain,
    calibrate,
    load_robot,
    simulate,
)
from icreckon.estimator.calibration.common_values import KEPT
from icreckon.estimator.log.lever_arm import at_lever_arm
from icreckon.estimator.log.series import PoseSeries, TrackSpeedSeries, Truth
from icreckon.estimator.robot.robot_file import changed_robot
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.latency import track_latency
from icreckon.simulation.simulate import run_scenario

KINEMATIC = ("differential", "constant", "inertia")
# Of seven parameters, biases and so on, each 95 % interval misses now and then, but not by so much.
FAR = 4.0


@pytest.fixture(scope="module")
def case() -> Case:
    return make_case(4, "aggressive", {}, 120.0)


@pytest.fixture(scope="module")
def found(case: Case) -> Calibration:
    return calibrate([case.log], case.robot, models=KINEMATIC)


def test_everything_is_found_within_its_standard_errors(found: Calibration, case: Case) -> None:
    errors = {
        name: error / sigma
        for name, (error, sigma, status) in compared(case, found).items()
        if status == "shown"
    }
    indices = {"zeta0", "zeta1", "epsilon0", "epsilon1", "eta0", "eta1"}
    assert {f"indices.{name}" for name in indices} <= set(errors)
    assert {"sprocket_radius", "imu.gyro_scale", "truth.forward", "truth.left"} <= set(errors)
    assert "tracks.difference" in errors
    assert max(map(abs, errors.values())) < FAR
    assert np.mean(np.abs(list(errors.values())) < 1.96) > 0.7


def test_the_robot_has_what_was_found(found: Calibration, case: Case) -> None:
    robot = found.robot
    assert robot.vehicle.sprocket_radius == found.parameter("sprocket_radius").value
    assert robot.imu.gyro_scale == found.parameter("imu.gyro_scale").value
    written = 0
    for name in ("zeta0", "zeta1", "epsilon0", "epsilon1", "eta0", "eta1", "eta2"):
        one, value = found.parameter(f"indices.{name}"), getattr(robot.indices, name)
        if KEPT in one.note or one.status == "held":
            assert value == getattr(case.robot.indices, name)
            continue
        # What stays in the file is held for the others.
        assert abs(value - one.value) < one.sigma
        assert value != getattr(case.robot.indices, name)
        written += 1
    assert written >= 3
    assert robot.indices.H == case.robot.indices.H
    assert 0.0 < robot.imu.gyro_scale_sigma < 0.01
    assert 0.0 < robot.tracks.scale_sigma < 0.01
    assert robot.imu.gyro_bias_sigma > 0.3 * abs(case.true["gyro_bias"])
    # It is a robot that its own file format takes.
    assert msgspec.convert(msgspec.to_builtins(robot), Robot) == robot


def test_the_model_that_is_true_is_supported(found: Calibration) -> None:
    comparison = found.comparison
    assert comparison.supported == "inertia"
    first = found.verdict.split(". ")[0]
    assert first == "The data support inertia-based ICRs"
    assert comparison.difference("inertia", "constant").drift_high < 0.0
    assert comparison.score("constant").drift_percent < 0.5 * (
        comparison.score("differential").drift_percent
    )


def test_other_logs_add_what_ground_and_day_change(found: Calibration) -> None:
    for one in found.parameters:
        if one.sigma is None:
            assert one.sigma_other_logs is None, one.name
        else:
            assert one.sigma_other_logs >= one.sigma, one.name
    radius = found.parameter("sprocket_radius")
    expected = np.hypot(radius.sigma, 0.01 * radius.value)
    assert radius.sigma_other_logs == pytest.approx(expected)
    bias = found.parameter("imu.gyro_bias")
    assert bias.sigma_other_logs == bias.sigma  # each log has its own


def test_two_logs_share_the_robot_but_not_bias_and_lag(case: Case) -> None:
    """The second with a truth that is 0.2 s later, and another bias."""
    imu, poses = case.log.imu, case.log.truth.poses
    second = replace(
        case.log,
        name="second",
        imu=replace(imu, angular_velocity=imu.angular_velocity + np.array([0.0, 0.0, 0.01])),
        truth=Truth(PoseSeries(poses.stamps + 200_000_000, poses.poses)),
    )
    first = part(case.log, 0.0, 0.5)
    both = calibrate([first, part(second, 0.5, 1.0)], case.robot, models=("constant", "inertia"))
    one, other = both.logs
    assert other.lag[0] - one.lag[0] == pytest.approx(0.2, abs=0.01)
    assert other.gyro_bias[0] - one.gyro_bias[0] == pytest.approx(0.01, abs=0.001)
    assert max(abs(both.parameter(f"truth.{name}").value) for name in ("forward", "left")) < 0.35
    assert both.robot.indices.eta0 == pytest.approx(case.true["indices.eta0"], rel=0.03)


def test_latency_means_the_same_as_for_inspect(case, found):
    """Means over 0.1 s that come 0.1 s late."""
    tracks = case.log.tracks
    whole = len(tracks.stamps) // 5
    means = tracks.speeds[: 5 * whole].reshape(whole, 5, 2).mean(axis=1)
    coarse = TrackSpeedSeries(tracks.stamps[4 : 5 * whole : 5] + 100_000_000, means)
    log = replace(case.log, tracks=coarse)
    calibrated = calibrate([log], case.robot, models=("constant", "inertia"))
    before, after = (one.parameter("track_latency").value for one in (found, calibrated))
    assert after - before == pytest.approx(0.1, abs=0.03)
    vertical = log.imu.angular_velocity @ case.robot.imu_rotation[2]
    shown = track_latency(coarse, YawRates(log.imu.stamps, vertical))
    # The yaw rate follows the tracks with the lag of the forces, too, which is latency to inspect.
    assert after == pytest.approx(shown.seconds, abs=0.035)


def with_bias(log: Log, bias: float) -> Log:
    """The log of a gyro that reads so much more about its z axis [rad/s]."""
    rates = log.imu.angular_velocity + np.array([0.0, 0.0, bias])
    return replace(log, imu=replace(log.imu, angular_velocity=rates))


def test_the_gyro_bias_is_where_the_filter_starts(case: Case, found: Calibration) -> None:
    """Of one log, which says nothing about others: as uncertain as the file says."""
    bias = found.parameter("imu.gyro_bias")
    assert bias.status == "shown"
    assert bias.value == pytest.approx(
        found.logs[0].gyro_bias[0] / found.robot.imu.gyro_scale, rel=0.01
    )
    assert found.robot.imu.gyro_bias == bias.value
    assert bias.value == pytest.approx(case.true["imu.gyro_bias"], abs=FAR * bias.sigma)
    assert found.robot.imu.gyro_bias_sigma == pytest.approx(
        case.robot.imu.gyro_bias_sigma, rel=0.01
    )


@pytest.mark.parametrize(("apart", "largest"), [thorough(0.0, 0.0085), (0.02, 0.02)])
def test_logs_with_other_biases_make_it_uncertain(case: Case, apart: float, largest: float) -> None:
    """The mean over the logs; its standard deviation covers a log of either kind."""
    halves = (
        part(case.log, 0.0, 0.5),
        replace(with_bias(part(case.log, 0.5, 1.0), apart), name="second"),
    )
    found = calibrate(halves, case.robot, models=("constant",))
    each = np.array([log.gyro_bias[0] for log in found.logs])
    imu = found.robot.imu
    assert each[1] - each[0] == pytest.approx(apart, abs=0.001)
    assert found.parameter("imu.gyro_bias").value == pytest.approx(each.mean(), rel=0.02)
    assert found.parameter("imu.gyro_bias").sigma >= 0.4 * apart
    assert 0.5 * apart < imu.gyro_bias_sigma < largest
    assert imu.gyro_bias_sigma > 0.5 * case.robot.imu.gyro_bias_sigma


def test_a_short_log_changes_only_what_it_contradicts(case: Case) -> None:
    """Half a minute of a robot that is right in its file."""
    robot = found_robot(case)
    short = with_bias(part(case.log, 0.3, 0.6), robot.imu.gyro_bias - case.true["gyro_bias"])
    found = calibrate([short], robot, models=("constant", "inertia"))
    before, after = robot.indices, found.robot.indices
    stay = [
        name for name in before.__struct_fields__ if getattr(before, name) == getattr(after, name)
    ]
    assert len(stay) >= 6
    for name in ("zeta1", "eta0", "eta1"):
        one = found.parameter(f"indices.{name}")
        stays = getattr(before, name) == getattr(after, name)
        assert stays == (KEPT in one.note or one.status == "held")
        assert stays or abs(one.value - getattr(before, name)) > 1.96 * one.sigma
    assert found.robot.tracks.scale_sigma > 0.0
    # Without accelerometers the midpoint of the ICRs is held, and their spacing stays, too.
    bare = replace(short, imu=replace(short.imu, linear_acceleration=None))
    found = calibrate([bare], robot, models=("constant",))
    for name in ("x_ICRl", "x_ICRr"):
        one = found.parameter(f"constant_icr.{name}")
        assert one.status == "conditional"
        assert getattr(found.robot.constant_icr, name) == pytest.approx(one.before, abs=1e-6)
        assert KEPT in one.note


def found_robot(case: Case) -> Robot:
    """The robot as it truly is."""
    names = [name for name in case.true if name.startswith(("indices.", "tracks.difference"))]
    true = {name: case.true[name] for name in names}
    return changed_robot(case.robot, true | {"tracks.scale_sigma": 0.01})


def part(log: Log, begin: float, end: float) -> Log:
    """A share of a log."""
    return log.part(begin * log.duration, end * log.duration)


@pytest.mark.thorough
def test_without_a_known_place_the_origin_stays(case: Case) -> None:
    """A robot file that does not know where its IMU is: the lever arm is relative to its origin."""
    robot = changed_robot(case.robot, {"imu.position": (0.0, 0.0, 0.0)})
    unknown = calibrate([case.log], robot, models=("constant", "inertia"))
    for name in ("zeta0", "epsilon0"):
        held = unknown.parameter(f"indices.{name}")
        assert held.status == "held"
        assert held.value == getattr(robot.indices, name)
    assert unknown.parameter("indices.eta0").status == "shown"
    # With the lever arm given, they are found against it.
    arm = (case.true["truth.forward"], case.true["truth.left"])
    known = calibrate([case.log], robot, models=("constant", "inertia"), lever_arm=arm)
    for name in ("zeta0", "epsilon0"):
        shown = known.parameter(f"indices.{name}")
        assert shown.status == "shown"
        assert abs(shown.value - case.true[f"indices.{name}"]) < FAR * shown.sigma


def test_a_circle_at_constant_speed_shows_no_effect_of_inertia() -> None:
    circle = make_case(1, "circle", {}, 60.0)
    found = calibrate([circle.log], circle.robot, models=("constant", "inertia"))
    for name in ("zeta1", "epsilon1", "eta1", "eta2"):
        gain = found.parameter(f"indices.{name}")
        # Noise of the estimated forces looks like a little excitation: the error says that it is none.
        assert gain.status != "shown" or abs(gain.value - gain.before) < 2.0 * gain.sigma
    # One circle cannot tell the track from a difference of the radii, which is held therefore.
    assert found.parameter("tracks.difference").status == "held"
    assert found.robot.tracks.difference == circle.robot.tracks.difference
    assert found.parameter("effective_track").status == "conditional"
    assert found.comparison.supported == "constant"


def test_straight_lines_show_nothing() -> None:
    straight = make_case(1, "straight", {}, 60.0)
    with pytest.raises(EstimatorError, match=r"turned 0\.\d+ rad in all, which shows no ICR"):
        calibrate([straight.log], straight.robot)


@pytest.mark.thorough
def test_speeds_that_are_no_rates_keep_the_radius(case: Case) -> None:
    found = calibrate(
        [case.log], case.robot, models=("constant", "inertia"), speeds_by_radius=False
    )
    assert found.robot.vehicle.sprocket_radius == case.robot.vehicle.sprocket_radius
    scale = found.parameter("track_scale")
    true = case.true["sprocket_radius"] / case.robot.vehicle.sprocket_radius
    assert abs(scale.value - true) < FAR * scale.sigma
    assert found.robot.log["tracks"]["scale"] == pytest.approx(scale.value, abs=1e-4)
    unmapped = msgspec.structs.replace(case.robot, log={})
    again = calibrate([case.log], unmapped, models=("constant",), speeds_by_radius=False)
    assert again.robot.tracks.scale_sigma >= abs(again.parameter("track_scale").value - 1.0)
    assert "sprocket_radius" in again.notes[0]


def with_speeds(log: Log, speeds: np.ndarray) -> Log:
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps[: len(speeds)], speeds))


def with_rates(log: Log, factor: float) -> Log:
    rates = factor * log.imu.angular_velocity
    return replace(log, imu=replace(log.imu, angular_velocity=rates))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda log: replace(log, truth=None), "holds no pose truth"),
        (lambda log: replace(log, imu=None), "holds no IMU samples"),
        (lambda log: with_speeds(log, np.zeros((0, 2))), "holds 0 track speeds"),
        (lambda log: part(log, 0.1, 0.12), "share only"),
        (lambda log: part(log, 0.1, 0.25), r"only \d segments of 3 s"),
        (lambda log: with_rates(log, -1.0), "the gyro turned against the truth"),
        (lambda log: with_rates(log, 180.0 / np.pi), r"the gyro turns 5[0-9]\S* times as far"),
        (lambda log: with_rates(log, 0.3), r"the gyro turns 0.30\S* times as far"),
        (lambda log: with_speeds(log, log.tracks.speeds[:, ::-1]), "and right may be swapped"),
        (lambda log: with_speeds(log, -log.tracks.speeds[:, ::-1]), "drove against the truth"),
    ],
)
def test_logs_that_show_nothing_are_refused(case: Case, change: object, said: str) -> None:
    with pytest.raises(EstimatorError, match=said):
        calibrate([change(case.log)], case.robot, models=("constant",))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"models": ("constant", "inertial")}, "no model named 'inertial'"),
        ({"models": ("inertia",)}, "'constant' must be among"),
        ({"segment": 0.1}, "1 to 20 s long"),
    ],
)
def test_options_that_make_no_sense_are_refused(case, options, said):
    with pytest.raises(EstimatorError, match=said):
        calibrate([case.log], case.robot, **options)


@pytest.mark.parametrize(
    ("name", "robot_name", "radius", "track", "lag", "difference"),
    [
        # Radius and track as the README beside the logs has them, to 3 %; its lags. Differences of the
        # radii by least squares against the pose's heading.
        ("warthog_grass_2024_8_8_16h11s19", "warthog", 0.286, 1.78, 0.33, 0.018),
        thorough("husky_deflated_part1", "husky-deflated", 0.151, 0.97, 0.16, -0.055),
    ],
)
def test_real_logs_give_what_is_known_of_them(
    name, robot_name, radius, track, lag, difference, data_dir
):
    robot = load_robot(robot_name)
    log = sample(data_dir, name, robot_name)
    found = calibrate([log], robot, models=("constant", "inertia"))
    assert found.robot.vehicle.sprocket_radius == pytest.approx(radius, rel=0.03)
    assert found.parameter("effective_track").value == pytest.approx(track, rel=0.03)
    assert found.logs[0].lag[0] == pytest.approx(lag, abs=0.05)
    assert found.robot.tracks.difference == pytest.approx(difference, abs=0.006)
    # The Warthog's gyro has none, the Husky's has, and never stands still.
    bias = -0.0156 if robot_name.startswith("husky") else 0.0
    assert found.robot.imu.gyro_bias == pytest.approx(bias, abs=0.0005)
    # The file has that bias: it and this log are two that agree.
    if bias:
        confirmed = robot.imu.gyro_bias_sigma / np.sqrt(2.0)
        assert found.robot.imu.gyro_bias_sigma == pytest.approx(confirmed, rel=0.01)


ROBOT = load_robot("auriga-alpha")


def test_an_angle_is_found_within_half_a_turn_of_the_files() -> None:
    """An IMU upside down: 178° of roll are 2.1° from the -179.9° of the file."""
    real, file = (
        changed_robot(ROBOT, {"imu.rotation_rpy_deg": (roll, 0.0, 0.0)}) for roll in (178.0, -179.9)
    )
    drive = {"duration": 60.0, "trajectory": "aggressive", "truth": "kinematic", "fix_rate": 0.0}
    found = calibrate([simulate(Scenario(**drive), real)], file, models=("constant",))
    (roll,) = (row for row in found.parameters if row.name == "imu.roll")
    assert roll.before == -179.9
    # The mean of the accelerometer's bias is a part of it.
    assert roll.value == pytest.approx(-182.0, abs=1.2)
    assert found.robot.imu.rotation_rpy_deg[0] == pytest.approx(roll.value + 360.0)


def test_a_written_index_is_the_found_one_or_noted() -> None:
    log = simulate(Scenario(duration=60.0, trajectory="aggressive", fix_rate=0.0), ROBOT)
    found = calibrate([log], ROBOT, models=("constant", "inertia"))
    rows = [row for row in found.parameters if row.name.startswith("indices.") and row.sigma]
    assert len(rows) > 4
    for row in rows:
        written = getattr(found.robot.indices, row.name.removeprefix("indices."))
        assert abs(written - row.value) <= 0.1 * row.sigma or row.note, row


SCALE, BIAS = 1.02, 0.012


@pytest.mark.parametrize("drive", ["aggressive", thorough("random")])
def test_the_gyro_is_not_compared_with_headings_that_it_made(drive: str) -> None:
    """Its scale came out as 1.000 ± 0.004 where it was 1.02, since the headings were its own."""
    scenario = Scenario(duration=90.0, trajectory=drive, seed=3, fix_rate=0.0, truth="kinematic")
    made = run_scenario(scenario, ROBOT)
    imu, truth = made.log.imu, made.log.truth
    rates = SCALE * imu.angular_velocity + np.array([0.0, 0.0, BIAS])
    read = replace(imu, angular_velocity=rates)
    log = replace(made.log, imu=read, truth=truth.positions_alone())
    found = calibrate([log], ROBOT, models=("constant",))
    scale, bias = found.parameter("imu.gyro_scale"), found.parameter("imu.gyro_bias")
    assert scale.value == pytest.approx(SCALE, abs=2.5 * scale.sigma)
    true = BIAS / SCALE + float(np.mean(made.gyro_bias[:, 2]))
    assert bias.value == pytest.approx(true, abs=2.5 * bias.sigma)
    assert bias.sigma < 0.004 < scale.sigma
    assert any("Of the gyro such headings show nothing" in note for note in found.notes)


def test_on_a_slope_a_truth_without_headings_shows_no_scale_of_the_gyro() -> None:
    """The robot slides downhill: the scale came out as 1.026 ± 0.006 where it was 1."""
    slope = Terrain(slope_deg=6.0)
    scenario = Scenario(duration=60.0, trajectory="random", seed=3, fix_rate=0.0, terrain=slope)
    log = simulate(scenario, ROBOT)
    headed, found = (
        calibrate([replace(log, truth=truth)], ROBOT, models=("constant",))
        for truth in (log.truth, log.truth.positions_alone())
    )
    assert headed.parameter("imu.gyro_scale").status == "shown"
    assert found.parameter("imu.gyro_scale").status == "held"
    assert any("the ground slopes by" in note for note in found.notes)


def test_an_antenna_off_the_centre_changes_no_scale() -> None:
    """Its path is longer in bends: headings by the path of the robot made the radius 0.4 % too small."""
    scenario = Scenario(duration=60.0, trajectory="random", seed=3, fix_rate=0.0, truth="kinematic")
    log = run_scenario(scenario, ROBOT).log
    headed = calibrate([log], ROBOT, models=("constant",))
    expected, scale = headed.parameter("sprocket_radius").value, headed.parameter("imu.gyro_scale")
    # Shown is the estimate, where the file's value stays.
    assert scale.note == KEPT
    assert scale.value != headed.robot.imu.gyro_scale
    antenna = at_lever_arm(log.truth.poses, np.array([-0.4, 0.2]))
    truth = replace(log.truth, poses=antenna).positions_alone()
    for lever in (None, (-0.4, 0.2)):
        found = calibrate([replace(log, truth=truth)], ROBOT, models=("constant",), lever_arm=lever)
        assert found.parameter("sprocket_radius").value == pytest.approx(expected, rel=0.002)
