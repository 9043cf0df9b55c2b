"""Encoders with few counts: neither rejected gyros, nor biases or slopes that are none."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from conftest import thorough
from icreckon import (
    EncoderSpec,
    ImuSample,
    PoseEstimator,
    Run,
    Scenario,
    Settings,
    TrackSpeeds,
    load_robot,
    simulate,
)
from icreckon import run as run_filter
from icreckon.estimator.filter.filter_record import FilterRecord, take_track_speeds
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import drift
from icreckon.estimator.sensors.input_settings import input_settings

UNAIDED = 30.0, 100.0  # time without fixes [s]
COUNT = 0.0058  # hub motors with 90 counts a turn [m]
SEEDS = range(8, 20)
ROBOT = load_robot("auriga-alpha")


@cache
def recorded(name: str, seed: int, count: float, rate: float) -> Log:
    """A drive of a robot with encoders of this resolution [m], read at a rate [Hz]."""
    scenario = Scenario(
        duration=UNAIDED[1],
        seed=seed,
        fix_rate=1.0,
        track_rate=rate,
        outages=(UNAIDED,),
        noise="industrial",
        trajectory="random",
        encoders=EncoderSpec(resolution=count),
    )
    return simulate(scenario, load_robot(name))


def driven(name: str, seed: int, count: float, variant: str, rate: float) -> tuple[Log, Run]:
    """Run over such a drive."""
    log = recorded(name, seed, count, rate)
    return log, run_filter(replace(log, truth=None), load_robot(name), variant)


def percent(log: Log, run: Run) -> float:
    """Drift after 20 s of dead reckoning [%]."""
    within = [(log.start + round(UNAIDED[0] * 1e9), log.end)]
    return drift(run.trajectory.pose_series, log.truth.poses, 20.0, within=within).percent_mean


@pytest.mark.parametrize(
    ("name", "variant", "count", "rate"),
    [
        thorough("auriga-alpha", "gyro", COUNT, 50.0),
        thorough("auriga-alpha", "inertia-online", 0.01, 50.0),
        thorough("auriga-alpha", "inertia-online", 0.02, 20.0),
        ("husky", "constant-online", COUNT, 50.0),
        ("husky", "inertia-online", COUNT, 50.0),
    ],
)
def test_coarse_encoders_cost_a_third_at_most(
    name: str, variant: str, count: float, rate: float
) -> None:
    fine, coarse = (
        [driven(name, seed, resolution, variant, rate) for seed in SEEDS]
        for resolution in (0.0, count)
    )
    ends = []
    for log, run in coarse:
        rejected = sum(run.health.sensors["gyro"].rejected.values())
        assert rejected < 2e-3 * len(log.imu.stamps)
        off = run.trajectory.poses[-1] - log.truth.poses.poses[-1]
        ends.append(off @ np.linalg.solve(run.trajectory.pose_covariances[-1], off) / 3.0)
    # The mean is that of two drives, 11 and 16, whose errors are large with fine encoders, too.
    assert np.median(ends) < 1.5
    of_fine, of_coarse = (np.mean([percent(*one) for one in runs]) for runs in (fine, coarse))
    assert of_coarse < 4.0 / 3.0 * of_fine


@pytest.mark.parametrize("counted", [False, True])
def test_a_turn_that_begins_before_the_first_count_is_no_bias(counted: bool) -> None:
    rng, stamp = np.random.default_rng(2), 0
    estimator = PoseEstimator(ROBOT)
    density = ROBOT.imu.gyro_noise_density

    def feed(seconds: float, rate: float, speed: float) -> None:
        """Feed a turn at a rate [rad/s] and a speed [m/s], in whole counts at 50 Hz."""
        nonlocal stamp
        way, before = 0.0, 0.0
        for k in range(round(seconds * 100.0)):
            stamp += 10_000_000
            way += 0.01 * speed
            if k % 2:
                steps = np.floor(way / COUNT) - np.floor(before / COUNT)
                before = way
                estimator.feed(TrackSpeeds(stamp, *(np.full(2, steps * COUNT / 0.02)).tolist()))
            noisy = rate + 10.0 * density * rng.normal()
            estimator.feed(ImuSample(stamp, (0.0, 0.0, noisy), (0.0, 0.0, 9.81)))

    if counted:
        feed(5.0, 0.0, 0.31)
    feed(3.0, 0.0, 0.0)
    assert estimator.stands
    feed(0.5, 0.02, 0.001)
    bias = estimator.biases["gyro_bias"]
    assert abs(bias) < 0.003


@pytest.mark.parametrize("count", [1e-4, COUNT])
def test_averaged_speeds_keep_the_distance(count: float) -> None:
    """Speeds of coarse encoders, and of them alone, are held for a tenth of a second."""
    record = FilterRecord(input_settings(ROBOT, Settings()))
    held, way, travelled, stamps = record.tracks, np.zeros(2), np.zeros(2), set()
    for k in range(1, 2001):
        stamp, before = 20_000_000 * k, held.stamp
        way, counted = way + 0.02 * np.array([0.41, 0.47]), np.floor(way / count)
        speeds = (np.floor(way / count) - counted) * count / 0.02
        take_track_speeds(record, stamp, *speeds.tolist())
        if held.stamp != before:
            interval = (held.stamp - before) / 1e9 if before > 0 else 0.02
            travelled += interval * np.array([held.left, held.right])
            stamps.add(held.stamp)
    pending = (held.arrived - held.stamp) / 1e9 * np.array([held.average_left, held.average_right])
    assert travelled + pending == pytest.approx(np.floor(way / count) * count, abs=1e-9)
    assert min(np.diff(sorted(stamps)[-100:])) == (100_000_000 if count == COUNT else 20_000_000)


def test_an_average_of_equal_speeds_is_one_of_them() -> None:
    """So a stuck sensor repeats itself, and one at rest reads zero."""
    record = FilterRecord(input_settings(ROBOT, Settings()))
    rng, stamp = np.random.default_rng(3), 0
    for k in range(600):
        stamp += int(rng.integers(18_000_000, 22_000_000))
        right = COUNT / 0.02 * int(rng.integers(0, 3))
        take_track_speeds(record, stamp, 0.29 if k < 300 else 0.0, right)
        if k in (299, 599):
            held = record.tracks
            assert held.left == (0.29 if k == 299 else 0.0)
            assert held.interval > 0.08
