"""What inspection finds beyond topics: units, wheels, standstills, columns of tables."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_inspection import driven_log

from conftest import inspected, sample_log, thorough
from icreckon import Log, Scenario, compare, drift, inspect, read_log, simulate, write_log
from icreckon.estimator.log.series import FixSeries, ImuSeries, PoseSeries, TrackSpeedSeries, Truth
from icreckon.estimator.robot.robot_file import Robot, Vehicle, load_robot
from icreckon.replay.checking.robot_check import check_robot, is_of_another
from icreckon.replay.estimates import wheels
from icreckon.replay.estimates.imu_mounting import YawRates, estimate_mounting, vertical_rate
from icreckon.replay.inspection.findings import unit_suspicions
from icreckon.replay.inspection.log_estimates import NO_SIZES, LogEstimates
from icreckon.replay.mapping.topics import TopicMap, TrackTopic

RADIUS, TRACK = 0.2, 0.6


def in_rates(log: Log) -> Log:
    """The driven log with rates of wheels instead of speeds, and the truth of where it went."""
    speeds = log.tracks.speeds
    v, w = speeds.mean(axis=1), (speeds[:, 1] - speeds[:, 0]) / TRACK
    seconds = (log.tracks.stamps - log.tracks.stamps[0]) * 1e-9
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1]) * np.diff(seconds))])
    ways = [
        np.concatenate([[0.0], np.cumsum((v * part)[:-1] * np.diff(seconds))])
        for part in (np.cos(yaw), np.sin(yaw))
    ]
    poses = PoseSeries(log.tracks.stamps, np.column_stack([*ways, yaw]))
    tracks = TrackSpeedSeries(log.tracks.stamps, speeds / RADIUS)
    return replace(log, tracks=tracks, truth=Truth(poses))


def looked_at(log: Log):
    mounting = estimate_mounting(log)
    rates = vertical_rate(log.imu, mounting)
    return mounting, rates, wheels.wheel_estimates(log, rates, mounting.turning_correlation)


def suspicions(log: Log, *, rates: bool = False, from_twist: bool = False) -> list[str]:
    sides = {} if from_twist else {"left": ("l",), "right": ("r",)}
    tracks = TrackTopic("/speeds", **sides, unit="rad/s" if rates else "m/s")
    seen = LogEstimates(TopicMap(tracks), {}, log, NO_SIZES, *looked_at(log))
    return [*unit_suspicions(seen, log)]


def test_effective_radius_and_track() -> None:
    log = in_rates(driven_log((180.0, 5.0, 0.0)))
    _, _, estimates = looked_at(log)
    assert estimates.distance.value == pytest.approx(RADIUS, rel=0.02)
    assert estimates.distance.source == "truth"
    assert estimates.track.value == pytest.approx(TRACK / RADIUS, rel=0.05)
    _, _, estimates = looked_at(replace(log, truth=None))
    assert estimates.distance is None


def test_rates_that_are_right_are_not_suspicious() -> None:
    assert suspicions(in_rates(driven_log((0.0, 0.0, 0.0))), rates=True) == []


@pytest.mark.parametrize(
    ("seconds", "sigma"), [(100, 1.0), thorough(400, 0.02), thorough(400, 3.0)]
)
def test_noise_of_fixes_is_in_the_error_of_the_radius(seconds: int, sigma: float) -> None:
    """Straight on at 1 m/s; noise across the path makes the distances longer."""
    stamps = np.arange(50 * seconds) * 20_000_000 + 10**9
    speeds = np.ones((len(stamps), 2)) / RADIUS
    still = np.zeros((len(stamps), 3))
    log = Log("straight", TrackSpeedSeries(stamps, speeds), ImuSeries(stamps, still, still))
    ratios, sigmas = [], []
    for seed in range(20):
        poses = np.full((seconds, 3), np.nan)
        noise = np.random.default_rng(seed).normal(0.0, sigma, (seconds, 2))
        poses[:, :2] = np.column_stack([np.arange(seconds), np.zeros(seconds)]) + noise
        fixes = FixSeries(stamps[::50], poses, np.full((seconds, 2), sigma**2))
        rates = YawRates(stamps, still[:, 2])
        found = wheels.wheel_estimates(replace(log, fixes=fixes), rates, None).distance
        assert found.source == "fixes"
        ratios.append(found.value)
        sigmas.append(found.sigma)
    errors = (np.array(ratios) / RADIUS - 1.0) / (np.array(sigmas) / RADIUS)
    assert 0.3 < np.sqrt((errors**2).mean()) < 1.5


def scaled(log: Log, *, gyro: float = 1.0, force: float = 1.0, tracks: float = 1.0) -> Log:
    rates, forces = log.imu.angular_velocity * gyro, log.imu.linear_acceleration * force
    speeds = TrackSpeedSeries(log.tracks.stamps, log.tracks.speeds * tracks)
    return replace(log, imu=ImuSeries(log.imu.stamps, rates, forces), tracks=speeds)


@pytest.mark.parametrize(
    ("factors", "part"),
    [
        ({}, ""),
        ({"gyro": 180.0 / np.pi}, "or rather deg/s"),
        ({"force": 1.0 / 9.80665}, r"not 9.81 m/s²; in g\?"),
        ({"force": 1000.0 / 9.80665}, r"in mg\?"),
        ({"force": 0.8}, "not 9.81 m/s²"),
        ({"tracks": 1000.0}, "or rather mm/s"),
    ],
)
def test_units_that_are_wrong_are_suspicious(factors: dict[str, float], part: str) -> None:
    said = suspicions(scaled(driven_log((0.0, 0.0, 0.0)), **factors))
    assert len(said) == bool(part)
    assert re.search(part, str(said))


def test_a_slow_gyro_in_degrees_is_found_against_odometry() -> None:
    log = driven_log((0.0, 0.0, 0.0))
    log = scaled(log, gyro=0.1 * 180.0 / np.pi, tracks=0.1)
    v, w = log.tracks.speeds.mean(axis=1), np.diff(log.tracks.speeds, axis=1)[:, 0] / TRACK
    twists = np.column_stack([v - 0.5 * w, v + 0.5 * w])
    log = replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, twists))
    (said,) = suspicions(log, from_twist=True)
    assert "times the odometry's yaw rate; in deg/s?" in said


@pytest.mark.parametrize(
    ("left", "right", "is_stuck"),
    [(lambda k: 0.5 + 0.01 * k, 0.0, True), (lambda k: 0.22 + 0.01 * (k % 3), 0.22, False)],
    ids=["stuck", "a coarse encoder at a steady speed"],
)
def test_a_side_that_is_stuck_is_a_finding(tmp_path: Path, left, right, is_stuck) -> None:
    rows = [f"{0.1 * k:.1f},{left(k):.2f},{right}" for k in range(200)]
    path = tmp_path / "table.csv"
    path.write_text("\n".join(["t,left_speed,right_speed", *rows]), encoding="utf-8")
    found = any("the right side repeats one reading" in text for text in inspect(path).findings)
    assert found == is_stuck


def test_a_side_that_is_stuck_for_a_while_does_not_change_the_effective_track(
    tmp_path: Path,
) -> None:
    robot = load_robot("auriga-alpha")
    whole = simulate(Scenario(duration=120.0, seed=2, fix_rate=0.0), robot)
    speeds, times = whole.tracks.speeds.copy(), whole.tracks.stamps - whole.start
    stuck = (times > 50e9) & (times < 80e9)
    speeds[stuck, 0] = 0.6
    failing = replace(whole, tracks=TrackSpeedSeries(whole.tracks.stamps, speeds))
    found = []
    for name, log in (("whole", whole), ("failing", failing)):
        write_log(log, tmp_path / name, "mcap", robot)
        inspection = inspect(tmp_path / name)
        found.append(inspection.track.whole)
    assert any("the left side repeats one reading" in text for text in inspection.findings)
    assert found[1] == pytest.approx(found[0], rel=0.02)


def long_stops(log: Log) -> list[tuple[float, float, bool]]:
    """Stops of a second or more: start, end [s], and whether gyros turn meanwhile."""
    stops = wheels.standstills(log)
    in_seconds = ((1e-9 * (a - log.start), 1e-9 * (b - log.start), turns) for a, b, turns in stops)
    return [stop for stop in in_seconds if stop[1] - stop[0] >= 1.0]


def test_gaps_of_a_driver_that_sends_nothing_at_rest_are_standstills() -> None:
    options = {"drive": 6.0, "rest": 10.0}
    scenario = Scenario(duration=50.0, seed=3, trajectory="stop-and-go", trajectory_options=options)
    log = simulate(scenario, load_robot("auriga-alpha"))
    speed = np.abs(log.tracks.speeds).max(axis=1)
    sends = speed > 0.02 * speed.max()
    tracks = TrackSpeedSeries(log.tracks.stamps[sends], log.tracks.speeds[sends])
    found, silent = (long_stops(one) for one in (log, replace(log, tracks=tracks)))
    # Before the first and after the last track speeds, nothing shows a rest.
    assert [stop[:2] for stop in silent] == [
        pytest.approx(stop[:2], abs=0.5) for stop in found[1:3]
    ]


@pytest.mark.parametrize(
    "other",
    [
        *("current_{}_a", "{}_cmd_m_s", "v_battery_{}_volt", "temp_{}_speed", "{}_torque_enc"),
        *("{}_motor_A", "{}_status", "{}_joystick", "sonar_{}", "{}_wheel_load", "{}_position"),
        *("{}_error", "{}_m_s_sp"),
    ],
)
def test_columns_of_another_quantity_are_no_speeds(other: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    sides = ("left", "right")
    names = [*map(other.format, sides), *map("{}_m_s".format, sides)]
    path.write_text(f"t,{','.join(names)}\n0.0,1,2,3,4\n0.1,2,3,4,5\n", encoding="utf-8")
    columns = inspect(path).mapping.columns
    assert (columns.tracks.left, columns.tracks.right) == (("left_m_s",), ("right_m_s",))
    alone = tmp_path / "alone.csv"
    alone.write_text(f"t,{','.join(names[:2])}\n0.0,1,2\n0.1,2,3\n", encoding="utf-8")
    assert inspect(alone).mapping.columns.tracks is None


@pytest.mark.parametrize(
    ("name", "radius", "track"),
    [
        ("warthog_grass_2024_8_8_16h11s19", 0.286, 1.78),
        ("warthog_asphalt_2024_9_25_12h8s57", 0.278, 1.85),
        ("marmotte_part1", 0.113, 0.60),
        ("husky_deflated_part1", 0.151, 0.97),
    ],
)
def test_sample_logs_show_their_wheels(data_dir, name, radius, track):
    path = sample_log(data_dir, name)
    robot = Robot("x", Vehicle(1.0, 1.0, 1.0))
    found = inspected(path)
    log = read_log(path, robot, topics=found.mapping)
    _, _, estimates = looked_at(log)
    # The README beside the logs has these by least squares.
    distance, sigma, _ = estimates.distance
    assert distance == pytest.approx(radius, rel=0.04)
    # Few windows of straight driving show no error; then the usual one is proposed.
    assert sigma is None or 0.0 < sigma < 0.02 * radius
    (proposed,) = re.findall(r"^scale_sigma = (\S+)", found.proposed_robot_file, re.MULTILINE)
    assert 0.01 <= float(proposed) <= 0.02
    assert (float(proposed) == 0.02) == (sigma is None)
    assert estimates.track.value * distance == pytest.approx(track, rel=0.06)
    assert not any(said.startswith("suspicious") for said in found.findings)


def test_a_sample_log_whose_odometry_turns_too_much(data_dir: Path) -> None:
    found = inspected(sample_log(data_dir, "jackal_test2.bag"))
    assert any("odometry's yaw rate" in said for said in found.findings)
    found = inspected(sample_log(data_dir, "husky_test1.bag"))
    assert not any(said.startswith("suspicious") for said in found.findings)
    assert any("standstills: 1, 10 s in all" in said for said in found.findings)
    # The maker's controller goes by 0.55 m times 1.875, which is a little much for this ground: turning
    # integrated over 1 to 20 s, after the tracks' lateness of 0.43 s, is 0.91 to 0.95 times the gyro's.
    (ratio,) = re.findall(
        r"^eta0 = .*effective track by the gyro: (\S+) times the controller",
        found.proposed_robot_file,
        re.MULTILINE,
    )
    assert float(ratio) == pytest.approx(0.93, abs=0.03)


@pytest.mark.parametrize(
    ("name", "radius", "gauge"),
    [
        ("jackal_test2.bag", None, 0.376),
        thorough("husky_test1.bag", None, 0.55),
        thorough("husky_deflated_part1", 0.151, 0.55),
        thorough("marmotte_part1", 0.113, 0.35),
        thorough("warthog_grass_2024_8_8_15h56s39", 0.288, 1.08),
    ],
)
def test_a_proposed_robot_file_needs_no_more_than_what_no_log_can_tell(
    data_dir: Path, tmp_path: Path, name: str, radius: float | None, gauge: float
) -> None:
    path, file = sample_log(data_dir, name), tmp_path / "robot.toml"
    text = inspected(path).proposed_robot_file
    # A truth shows the radius, and with it the gyro the effective track: only the mass is left.
    assert text.count("= nan") == (1 if radius else 2)
    text = text.replace("mass = nan", "mass = 50.0").replace("gauge = nan", f"gauge = {gauge}")
    file.write_text(text, encoding="utf-8")
    robot = load_robot(file)
    log = read_log(path, robot)
    assert np.abs(log.tracks.speeds).max() < robot.vehicle.max_track_speed
    if radius:
        assert robot.vehicle.sprocket_radius == pytest.approx(radius, rel=0.04)
        assert not is_of_another(check_robot(log, robot))
    comparison = compare(log, robot, ["constant-online"])
    found = comparison.runs["constant-online"]
    assert len(found.stamps) > 0.9 * len(log.tracks.stamps)
    gyro = found.health.sensors["gyro"]
    assert sum(gyro.rejected.values()) < 0.05 * gyro.used
    if (truth := comparison.log.truth) is not None:
        # The files that ship were fitted to the truth of these logs and drift by 2 to 6 %.
        assert drift(found.trajectory.pose_series, truth.poses, 30.0).percent_mean < 7.0


@pytest.mark.parametrize(
    ("name", "bias"), [("husky_deflated_part1", -0.0156), ("marmotte_part1", None)]
)
def test_driving_shows_the_bias_of_a_gyro(data_dir: Path, name: str, bias: float | None) -> None:
    """Husky and Marmotte never stand; the truth shows -0.0156 rad/s on the one, none on the other."""
    proposed = tomllib.loads(inspected(sample_log(data_dir, name)).proposed_robot_file)
    assert proposed["imu"].get("gyro_bias") == (bias and pytest.approx(bias, abs=0.0005))


def test_half_the_counts_and_an_imu_that_stops_are_findings(tmp_path: Path) -> None:
    log = driven_log((0.0, 0.0, 0.0))
    half = replace(log.tracks, speeds=log.tracks.speeds * [1.0, 0.5])
    for broken, said in (
        (replace(log, tracks=half), "the right side reads 0.50 times what the other one reads"),
        (replace(log, imu=log.part(0.0, 60.0).imu), "the IMU has no samples, for 60 of 120 s"),
    ):
        write_log(broken, tmp_path / "log", "mcap", load_robot("auriga-alpha"), overwrite=True)
        assert said in "\n".join(inspect(tmp_path / "log").findings)


def test_a_hole_of_one_stream_shows_no_turning(tmp_path: Path) -> None:
    """Tracks without samples for 20 s, while the gyro turns: the effective track was 0.58 times."""
    log = driven_log((0.0, 0.0, 0.0))
    times = 1e-9 * (log.tracks.stamps - log.start)
    kept = (times < 50.0) | (times > 70.0)
    tracks = TrackSpeedSeries(log.tracks.stamps[kept], log.tracks.speeds[kept])
    widths = []
    for name, one in (("whole", log), ("holed", replace(log, tracks=tracks))):
        write_log(one, tmp_path / name, "mcap", load_robot("auriga-alpha"))
        widths.append(inspect(tmp_path / name).track.whole)
    assert widths[1] == pytest.approx(widths[0], rel=0.02)


def test_where_the_imu_fails_no_side_is_blamed(tmp_path: Path) -> None:
    robot = load_robot("auriga-alpha")
    log = simulate(Scenario(duration=110.0, seed=3, trajectory="stop-and-go"), robot)
    times = 1e-9 * (log.imu.stamps - log.start)
    kept = (times < 60.0) | (times > 75.0)
    forces = log.imu.linear_acceleration[kept]
    holed = ImuSeries(log.imu.stamps[kept], log.imu.angular_velocity[kept], forces)
    write_log(replace(log, imu=holed), tmp_path / "log", "mcap", robot)
    text = "\n".join(inspect(tmp_path / "log").findings)
    assert "the IMU has no samples, for 15 of 110 s" in text
    assert "side reads" not in text


def test_an_effective_track_that_is_hardly_seen_is_not_proposed(data_dir: Path) -> None:
    """On ice the tracks turn and the robot hardly does: 0.08 m ± 0.07 m for a gauge of 0.57 m."""
    assert inspected(sample_log(data_dir / "borealtc", "ice_08.parquet")).track is None


def test_a_gap_between_slow_speeds_is_one_stop_with_its_ends() -> None:
    stamps = 10**9 * np.array([0, 1, 2, 3, 33, 34, 35, 36])
    speeds = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0])
    log = Log("paused", TrackSpeedSeries(stamps, np.column_stack([speeds, speeds])))
    assert wheels.standstills(log) == [(2 * 10**9, 34 * 10**9, False)]


def test_track_speeds_of_zero_while_the_robot_turns_are_no_standstill(tmp_path: Path) -> None:
    """A driver that fails, or a robot that is carried: its turning is no bias of the gyro."""
    scenario = Scenario(duration=60.0, seed=3, trajectory="slalom")
    log = simulate(scenario, load_robot("auriga-alpha"))
    speeds = log.tracks.speeds.copy()
    times = (log.tracks.stamps - log.start) * 1e-9
    speeds[(times > 30.0) & (times < 50.0)] = 0.0
    broken = replace(log, tracks=replace(log.tracks, speeds=speeds))
    found = long_stops(broken)
    assert [stop for stop in found if not stop[2]] == long_stops(log)
    assert [stop[:2] for stop in found if stop[2]] == [pytest.approx((30.0, 50.0), abs=0.1)]
    write_log(broken, tmp_path / "log", "mcap", load_robot("auriga-alpha"))
    sound_bag = write_log(log, tmp_path / "sound", "mcap", load_robot("auriga-alpha"))
    found, sound = (inspect(one) for one in (tmp_path / "log", sound_bag))
    text = "\n".join(found.findings)
    assert found.track.whole == pytest.approx(sound.track.whole, rel=0.01)
    assert "at rest while the gyro turns, 30 to 50 s: carried, or no track speeds?" in text


@pytest.mark.parametrize(
    ("names", "left", "left_out"),
    [
        ("VL [rpm];HL [rpm];VR [rpm];HR [rpm]", ("VL [rpm]", "HL [rpm]"), ""),
        ("rpm_l;rpm_r;rpm_x1;rpm_x2", ("rpm_l",), "tracks: rpm_x1, rpm_x2 not used"),
        ("v_l;v_r;pos_x_mm;pos_y_mm", ("v_l",), "positions not used: pos_x_mm, pos_y_mm"),
    ],
)
def test_columns_that_are_left_out_are_named(tmp_path: Path, names, left, left_out) -> None:
    times = np.arange(0.0, 20.0, 0.05)
    rows = np.column_stack([times, *(np.sin(0.3 * times + k) for k in range(4))])
    np.savetxt(tmp_path / "log.csv", rows, "%.5f", ";", header=f"t;{names}", comments="")
    found = inspect(tmp_path / "log.csv")
    assert found.mapping.columns.tracks.left == left
    named = [text for text in found.findings if "not used" in text]
    assert len(named) == bool(left_out)
    assert all(text.startswith(left_out) for text in named)
