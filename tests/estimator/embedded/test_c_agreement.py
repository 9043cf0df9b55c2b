"""Exported filters in C, compiled for this machine, against the estimator in Python."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from agreement_scenes import SCENES
from c_filters import CFilter, Difference, compare, in_order
from conftest import sample, thorough
from icreckon import BodyVelocity, FixSpec, ImuSample, Log, Measurement, TrackSpeeds, ZeroVelocity
from icreckon.estimator.base.frames import relative
from icreckon.estimator.robot.robot_file import changed_robot, load_robot
from icreckon.estimator.robot.settings import FixWander, Settings
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from same_runs import ROBOT

# Standard deviations: doubles reach 1e-11 where nothing cancels.
DOUBLE, FLOAT = 1e-9, 0.02
LAST = [(name, scene.variants[-1]) for name, scene in SCENES.items()]
OTHERS = [(name, one) for name, scene in SCENES.items() for one in scene.variants[:-1]]
# Flags of `enum icr_health`, by the name of the finding.
FLAGS = {"stuck": 0b1110, "spinning": 0b110000, "sliding": 1 << 6, "carried": 1 << 7}
FLAGS |= {"failing": 1 << 8, "scattering": 1 << 9}
LATE, AHEAD, INVALID, NO_TRACKS = 3, 4, 5, 6


def of_scene(name: str, variant: str, bits: int) -> Difference:
    scene = SCENES[name]
    found = CFilter(scene.robot, variant, scene.settings, bits=bits)
    found.start(scene.start, 0.02, 0.01)
    expected = PoseEstimator(scene.robot, variant, settings=scene.settings, **scene.options())
    off = compare(found, expected, scene.log().measurements())
    flags, health = found.health, expected.health
    assert bool(flags & 1) == expected.stands
    for finding, of_it in FLAGS.items():
        assert bool(flags & of_it) == (health.finding(finding) is not None), finding
    (x, left), (_, right) = expected.icrs
    close = 1e-8 if bits == 64 else 1e-3
    assert found.icrs.x == pytest.approx(x, abs=close)
    assert (found.icrs.left_y, found.icrs.right_y) == pytest.approx((left, right), abs=close)
    return off


@pytest.mark.parametrize(("name", "variant"), [*LAST, *(thorough(*one) for one in OTHERS)])
def test_double_agrees_with_the_estimator(name: str, variant: str) -> None:
    off = of_scene(name, variant, 64)
    assert off.results == 0, off.at
    rounding = SCENES[name].rounding
    assert off.state < 0.1 * rounding, off.at
    assert max(off.covariance, off.twist) < rounding, off.at


# Those that no scene ends with.
RARE = sorted(VARIANTS.keys() - {variant for _, variant in LAST})


@pytest.mark.parametrize("variant", RARE)
def test_all_variants_can_be_exported(variant: str) -> None:
    scenario = Scenario(
        duration=20.0, seed=3, trajectory="random", fix_rate=2.0, fixes=FixSpec(heading_sigma=0.05)
    )
    found = CFilter(ROBOT, variant)
    off = compare(found, PoseEstimator(ROBOT, variant), simulate(scenario, ROBOT).measurements())
    assert off.results == 0, off.at
    assert off.state < DOUBLE, off.at
    assert max(off.covariance, off.twist) < 1e-8, off.at


def with_velocities(log: Log) -> list[Measurement]:
    """Measurements of a simulated log, and velocities, wrong ones for 15 s."""
    truth, found = log.truth, list(log.measurements())
    rng = np.random.default_rng(0)
    for k in range(10, len(truth.twists.stamps), 10):
        stamp = int(truth.twists.stamps[k]) + (k % 3) * 3_000_000
        v_x, v_y, w = truth.twists.twists[k]
        wrong = 1.0 if 20.0 < (stamp - log.start) * 1e-9 < 35.0 else 0.0
        noise = 0.02 * rng.normal(size=2)
        found.append(BodyVelocity(stamp, v_x + wrong + noise[0], v_y + noise[1], 4e-4))
        if abs(v_x) + abs(w) < 1e-6:
            found.append(ZeroVelocity(stamp + 1_000_000 * (k % 2)))
    return found


@pytest.mark.parametrize(
    ("variant", "settings"),
    [
        ("inertia-online", Settings()),
        ("gyro", Settings()),
        thorough("constant-online", Settings(considered=("eta0",))),
        thorough("inertia-online", Settings(wander=FixWander(sigma=2.0, time=60.0))),
    ],
)
def test_velocities_and_zero_velocities(variant: str, settings: Settings) -> None:
    scenario = Scenario(duration=60.0, seed=8, trajectory="stop-and-go", fix_rate=0.5)
    log = simulate(scenario, ROBOT)
    found = CFilter(ROBOT, variant, settings)
    expected = PoseEstimator(ROBOT, variant, settings=settings)
    off = compare(found, expected, with_velocities(log))
    counts = expected.health.sensors["body velocity"]
    assert counts.reacquired > 0
    assert sum(counts.rejected.values()) > 50
    assert expected.health.sensors["zero velocity"].used > 20
    assert off.results == 0, off.at
    assert off.state < DOUBLE, off.at
    assert max(off.covariance, off.twist) < 1e-8, off.at


@pytest.mark.parametrize("imu_runs", [False, True])
def test_a_zero_velocity_after_the_drivers_fell_silent(imu_runs: bool) -> None:
    """The robot does not drive back, and stands at once."""
    found, expected = CFilter(ROBOT, "inertia-online"), PoseEstimator(ROBOT, "inertia-online")

    def driven(start: int, end: int, *, silent: bool = False) -> list[Measurement]:
        both: list[Measurement] = []
        for at in range(start, end, 10):
            both += [] if silent else [tracks(at, 0.5, 0.6)]
            both += [imu(at, (0.0, 0.0, 0.05))] if imu_runs or not silent else []
        return both

    standing = [ZeroVelocity(STAMP + at * MS) for at in (5_405, 5_700)]
    pause = sorted([*driven(5_000, 5_850, silent=True), *standing], key=lambda one: one.stamp)
    compare(found, expected, driven(0, 5_000))
    before = expected.pose
    off = compare(found, expected, pause)
    assert off.state < DOUBLE, off.at
    assert max(off.covariance, off.twist) < 1e-8, off.at
    ahead, _, _ = relative(before, expected.pose)
    assert 0.0 < ahead < 0.3
    assert np.abs(expected.twist[:2]).max() < 0.05
    off = compare(found, expected, driven(5_850, 7_000))
    assert max(off.covariance, off.twist) < 1e-8, off.at


REAL = {
    "husky_test1.bag": "husky",
    "warthog_grass_2024_8_8_16h11s19": "warthog",
    "warthog_asphalt_2024_9_25_12h8s57": "warthog",
    "marmotte_part1": "marmotte",
    "husky_deflated_part1": "husky-deflated",
    "jackal_test2.bag": "jackal",
}
QUICK = [("warthog_grass_2024_8_8_16h11s19", bits) for bits in (64, 32)]


@pytest.mark.parametrize(
    ("name", "bits"), QUICK + [thorough(name, bits) for name in REAL for bits in (64, 32)]
)
def test_real_logs(data_dir: Path, name: str, bits: int) -> None:
    robot = load_robot(REAL[name])
    found = CFilter(robot, "inertia-online", bits=bits)
    expected = PoseEstimator(robot, "inertia-online")
    off = compare(found, expected, taken(sample(data_dir, name, REAL[name])), every=97)
    assert off.results <= 3 * (bits == 32), off.at
    assert off.state < (FLOAT if bits == 32 else DOUBLE), off.at


def taken(log: Log) -> list[Measurement]:
    """Measurements of a log that the filter in C takes."""
    kinds = ("TrackSpeeds", "ImuSample", "PositionFix", "HeadingFix")
    return [one for one in log.measurements() if type(one).__name__ in kinds]


LONG = [(120.0, 0.0), thorough(3600.0, 0.0), thorough(3600.0, 0.2)]


@pytest.mark.parametrize(("duration", "fix_rate"), LONG)
def test_float_agrees_over_long_drives(duration: float, fix_rate: float) -> None:
    scenario = Scenario(duration=duration, seed=7, trajectory="random", fix_rate=fix_rate)
    log = simulate(scenario, ROBOT)
    for variant in ("gyro", "inertia-online"):
        found = CFilter(ROBOT, variant, bits=32)
        off = compare(found, PoseEstimator(ROBOT, variant), log.measurements(), every=997)
        assert off.state < 0.5 * FLOAT, off.at
        assert off.covariance < FLOAT, off.at


STAMP, MS = 1_700_000_000_000_000_000, 1_000_000
ZERO, AT_REST = (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)


def imu(at: int, rates: tuple[float, float, float] = ZERO) -> ImuSample:
    return ImuSample(STAMP + at * MS, angular_velocity=rates, linear_acceleration=AT_REST)


def tracks(at: int, left: float = 0.0, right: float = 0.0) -> TrackSpeeds:
    return TrackSpeeds(STAMP + at * MS, left=left, right=right)


def test_results_of_what_is_not_used() -> None:
    found = CFilter(ROBOT, "gyro")
    assert found.feed(imu(0)) == NO_TRACKS
    assert found.feed(tracks(10)) == 0
    assert found.feed(tracks(10)) == LATE
    assert found.feed(imu(10)) == 0
    assert found.feed(imu(5)) == LATE
    assert found.feed(imu(20, (np.nan, 0.0, 0.0))) == INVALID
    assert found.feed(tracks(20, np.inf)) == INVALID
    assert found.feed(TrackSpeeds(2**62, left=0.0, right=0.0)) == INVALID
    assert found.pose.stamp == STAMP + 10 * MS


def test_a_clock_that_jumps_ahead_is_accepted_after_ten_samples() -> None:
    found, expected = CFilter(ROBOT, "inertia-online"), PoseEstimator(ROBOT, "inertia-online")
    usual = [one for k in range(0, 500, 10) for one in (tracks(k, 0.3, 0.5), imu(k, (0, 0, 0.2)))]
    far = [imu(10_000_000 + k, (0, 0, 0.2)) for k in (20, 0, 30, *range(40, 300, 10))]
    results = []
    for measurement in [*usual, *far]:
        used, result = expected.feed(measurement), found.feed(measurement)
        assert used == (result == 0), measurement
        results.append(result)
    assert AHEAD in results
    assert results[-1] == 0


def test_an_imu_faster_than_stated_finds_no_standstill_and_keeps_working() -> None:
    found, expected = CFilter(ROBOT, "inertia-online"), PoseEstimator(ROBOT, "inertia-online")
    rest = [imu(k) for k in range(6000)] + [tracks(k) for k in range(0, 6000, 20)]
    assert compare(found, expected, rest, every=100_000).results == 0
    assert expected.stands
    assert np.isfinite(found.state).all()
    assert np.isfinite(found.covariance).all()


def test_outputs_before_the_first_measurement() -> None:
    found = CFilter(ROBOT, "inertia-online")
    found.start((1.0, 2.0, 0.5), 0.1, 0.2)
    assert (found.pose.x, found.pose.y, found.pose.yaw) == (1.0, 2.0, 0.5)
    assert tuple(found.pose.covariance)[::4] == pytest.approx((0.01, 0.01, 0.04))
    assert np.isfinite([found.twist.v_x, found.icrs.x, found.icrs.left_y]).all()


@cache
def learnt() -> tuple[CFilter, PoseEstimator]:
    log = simulate(Scenario(duration=30.0, seed=2, trajectory="random", fix_rate=1.0), ROBOT)
    found, expected = CFilter(ROBOT, "inertia-online"), PoseEstimator(ROBOT, "inertia-online")
    for measurement in in_order(log.measurements()):
        found.feed(measurement)
        expected.feed(measurement)
    return found, expected


def test_a_warm_start_is_that_of_the_estimator(tmp_path: Path) -> None:
    found, expected = learnt()
    expected.save(tmp_path / "saved.json")
    start = {"start": (3.0, 1.0, -0.5), "start_sigma": (0.1, 0.1, 0.2)}
    warm = PoseEstimator.warm_start(tmp_path / "saved.json", ROBOT, off=3600.0, **start)
    kept, again = found.saved(), CFilter(ROBOT, "inertia-online")
    assert again.load(kept, 3600.0)
    again.start(start["start"], 0.1, 0.2)
    log = simulate(Scenario(duration=30.0, seed=4, trajectory="random", fix_rate=1.0), ROBOT)
    off = compare(again, warm, log.measurements())
    assert off.results == 0, off.at
    assert off.worst < 1e-8, off.at


def test_saved_bytes_that_do_not_fit_are_refused() -> None:
    found, _ = learnt()
    kept = found.saved()
    again, before = CFilter(ROBOT, "inertia-online"), CFilter(ROBOT, "inertia-online").state
    for place in range(0, len(kept), 7):
        damaged = bytearray(kept)
        damaged[place] ^= 0x10
        assert not again.load(bytes(damaged), 0.0), place
    for off in (-1.0, np.nan, np.inf):
        assert not again.load(kept, off)
    assert not again.load(bytes(len(kept)), 0.0)
    heavier = changed_robot(ROBOT, {"vehicle.mass": 2.0 * ROBOT.vehicle.mass})
    assert not CFilter(heavier, "inertia-online").load(kept, 0.0)
    assert (again.state == before).all()
    assert again.load(kept, 0.0)
