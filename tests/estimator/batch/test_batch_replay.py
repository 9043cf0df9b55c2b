"""Variants side by side over one log say what the streaming filter says, in all rows and counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import sample_log, thorough
from icreckon.estimator.base.errors import BatchError, EstimatorError
from icreckon.estimator.batch import replay_rows
from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ZeroVelocity
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import FixSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import GateSettings, Settings
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.sensors.measurement_models import ACCELEROMETERS
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.run import run
from icreckon.replay.comparison import compare as comparison
from icreckon.replay.comparison.compare import compare
from icreckon.replay.comparison.fixes import parse_part, with_fixes_within
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

ROBOT = load_robot("auriga-alpha")
# What rounding may come to, in standard deviations. Where track speeds are hardly known, the gyro cuts
# the variance of the yaw rate to a billionth, of which doubles have seven digits left.
ROUNDING, FEW_DIGITS = 1e-8, 1e-6


@cache
def drive(
    duration: float = 25.0, fix_rate: float = 0.0, antenna: tuple[float, float] = (0.0, 0.0)
) -> Log:
    """A drive whose sensors sample at no regular times, none of them when another does.

    Its fixes are those of base_link, whatever place the antenna claims.
    """
    log = simulate(Scenario(duration=duration, seed=5, fix_rate=fix_rate), ROBOT)
    rng = np.random.default_rng(1)

    def late(stamps: np.ndarray, most: int) -> np.ndarray:
        return np.asarray(np.sort(stamps + rng.integers(0, most, len(stamps))))

    assert log.imu is not None
    tracks = replace(log.tracks, stamps=late(log.tracks.stamps, 18_000_000))
    imu = replace(log.imu, stamps=late(log.imu.stamps, 9_000_000))
    fixes = log.fixes
    if fixes is not None:
        inner = slice(1, -1)
        stamps = late(fixes.stamps[inner], 150_000_000)
        antennas = np.tile(antenna, (len(stamps), 1)) if any(antenna) else None
        fixes = FixSeries(stamps, fixes.poses[inner], fixes.variances[inner], antennas)
    return replace(log, tracks=tracks, imu=imu, fixes=fixes, truth=None)


def without(log: Log, stream: str, start: float, end: float) -> Log:
    """A log whose IMU or track speeds are silent for a while [s]."""
    series: Any = getattr(log, stream)
    since = (series.stamps - log.start) * 1e-9
    kept = (since < start) | (since > end)
    columns = ("speeds", "angular_velocity", "linear_acceleration")
    changes = {name: getattr(series, name)[kept] for name in columns if hasattr(series, name)}
    return replace(log, **{stream: replace(series, stamps=series.stamps[kept], **changes)})


def every(log: Log, stream: str, step: int) -> Log:
    """A log of which the IMU or the track speeds are slower."""
    series: Any = getattr(log, stream)
    columns = ("stamps", "speeds", "angular_velocity", "linear_acceleration")
    changes = {name: getattr(series, name)[::step] for name in columns if hasattr(series, name)}
    return replace(log, **{stream: replace(series, **changes)})


def off(found: np.ndarray, expected: np.ndarray, sigmas: np.ndarray) -> float:
    return float((np.abs(found - expected) / np.where(sigmas > 0.0, sigmas, 1.0)).max())


def assert_same_run(
    found: Run, expected: Run, rounding: float = ROUNDING, *, stale: bool = False
) -> None:
    """All rows, counts and innovations are the same, to rounding.

    If track speeds are stale at most rows, accelerometers are used between rows only. Lanes have
    innovations of the steps of rows; the streaming filter has the newest one.
    """
    assert found.variant == expected.variant
    np.testing.assert_array_equal(found.stamps, expected.stamps)
    sigmas = expected.state_sigmas.copy()
    # A fast slip of less than 1 µm/s is what is left of larger numbers that cancel.
    fast = [k for k, name in enumerate(expected.state_names) if name.startswith("fast_slip")]
    sigmas[:, fast] = np.maximum(sigmas[:, fast], 1e-6)
    assert off(found.states, expected.states, sigmas) < rounding
    assert off(found.state_sigmas, expected.state_sigmas, sigmas) < rounding
    here, there = found.trajectory, expected.trajectory
    scale = sigmas[:, :3, None] * sigmas[:, None, :3]
    assert off(here.pose_covariances, there.pose_covariances, scale) < rounding
    spread = np.sqrt(np.diagonal(there.twist_covariances, axis1=1, axis2=2))
    # A twist that nothing is known to be wrong of has no sigma worth the name.
    assert off(here.twists, there.twists, np.maximum(spread, 1e-6)) < rounding
    scale = np.maximum(spread[:, :, None] * spread[:, None], 1e-12)
    assert off(here.twist_covariances, there.twist_covariances, scale) < rounding
    np.testing.assert_allclose(found.indices, expected.indices, rtol=1e-9, atol=1e-9)
    assert found.state_names == expected.state_names
    between_rows = ACCELEROMETERS if stale else ()
    assert {*found.innovation_names, *between_rows} == {*expected.innovation_names, *between_rows}
    for name in found.innovation_names:
        mine = found.innovations[:, found.innovation_names.index(name)]
        theirs = expected.innovations[:, expected.innovation_names.index(name)]
        told = np.isfinite(mine)
        np.testing.assert_allclose(mine[told], theirs[told], rtol=1e-5, atol=1e-6)
        # The accelerometer's of the sample before the one at which the robot was found standing.
        assert (np.isfinite(theirs) & ~told).sum() <= 3 or name in between_rows
    assert_same_counts(found, expected, between_rows)


def assert_same_counts(found: Run, expected: Run, between_rows: Sequence[str] = ()) -> None:
    assert found.health.sensors.keys() == expected.health.sensors.keys()
    for name in ("standstill_updates", "track_gaps", "stuck_tracks", "clock_steps"):
        assert getattr(found.health, name) == getattr(expected.health, name)
    for name, sensor in expected.health.sensors.items():
        mine = found.health.sensors[name]
        for count in ("used", "rejected", "degrees", "late", "judged_count", "reacquired"):
            assert getattr(mine, count) == getattr(sensor, count), (name, count)
        if name in between_rows:
            continue
        for sum_ in ("nis_sum", "newest_nis", "recent_nis"):
            theirs = getattr(sensor, sum_)
            assert getattr(mine, sum_) == (theirs and pytest.approx(theirs, rel=1e-6))
        assert (mine.newest is None) == (sensor.newest is None)
        if mine.newest is not None and sensor.newest is not None:
            assert mine.newest[:2] == sensor.newest[:2]
            assert mine.newest.residual == pytest.approx(sensor.newest.residual, rel=1e-6)
            here, there = np.array(mine.newest.covariance), np.array(sensor.newest.covariance)
            np.testing.assert_allclose(here, there, rtol=1e-6)


def assert_same(
    log: Log,
    *variants: str,
    robot: Robot = ROBOT,
    settings: Settings | None = None,
    rounding: float = ROUNDING,
    stale: bool = False,
) -> dict[str, Run]:
    start, sigma = (1.0, -2.0, 0.3), (0.02, 0.02, 0.01)
    runs = run_side_by_side(log, robot, variants, settings=settings, start=start, start_sigma=sigma)
    assert list(runs) == list(variants)
    for variant, found in runs.items():
        expected = run(log, robot, variant, settings=settings, start=start, start_sigma=sigma)
        assert_same_run(found, expected, rounding, stale=stale)
    return runs


@pytest.mark.thorough
def test_all_variants_in_one_pass_say_what_each_says_alone() -> None:
    runs = assert_same(drive(), *VARIANTS)
    health = runs["inertia-online"].health
    assert health.standstill_updates > 0
    assert health.sensors["gyro"].rejected.get("gate", 0) + health.sensors["gyro"].used > 2000


SILENCES: dict[str, Callable[[Log], Log]] = {
    "the IMU begins later": lambda log: without(log, "imu", -1.0, 0.5),
    "track speeds begin later": lambda log: without(log, "tracks", -1.0, 0.5),
    "no IMU for a moment": lambda log: without(log, "imu", 15.0, 15.2),
    "no IMU for seconds": lambda log: without(log, "imu", 10.0, 12.0),
    "the IMU ends early": lambda log: without(log, "imu", 24.7, 99.0),
    "the IMU ends long before": lambda log: without(log, "imu", 20.0, 99.0),
    "track speeds end early": lambda log: without(log, "tracks", 22.0, 99.0),
    "no track speeds for seconds": lambda log: without(log, "tracks", 10.0, 12.0),
    "nothing for seconds": lambda log: without(
        without(log, "tracks", 10.0, 12.0), "imu", 10.1, 12.1
    ),
    "an IMU slower than the tracks": lambda log: every(log, "imu", 5),
    "an IMU too slow to wait for": lambda log: every(log, "imu", 40),
    "slow IMU, no track speeds": lambda log: without(every(log, "imu", 5), "tracks", 10.0, 12.0),
}


@pytest.mark.parametrize("name", SILENCES)
@pytest.mark.parametrize("fix_rate", [0.0, 5.0])
def test_silent_and_slow_sensors(name: str, fix_rate: float) -> None:
    log = SILENCES[name](drive(fix_rate=fix_rate))
    runs = assert_same(log, "constant-online")
    gaps = runs["constant-online"].health.track_gaps
    assert (gaps > 0) == (
        name in {"no track speeds for seconds", "nothing for seconds"} or "no track" in name
    )


def test_tracks_that_are_seldom_told() -> None:
    log = every(drive(), "tracks", 25)
    assert_same(log, "constant-online", rounding=FEW_DIGITS, stale=True)


def test_a_track_that_is_stuck() -> None:
    log = drive()
    speeds = log.tracks.speeds.copy()
    speeds[400:800, 0] = speeds[400, 0]
    log = replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, speeds))
    runs = assert_same(log, "constant-online", rounding=FEW_DIGITS)
    assert runs["constant-online"].health.stuck_tracks > 0


def test_gates_that_refuse_and_give_in() -> None:
    log = drive()
    assert log.imu is not None
    rates = log.imu.angular_velocity.copy()
    rates[1000:1003, 2] += 5.0
    rates[1500:1520, 2] += 50.0
    spiky = replace(log, imu=replace(log.imu, angular_velocity=rates))
    runs = assert_same(spiky, "inertia-online", settings=Settings(gates=GateSettings(patience=8)))
    gyro = runs["inertia-online"].health.sensors["gyro"]
    assert gyro.rejected["jumped"] >= 3 + 20
    # Of one that comes slowly, the gate refuses the first ones and then gives in.
    rates = log.imu.angular_velocity.copy()
    rates[1500:1540, 2] += 6.0 - np.abs(np.linspace(-6.0, 6.0, 40))
    slowly = replace(log, imu=replace(log.imu, angular_velocity=rates))
    runs = assert_same(slowly, "inertia-online", settings=Settings(gates=GateSettings(patience=8)))
    gyro = runs["inertia-online"].health.sensors["gyro"]
    assert gyro.rejected["gate"] >= 8
    assert gyro.reacquired > 0


def test_fixes_of_all_kinds() -> None:
    """With a heading and without; of a path that jumps, and of one that is turned."""
    log = drive(fix_rate=5.0)
    assert log.fixes is not None
    poses, variances = log.fixes.poses.copy(), log.fixes.variances.copy()
    poses[::2, 2], variances[::2, 1] = 0.2, 0.5
    assert_same(replace(log, fixes=FixSeries(log.fixes.stamps, poses, variances)), "inertia-online")
    poses = log.fixes.poses.copy()
    poses[60:, 0] += 3.0
    jumped = replace(log, fixes=FixSeries(log.fixes.stamps, poses, log.fixes.variances))
    runs = assert_same(jumped, "constant-online")
    assert runs["constant-online"].health.sensors["position"].rejected["gate"] > 0
    poses[60:, :2] = np.column_stack([5.0 - poses[60:, 1], poses[60:, 0] - 3.0])
    assert_same(
        replace(log, fixes=FixSeries(log.fixes.stamps, poses, log.fixes.variances)),
        "constant-online",
    )


def test_wrong_headings_of_some_fixes_are_used_after_the_same_time() -> None:
    """Every third fix has a heading; those of 12 s are 0.6 rad off."""
    scenario = Scenario(duration=40.0, seed=3, trajectory="random", fix_rate=5.0)
    log = simulate(scenario, ROBOT)
    fixes, truth = log.fixes, log.truth
    assert fixes is not None
    assert truth is not None
    at, poses, variances = (
        (fixes.stamps - log.start) * 1e-9,
        fixes.poses.copy(),
        fixes.variances.copy(),
    )
    yaws = interpolate_poses(truth.poses, fixes.stamps)[:, 2] + 0.6 * ((at > 20.0) & (at < 32.0))
    poses[::3, 2], variances[::3, 1] = yaws[::3], 1e-4
    headed = replace(log, fixes=FixSeries(fixes.stamps, poses, variances))
    expected = run(headed, ROBOT, "constant-online")
    assert expected.health.sensors["heading"].reacquired > 0
    (found,) = run_side_by_side(headed, ROBOT, ("constant-online",)).values()
    assert_same_run(found, expected, FEW_DIGITS)


def test_fixes_of_an_antenna() -> None:
    """Also of one that is not where it claims to be, and of a path that jumps and turns."""
    log = drive(fix_rate=5.0, antenna=(0.4, -0.3))
    assert log.fixes is not None
    assert_same(log, "inertia-online")
    poses = log.fixes.poses.copy()
    poses[60:, :2] = np.column_stack([5.0 - poses[60:, 1], poses[60:, 0] - 3.0])
    turned = replace(log, fixes=replace(log.fixes, poses=poses))
    runs = assert_same(turned, "constant-online")
    assert runs["constant-online"].health.sensors["position"].rejected["gate"] > 0


@pytest.mark.parametrize("start", [(1.0, -2.0, 0.3), (40.0, -2.0, 0.3)], ids=["right", "wrong"])
def test_fixes_before_the_first_track_speeds(start: tuple[float, float, float]) -> None:
    log = without(drive(fix_rate=5.0), "tracks", -1.0, 2.0)
    assert log.fixes is not None
    assert (log.fixes.stamps < log.tracks.stamps[0]).sum() > 5
    sigma = (0.02, 0.02, 0.01)
    given: dict[str, Any] = {"start": start, "start_sigma": sigma}
    (found,) = run_side_by_side(log, ROBOT, ("constant-online",), **given).values()
    assert_same_run(found, run(log, ROBOT, "constant-online", **given))


@pytest.mark.parametrize("late", [-2, 0, 3, 6], ids="{} ms".format)
def test_a_fix_next_to_the_first_track_speeds(late: int) -> None:
    log = drive(fix_rate=5.0)
    assert log.fixes is not None
    stamps = log.fixes.stamps.copy()
    stamps[0] = log.tracks.stamps[0] + late * 1_000_000
    assert_same(replace(log, fixes=replace(log.fixes, stamps=stamps)), "constant-online")


@pytest.mark.parametrize(
    "settings",
    [
        thorough(Settings(use_accelerometer=False)),
        Settings(hold=0.02),
    ],
    ids=["no accelerometer", "hold"],
)
def test_settings(settings: Settings) -> None:
    assert_same(drive(), "inertia-online", settings=settings, stale=settings.hold < 0.1)


def test_an_imu_without_accelerometers() -> None:
    log = drive()
    assert log.imu is not None
    log = replace(log, imu=replace(log.imu, linear_acceleration=None))
    runs = assert_same(log, "constant-online")
    assert not {*ACCELEROMETERS} & {*runs["constant-online"].health.sensors}


def test_a_log_of_the_shortest_kind() -> None:
    log = drive()
    begin = int(log.tracks.stamps[0])
    for seconds in (0.01, 0.05):
        short = log.between(log.start, begin + int(seconds * 1e9))
        assert_same(short, "constant-online")


@pytest.mark.parametrize(
    ("name", "robot_name", "part"),
    [
        thorough("husky_test1.bag", "husky", None),
        thorough("jackal_test2.bag", "jackal", None),
        thorough("warthog_grass_2024_8_8_15h56s39", "warthog", "0:40%"),
        thorough("marmotte_part1", "marmotte", None),
        ("husky_deflated_part1", "husky-deflated", "0:40%"),
    ],
)
def test_real_logs(data_dir: Path, name: str, robot_name: str, part: str | None) -> None:
    """Clocks that are not even, holes, and fixes that show that the robot was lost."""
    robot = load_robot(robot_name)
    log = read_log(sample_log(data_dir, name), robot)
    if part is not None:
        log = with_fixes_within(log, parse_part(part))
    assert_same(log, "constant-online", "inertia-online", robot=robot)


def test_older_judgements_matter_less_than_rounding() -> None:
    assert 0.99**replay_rows.OUTPUT_AT_END < 1e-12


def test_what_cannot_be_taken_is_refused_by_name() -> None:
    log = drive()
    assert log.imu is not None
    begin = int(log.tracks.stamps[0])

    def refused(log: Log, why: str, *variants: str, settings: Settings | None = None) -> None:
        with pytest.raises(BatchError, match=why):
            run_side_by_side(log, ROBOT, variants or ("constant-online",), settings=settings)

    refused(replace(log, imu=None), "no IMU")
    refused(replace(log, others=(ZeroVelocity(begin, (0.1, 0.1, 0.1)),)), "ZeroVelocity")
    refused(log, "engine", settings=Settings(engine="plain"))
    forces = log.imu.linear_acceleration
    assert forces is not None
    forces = forces.copy()
    forces[7] = np.nan
    refused(replace(log, imu=replace(log.imu, linear_acceleration=forces)), "without forces")
    broken = FixSeries(np.array([begin + 10**9]), np.zeros((1, 3)), -np.ones((1, 2)))
    refused(replace(log, fixes=broken), "fixes that are no numbers")
    stamps = log.tracks.stamps.copy()
    stamps[500:] += 200 * 10**9
    later = replace(log, tracks=TrackSpeedSeries(stamps, log.tracks.speeds), imu=log.imu)
    refused(later, "longest_gap")
    empty = TrackSpeedSeries(np.zeros(0, np.int64), np.zeros((0, 2)))
    with pytest.raises(EstimatorError, match="no track speeds"):
        run_side_by_side(replace(log, tracks=empty), ROBOT, ("constant-online",))
    with pytest.raises(EstimatorError, match="start_sigma must be three finite numbers"):
        run_side_by_side(log, ROBOT, ("constant-online",), start_sigma=(0.0, -1.0, 0.0))
    assert run_side_by_side(log, ROBOT, ()) == {}


def test_long_logs_are_compared_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    log = drive(fix_rate=5.0)
    log = replace(log, truth=simulate(Scenario(duration=25.0, seed=5), ROBOT).truth)
    variants = ("constant-online", "inertia-fixed", "inertia-online")
    apart = compare(log, ROBOT, variants)
    monkeypatch.setattr(comparison, "MANY_SAMPLES", 1000)
    told: list[float] = []
    monkeypatch.setattr(comparison, "run", _not_streamed)
    together = compare(log, ROBOT, variants, progress=told.append)
    assert list(together.runs) == list(variants)
    for variant, found in together.runs.items():
        assert_same_run(found, apart.runs[variant])
    assert told == sorted(told)
    assert told[0] < 0.5 < told[-1] <= 1.0


def test_processes_are_for_what_cannot_run_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    log, asked = drive(), []
    log = log.between(log.start, log.start + 12 * 10**9)
    others = (ZeroVelocity(int(log.tracks.stamps[50]), (0.1, 0.1, 0.1)),)

    def processes(task: Any, variants: list[str], workers: int, progress: Any) -> Any:
        asked.append((tuple(variants), workers))
        return comparison._here(task, variants, progress)

    monkeypatch.setattr(comparison, "_in_processes", processes)
    monkeypatch.setattr(comparison, "MANY_SAMPLES", 1000)
    variants = ("constant-online", "inertia-online")
    compare(log, ROBOT, variants, workers=3)
    # A short log is worth no processes, unless they are to compile.
    compare(replace(log, others=others), ROBOT, variants, workers=3)
    assert asked == []
    monkeypatch.setattr(comparison, "kernel_files", list)
    found = compare(replace(log, others=others), ROBOT, variants, workers=3)
    assert tuple(found.runs) == variants
    assert asked == [(variants, 3)]


def _not_streamed(*_: Any, **__: Any) -> Run:
    raise AssertionError("all variants were to run side by side")


def test_what_side_by_side_cannot_take_is_streamed(monkeypatch: pytest.MonkeyPatch) -> None:
    log = drive()
    log = replace(log, others=(ZeroVelocity(int(log.tracks.stamps[50]), (0.1, 0.1, 0.1)),))
    apart = compare(log, ROBOT, ("constant-online",))
    monkeypatch.setattr(comparison, "MANY_SAMPLES", 1000)
    streamed = compare(log, ROBOT, ("constant-online",)).runs["constant-online"]
    np.testing.assert_array_equal(streamed.states, apart.runs["constant-online"].states)
    smoothed = compare(drive(), ROBOT, ("constant-online",), smooth=True)
    assert list(smoothed.runs) == ["constant-online", "constant-online-smoothed"]


def test_a_truth_that_was_logged_is_aligned_side_by_side(
    monkeypatch: pytest.MonkeyPatch, data_dir: Path
) -> None:
    robot = load_robot("warthog")
    log = read_log(sample_log(data_dir, "warthog_asphalt_2024_9_25_12h8s57"), robot)
    apart = compare(log, robot, ("constant-online",))
    monkeypatch.setattr(comparison, "MANY_SAMPLES", 1000)
    monkeypatch.setattr(comparison, "run", _not_streamed)
    together = compare(log, robot, ("constant-online",))
    assert apart.alignment is not None
    assert together.alignment is not None
    assert together.alignment.lag == pytest.approx(apart.alignment.lag, abs=1e-6)
    assert_same_run(together.runs["constant-online"], apart.runs["constant-online"], 1e-5)
