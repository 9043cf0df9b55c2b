"""Latencies: taken off raw stamps by the estimator, and that of the tracks found while driving."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from conftest import sample_log
from fed_estimators import feed_all, known
from icreckon import FixSpec, Latencies, Log, PoseEstimator, Scenario, read_log, simulate
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.measurements import Measurement, TrackSpeeds
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.sensors.track_latency import TrackLatencyEstimator
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.latency import track_latency

VARIANT = "constant-online"
LATE = Latencies(tracks=0.21, imu=0.013, position=0.3, heading=0.4)


@pytest.fixture(scope="module")
def log(robot: Robot) -> Log:
    fixes = FixSpec(heading_sigma=0.05)
    scenario = Scenario(duration=60.0, seed=2, trajectory="random", fix_rate=2.0, fixes=fixes)
    return simulate(scenario, robot)


@pytest.fixture(scope="module")
def own(log: Log, robot: Robot) -> float:
    """Latency of the simulated speeds, as `inspect` finds it in the whole log [s]."""
    rates = SensorModels(robot).yaw_rates(log.imu.angular_velocity)
    found = track_latency(log.tracks, YawRates(log.imu.stamps, rates))
    assert found.seconds == pytest.approx(0.0, abs=0.01)
    return found.seconds


def raw(log: Log, latencies: Latencies) -> list[Measurement]:
    """Measurements of a log with late stamps, in the order of those."""
    late = latencies.by_kind()
    stamped = [
        replace(one, stamp=one.stamp + round(late[type(one)] / NANOSECOND))  # type: ignore[type-var]
        for one in log.measurements()
    ]
    return sorted(stamped, key=lambda one: one.stamp)


def test_raw_stamps_give_what_corrected_ones_give(log: Log, robot: Robot) -> None:
    log = log.part(0.0, 30.0)
    corrected = feed_all(PoseEstimator(robot, VARIANT), log)
    estimator = feed_all(PoseEstimator(robot, VARIANT, latencies=LATE), raw(log, LATE))
    assert estimator.stamp == corrected.stamp
    assert estimator.state == pytest.approx(corrected.state, abs=1e-12)
    assert estimator.covariance == pytest.approx(corrected.covariance, abs=1e-12)
    assert estimator.health.sensors["tracks"].late > 1400
    ignored = feed_all(PoseEstimator(robot, VARIANT), raw(log, LATE))
    assert np.abs(ignored.pose - corrected.pose).max() > 0.01


def test_the_latencies_are_those_of_the_robot_file(robot: Robot) -> None:
    given = msgspec.structs.replace(
        robot,
        log={
            "tracks": {"topic": "/js", "latency": 0.2},
            "imu": {"topic": "/imu"},
            "fixes": {"topic": "/gps", "latency": 0.1},
        },
    )
    assert Latencies.of(given) == Latencies(tracks=0.2, position=0.1, heading=0.1)
    of_table = msgspec.structs.replace(robot, log={"columns": {"tracks": {"latency": 0.2}}})
    assert Latencies.of(of_table).tracks == 0.2
    assert Latencies.of(msgspec.structs.replace(robot, log={})).estimate_tracks
    with pytest.raises(EstimatorError, match=r"Latencies.tracks.*10 at most.*20"):
        Latencies(tracks=20.0)
    with pytest.raises(EstimatorError, match="latencies"):
        PoseEstimator(robot, VARIANT, latencies=0.2)  # type: ignore[arg-type]


def test_an_unknown_latency_is_found_and_taken_off(log, robot, own, tmp_path) -> None:
    """After a minute (8 rad of turning) it is known to 0.02 s, and later stamps are right."""
    estimator = PoseEstimator(robot, VARIANT, latencies=Latencies(estimate_tracks=True))
    assert estimator.health.track_latency.estimated is None
    measurements = raw(log, Latencies(tracks=0.2))
    feed_all(estimator, measurements[:-2000])
    # One that was saved goes on with what it has found.
    estimator.save(tmp_path / "saved.json")
    restored = PoseEstimator.restore(tmp_path / "saved.json", robot)
    feed_all(estimator, measurements[-2000:])
    assert known(feed_all(restored, measurements[-2000:])) == known(estimator)
    assert restored.health.track_latency == estimator.health.track_latency
    found = estimator.health.track_latency
    assert found.estimated == pytest.approx(0.2 + own, abs=0.01)
    assert found.sigma < 0.02
    assert found.used == pytest.approx(0.2 + own, abs=0.02)
    assert estimator.late(TrackSpeeds) == round(found.used / NANOSECOND)


def test_a_given_latency_is_watched_but_kept(log: Log, robot: Robot, own: float) -> None:
    estimator = PoseEstimator(robot, VARIANT, latencies=Latencies(tracks=0.05))
    feed_all(estimator, raw(log, Latencies(tracks=0.25)))
    found = estimator.health.track_latency
    assert found.used == 0.05
    assert found.estimated == pytest.approx(0.25 + own, abs=0.01)


def turning(late: float, *, rate: float = 50.0, pause: float = 0.0) -> tuple[np.ndarray, ...]:
    """Stamps and turning of tracks that are late and held, and of the gyro of a robot that turns."""
    rng = np.random.default_rng(3)
    knots = np.arange(-5.0, 125.0, 2.0)
    rates = rng.normal(0.0, 0.5, len(knots))
    times = np.arange(12_000) / 100.0
    times = times[(times <= 50.0) | (times >= 50.0 + pause)]
    gyro = np.interp(times - 0.005, knots, rates) + 0.02 + 0.01 * rng.standard_normal(len(times))
    held = times[:: round(100.0 / rate)]
    tracks = 0.6 * np.interp(held - late - 0.5 / rate, knots, rates)
    of_tracks, of_gyro = (np.round(one * 1e9).astype(int) for one in (held, times))
    return of_tracks, tracks, of_gyro, gyro


def watched(
    of_tracks: np.ndarray, tracks: np.ndarray, of_gyro: np.ndarray, gyro: np.ndarray
) -> TrackLatencyEstimator:
    """An estimator that takes them, four seconds at once."""
    estimator, part = TrackLatencyEstimator(), 4_000_000_000
    for begin in range(0, 30 * part, part):
        a, b = (slice(*np.searchsorted(one, (begin, begin + part))) for one in (of_tracks, of_gyro))
        estimator.take(of_tracks[a], tracks[a], of_gyro[b], gyro[b])
    return estimator


@pytest.mark.parametrize("late", [-0.15, 0.0, 0.07, 0.21, 0.6])
@pytest.mark.parametrize("rate", [10.0, 50.0])
def test_latency_of_either_sign_at_any_rate(late: float, rate: float) -> None:
    found = watched(*turning(late, rate=rate, pause=3.0)).estimate()
    assert found.seconds == pytest.approx(late, abs=max(0.004, 3.0 * found.sigma))
    assert found.sigma < 0.01


def test_no_turning_or_no_agreement_gives_no_latency() -> None:
    of_tracks, tracks, of_gyro, gyro = turning(0.1)
    unrelated = np.random.default_rng(1).normal(size=len(tracks))
    assert watched(of_tracks, 0.0 * tracks, of_gyro, 0.0 * gyro + 0.001).estimate() is None
    assert watched(of_tracks, unrelated, of_gyro, gyro).estimate() is None


@pytest.mark.parametrize(
    ("name", "robot_name", "latency"),
    [
        ("warthog_asphalt_2024_9_25_12h8s57", "warthog", 0.180),
        ("warthog_grass_2024_7_29_14h46s15", "warthog", 0.180),
        ("husky_deflated_part1", "husky-deflated", 0.215),
    ],
)
def test_real_latencies_are_those_of_the_whole_log(data_dir, name, robot_name, latency):
    """Within two standard errors of what `inspect` finds in the log (its own is up to 0.04 s)."""
    robot = load_robot(robot_name)
    tracks = {**robot.log["tracks"], "latency": 0.0}
    robot = msgspec.structs.replace(robot, log={**robot.log, "tracks": tracks})
    log = read_log(sample_log(data_dir, name), robot)
    estimator, turning = TrackLatencyEstimator(), np.diff(log.tracks.speeds)[:, 0]
    rates = SensorModels(robot).yaw_rates(log.imu.angular_velocity)
    estimator.take(log.tracks.stamps, turning, log.imu.stamps, rates)
    found = estimator.estimate()
    assert found.seconds == pytest.approx(latency, abs=2.0 * found.sigma)
    assert found.sigma < 0.02
