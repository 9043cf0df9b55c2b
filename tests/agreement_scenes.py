"""Drives that reach every branch of the filter, for tests of agreement: log, filters, settings."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import msgspec
import numpy as np

import faulty_drives
from faulty_drives import RESTS, with_free_track, with_free_tracks, with_rates, with_tracks
from icreckon import FixSeries, FixSpec, Log, Run, Scenario, Terrain, simulate
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.robot.robot_file import Robot, UndetectedSlip
from icreckon.estimator.robot.settings import FixWander, GateSettings, Settings
from icreckon.estimator.sensors.measurement_models import ACCELEROMETERS
from same_runs import FEW_DIGITS, ROBOT, ROUNDING, drive, every, without

SECOND, DEFAULT = 1_000_000_000, Settings()
EVERYDAY = ("gyro", "constant-online", "inertia-online")
START: dict[str, Any] = {"start": (1.0, -2.0, 0.3), "start_sigma": (0.02, 0.02, 0.01)}
GYRO_NOISE = ROBOT.imu.gyro_noise_density


@dataclass(frozen=True)
class Scene:
    """A drive, the filters that run over it, and what must be seen in the run of the last variant."""

    log: Callable[[], Log]
    variants: tuple[str, ...] = ("constant-online",)
    settings: Settings = DEFAULT
    robot: Robot = ROBOT
    rounding: float = ROUNDING
    seen: Callable[[Run], bool] = lambda _: True
    start: tuple[float, float, float] = START["start"]

    def options(self) -> dict[str, Any]:
        return {"start": self.start, "start_sigma": START["start_sigma"]}


def robot_with(part: str, **changes: object) -> Robot:
    """The robot with other values in one table of its file."""
    changed = msgspec.structs.replace(getattr(ROBOT, part), **changes)
    return msgspec.structs.replace(ROBOT, **{part: changed})


def with_fixes(change: Callable[[np.ndarray, np.ndarray], None]) -> Log:
    """The drive whose poses and variances of fixes are changed."""
    return with_poses(drive(fix_rate=5.0), change)


def with_poses(log: Log, change: Callable[[np.ndarray, np.ndarray], None]) -> Log:
    poses, variances = log.fixes.poses.copy(), log.fixes.variances.copy()
    change(poses, variances)
    return replace(log, fixes=FixSeries(log.fixes.stamps, poses, variances))


def with_yaw_rates(change: Callable[[np.ndarray], None]) -> Log:
    log = drive()
    rates = log.imu.angular_velocity.copy()
    change(rates[:, 2])
    return replace(log, imu=replace(log.imu, angular_velocity=rates))


def some_headings(poses: np.ndarray, variances: np.ndarray) -> None:
    poses[::2, 2], variances[::2, 1] = 0.2, 0.5


def jump(poses: np.ndarray, _: np.ndarray, at: int = 25, by: float = 3.0) -> None:
    poses[at:, 0] += by


def turn(poses: np.ndarray, _: np.ndarray) -> None:
    poses[25:, :2] = np.column_stack([5.0 - poses[25:, 1], poses[25:, 0] - 3.0])


def scatter(poses: np.ndarray, _: np.ndarray) -> None:
    poses[:, :2] += np.random.default_rng(4).normal(0.0, 1.0, (len(poses), 2))


def turn_and_scatter(poses: np.ndarray, _: np.ndarray) -> None:
    cos, sin, first = np.cos(2.0), np.sin(2.0), poses[60, :2].copy()
    turned = (poses[60:, :2] - first) @ np.array([[cos, sin], [-sin, cos]])
    poses[60:, :2] = turned + first + np.array([3.0, 0.0])
    poses[100:, :2] += np.random.default_rng(4).normal(0.0, 1.0, (len(poses) - 100, 2))


def repeat(poses: np.ndarray, _: np.ndarray) -> None:
    poses[20:45, :2] = poses[20, :2]


def spikes(rates: np.ndarray) -> None:
    rates[400:403] += 5.0
    rates[700:720] += 50.0


def slow_spike(rates: np.ndarray) -> None:
    rates[700:740] += 6.0 - np.abs(np.linspace(-6.0, 6.0, 40))


def with_stuck_track(log: Log) -> Log:
    speeds = log.tracks.speeds.copy()
    speeds[200:450, 0] = speeds[200, 0]
    return replace(log, tracks=replace(log.tracks, speeds=speeds))


def wrong_headings() -> Log:
    """Every third fix has a heading; those of 12 s are 0.6 rad off."""
    log = simulate(Scenario(duration=34.0, seed=3, trajectory="random", fix_rate=5.0), ROBOT)
    fixes, truth = log.fixes, log.truth
    at, poses, variances = (
        (fixes.stamps - log.start) * 1e-9,
        fixes.poses.copy(),
        fixes.variances.copy(),
    )
    yaws = interpolate_poses(truth.poses, fixes.stamps)[:, 2] + 0.6 * ((at > 20.0) & (at < 32.0))
    poses[::3, 2], variances[::3, 1] = yaws[::3], 1e-4
    return replace(log, fixes=FixSeries(fixes.stamps, poses, variances))


def antenna(*, turned: bool) -> Log:
    """Fixes of an antenna that is not where it claims to be."""
    log = drive(fix_rate=5.0, antenna=(0.4, -0.3, 0.8))
    poses = log.fixes.poses.copy()
    if turned:
        turn(poses, poses)
    return replace(log, fixes=replace(log.fixes, poses=poses))


def first_fix_at(late: int) -> Log:
    """The drive whose first fix comes so late after the first track speeds [ms]."""
    log = drive(fix_rate=5.0)
    stamps = log.fixes.stamps.copy()
    stamps[0] = log.tracks.stamps[0] + late * 1_000_000
    return replace(log, fixes=replace(log.fixes, stamps=stamps))


def without_forces() -> Log:
    log = drive()
    return replace(log, imu=replace(log.imu, linear_acceleration=None))


def first(log: Log, seconds: float) -> Log:
    return log.between(log.start, log.start + round(seconds * SECOND))


@cache
def healthy() -> Log:
    return faulty_drives.drive(ROBOT, 1, 36.0)


@cache
def fixed(rate: float, sigma: float) -> Log:
    scenario = Scenario(
        duration=45.0, seed=3, trajectory="random", fix_rate=rate, fixes=FixSpec(sigma=sigma)
    )
    return simulate(scenario, ROBOT)


def sloping() -> Log:
    terrain = Terrain(slope_deg=10.0, uphill_deg=30.0)
    return simulate(Scenario(duration=60.0, seed=1, trajectory="random", terrain=terrain), ROBOT)


def rejected(sensor: str, reason: str, least: int = 1) -> Callable[[Run], bool]:
    return lambda one: one.health.sensors[sensor].rejected.get(reason, 0) >= least


def taken_back(sensor: str) -> Callable[[Run], bool]:
    return lambda one: one.health.sensors[sensor].reacquired > 0


def has_gaps(one: Run) -> bool:
    return one.health.track_gaps > 0


# Those of the guide, so that their filter is compiled once for all tests.
CONSIDERED = ("eta0", "gyro_bias")
WANDERING = Settings(wander=FixWander(1.2, 60.0))
PATIENT = Settings(gates=GateSettings(patience=8))
ALONG = robot_with("vehicle", centre_of_mass=(0.04, 0.015, 0.3))
SCENES = {
    "all everyday variants": Scene(
        drive, EVERYDAY, seen=lambda one: one.health.standstill_updates > 0
    ),
    "linear models": Scene(drive, ("full-linear",)),
    "fixes": Scene(lambda: drive(fix_rate=5.0), EVERYDAY),
    "headings of some fixes": Scene(lambda: with_fixes(some_headings), ("inertia-online",)),
    "fixes that jump": Scene(lambda: with_fixes(jump), seen=rejected("position", "gate")),
    "fixes of a turned path": Scene(lambda: with_fixes(turn)),
    "fixes that scatter": Scene(
        lambda: with_fixes(scatter),
        ("inertia-online",),
        seen=lambda one: one.health.times.get("scattering", 0) > 10,
    ),
    "fixes of a turned path that scatter": Scene(
        lambda: with_poses(drive(40.0, 5.0), turn_and_scatter),
        settings=Settings(gates=GateSettings(patience=3)),
        seen=lambda one: one.health.times.get("scattering", 0) > 10 and taken_back("position")(one),
    ),
    "fixes that repeat": Scene(
        lambda: with_fixes(repeat), seen=rejected("position", "repeats itself", 10)
    ),
    "fixes that wander": Scene(lambda: drive(fix_rate=5.0), ("inertia-online",), WANDERING),
    "fixes of a turned path that wander": Scene(
        lambda: with_fixes(turn), ("inertia-online",), WANDERING, seen=rejected("position", "gate")
    ),
    "wrong headings": Scene(wrong_headings, rounding=FEW_DIGITS, seen=taken_back("heading")),
    "an antenna": Scene(lambda: antenna(turned=False), ("inertia-online",)),
    "an antenna on a turned path": Scene(
        lambda: antenna(turned=True), seen=rejected("position", "gate")
    ),
    "fixes before the first track speeds": Scene(
        lambda: without(drive(fix_rate=5.0), "tracks", -1.0, 2.0)
    ),
    "fixes before the first track speeds, far away": Scene(
        lambda: without(drive(fix_rate=5.0), "tracks", -1.0, 2.0), start=(40.0, -2.0, 0.3)
    ),
    "a fix 2 ms before the first track speeds": Scene(lambda: first_fix_at(-2)),
    "a fix with the first track speeds": Scene(lambda: first_fix_at(0)),
    "a fix 3 ms after the first track speeds": Scene(lambda: first_fix_at(3)),
    "a fix 6 ms after the first track speeds": Scene(lambda: first_fix_at(6)),
    "track speeds that are seldom told": Scene(
        lambda: every(drive(), "tracks", 25), rounding=FEW_DIGITS
    ),
    "a track that is stuck": Scene(
        lambda: with_stuck_track(drive()),
        rounding=FEW_DIGITS,
        seen=lambda one: one.health.times["stuck"] > 0,
    ),
    "a gyro that jumps": Scene(
        lambda: with_yaw_rates(spikes),
        ("inertia-online",),
        PATIENT,
        seen=rejected("gyro", "jumped", 23),
    ),
    "a gyro that is wrong for a while": Scene(
        lambda: with_yaw_rates(slow_spike), ("inertia-online",), PATIENT, seen=taken_back("gyro")
    ),
    "track speeds that are held for a short time": Scene(
        drive, ("inertia-online",), Settings(hold=0.02)
    ),
    "an IMU without accelerometers": Scene(
        without_forces, seen=lambda one: not {*ACCELEROMETERS} & {*one.health.sensors}
    ),
    "no accelerometers by the settings": Scene(drive, settings=Settings(use_accelerometer=False)),
    "a log of one sample": Scene(lambda: first(drive(), 0.03)),
    "states that are considered": Scene(
        lambda: drive(fix_rate=5.0), ("inertia-online",), Settings(considered=CONSIDERED)
    ),
    "a gyro noisier than its file says": Scene(
        drive, ("inertia-online",), robot=robot_with("imu", gyro_noise_density=GYRO_NOISE / 30.0)
    ),
    "a gyro less noisy than its file says": Scene(
        drive, ("inertia-online",), robot=robot_with("imu", gyro_noise_density=GYRO_NOISE * 30.0)
    ),
    "fixes that depart by a bias": Scene(
        lambda: with_rates(fixed(1.0, 0.05), 99.0, lambda rates: rates + 0.1, 20.0),
        seen=lambda one: one.health.slip_factor > 2.0,
    ),
    "fixes that depart by slip": Scene(
        lambda: with_tracks(fixed(5.0, 0.02), 10.0, lambda speeds: speeds + 0.3, 30.0),
        ("inertia-online",),
        seen=lambda one: one.health.slip_factor > 2.0,
    ),
    "a track that spins": Scene(
        lambda: with_free_track(healthy()),
        ("inertia-online",),
        seen=lambda one: one.health.times["spinning"] == 1,
    ),
    "an upper track that slides": Scene(
        sloping, EVERYDAY, robot=ALONG, seen=lambda one: one.health.times["spinning"] > 0
    ),
    "a slide": Scene(
        lambda: first(with_free_tracks(healthy()), 32.0),
        ("inertia-online",),
        seen=lambda one: one.health.finding("sliding") is not None,
    ),
    "a gyro that is clipped": Scene(
        lambda: with_rates(healthy(), 10.0, lambda rates: rates.clip(-0.3, 0.3)),
        ("inertia-online",),
        seen=rejected("gyro", "repeats itself", 20),
    ),
    "a robot that is carried": Scene(
        lambda: first(with_tracks(healthy(), 10.0, np.zeros_like, RESTS), 8.0),
        EVERYDAY[1:],
        robot=msgspec.structs.replace(ROBOT, undetected_slip=UndetectedSlip(share=0.1)),
        seen=lambda one: one.health.times["carried"] == 1,
    ),
}
"""Each is there for code that no other reaches."""


def silent(change: Callable[[Log], Log], fix_rate: float = 5.0, *, gaps: bool = False) -> Scene:
    """The drive whose sensors are silent or slow."""
    seen = has_gaps if gaps else lambda one: not has_gaps(one)
    return Scene(lambda: change(drive(fix_rate=fix_rate)), seen=seen)


def both_silent(log: Log) -> Log:
    return without(without(log, "tracks", 5.0, 7.0), "imu", 5.1, 7.1)


SCENES |= {
    "the IMU begins later": silent(lambda log: without(log, "imu", -1.0, 0.5)),
    "track speeds begin later": silent(lambda log: without(log, "tracks", -1.0, 0.5), 0.0),
    "no IMU for a moment": silent(lambda log: without(log, "imu", 8.0, 8.2)),
    "no IMU for seconds": silent(lambda log: without(log, "imu", 5.0, 7.0), 0.0),
    "the IMU ends early": silent(lambda log: without(log, "imu", 11.7, 99.0)),
    "the IMU ends long before": silent(lambda log: without(log, "imu", 9.0, 99.0)),
    "track speeds end early": silent(lambda log: without(log, "tracks", 10.0, 99.0)),
    "no track speeds for seconds": silent(lambda log: without(log, "tracks", 5.0, 7.0), gaps=True),
    "nothing for seconds": silent(both_silent, gaps=True),
    "nothing for seconds, no fixes": silent(both_silent, 0.0, gaps=True),
    "an IMU slower than the tracks": silent(lambda log: every(log, "imu", 5)),
    "an IMU too slow to wait for": silent(lambda log: every(log, "imu", 40)),
    "an IMU too slow to wait for, no fixes": silent(lambda log: every(log, "imu", 40), 0.0),
    "slow IMU, no track speeds": silent(
        lambda log: without(every(log, "imu", 5), "tracks", 5.0, 7.0), gaps=True
    ),
}
