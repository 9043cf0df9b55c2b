"""Encoders with few counts: their steps neither exclude the gyro nor hide a slow turn as its bias."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from icreckon import (
    EncoderSpec,
    ImuSample,
    PoseEstimator,
    Run,
    Scenario,
    TrackSpeeds,
    load_robot,
    simulate,
)
from icreckon import run as run_filter
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import drift

UNAIDED = 30.0, 100.0  # time without fixes [s]
COUNT = 0.0058  # hub motors with 90 counts a turn [m]
SEEDS = range(8)
ROBOT = load_robot("auriga-alpha")


@cache
def recorded(seed: int, count: float, rate: float) -> Log:
    """A drive with encoders of this resolution [m], read at a rate [Hz]."""
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
    return simulate(scenario, ROBOT)


def driven(seed: int, count: float, variant: str, rate: float) -> tuple[Log, Run]:
    """Run over such a drive."""
    log = recorded(seed, count, rate)
    return log, run_filter(replace(log, truth=None), ROBOT, variant)


def percent(log: Log, run: Run) -> float:
    """Drift after 20 s of dead reckoning [%]."""
    within = [(log.start + round(UNAIDED[0] * 1e9), log.end)]
    return drift(run.trajectory.pose_series, log.truth.poses, 20.0, within=within).percent_mean


@pytest.mark.parametrize(
    ("variant", "count", "rate"),
    [("gyro", COUNT, 50.0), ("inertia-online", COUNT, 50.0), ("inertia-online", 0.02, 20.0)],
)
def test_coarse_encoders_cost_a_third_at_most(variant: str, count: float, rate: float) -> None:
    fine, coarse = (
        [driven(seed, resolution, variant, rate) for seed in SEEDS] for resolution in (0.0, count)
    )
    ends = []
    for log, run in coarse:
        rejected = sum(run.health.sensors["gyro"].rejected.values())
        assert rejected < 2e-3 * len(log.imu.stamps)
        off = run.trajectory.poses[-1] - log.truth.poses.poses[-1]
        ends.append(off @ np.linalg.solve(run.trajectory.pose_covariances[-1], off) / 3.0)
    assert np.mean(ends) < 2.0
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
