"""Runs drawn from the filter's own model: they are what it assumes, and it is as sure as it may be."""

import msgspec
import numpy as np
import pytest
from _sampled_model import ModelSampler, Terms
from scipy.stats import chi2

from icreckon.estimator.base import state as s
from icreckon.estimator.base.frames import compose
from icreckon.estimator.robot.robot_file import Slip, load_robot
from icreckon.estimator.robot.settings import Settings, StandstillSettings
from icreckon.estimator.robot.slip import slip_components
from icreckon.estimator.robot.variants import default_adaptation, find_variant, slip_of
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.truth.true_motion import exponential

ALPHA = load_robot("auriga-alpha")
VARIANT = find_variant("inertia-online")
SETTINGS = Settings(standstill=StandstillSettings(track_speed=0.0))
DT = 0.02
NO_TERMS = Terms(white_slip=0.0, lateness=0.0, slip_change=0.0, track_noise=0.0)


def bend(seconds, dt=DT):
    return np.tile([0.3, 0.6], (int(seconds / dt) + 1, 1))


def draw(speeds, seed=1, dt=DT, robot=ALPHA, **options):
    sampler = ModelSampler(robot, VARIANT, options.pop("settings", SETTINGS), **options)
    return sampler.run(speeds, dt, np.random.default_rng(seed))


def test_without_slip_and_spread_it_is_the_kinematics():
    shares = [f"{kind}_{axis}" for kind in ("turning", "driving") for axis in "xyw"]
    still = default_adaptation("inertia-online", walk=0.0)
    calm = Settings(slip=Slip(**dict.fromkeys(shares, 0.0)), adaptation=still)
    level = msgspec.structs.replace(ALPHA.slope, walk=0.0)
    robot = msgspec.structs.replace(ALPHA, slope=level)
    run = draw(bend(4.0), settings=calm, terms=NO_TERMS, share=0.0, robot=robot)
    assert np.ptp(run.twists, axis=0) == pytest.approx(0.0, abs=0.02)
    expected = np.zeros(3)
    for twist in run.twists[1:]:
        expected = compose(expected, exponential(twist[None] * DT)[0])
    assert run.states[-1, s.POSE] == pytest.approx(expected, abs=1e-4)


def test_slip_is_as_large_and_lasts_as_long_as_the_variant_says():
    slip = slip_of(ALPHA, VARIANT)
    run = draw(bend(400.0, 0.1), dt=0.1, share=0.0)
    gauge = ALPHA.vehicle.track_gauge * run.states[:, s.ETA0]
    sigma = np.stack(np.broadcast_arrays(*slip_components(0.3, 0.6, slip, gauge)), axis=-1)
    unit = (run.states[:, s.SLIP] / sigma)[50:]
    # Some 400 independent values: their variance is within four of its standard deviations.
    assert (unit**2).mean(axis=0) == pytest.approx(np.ones(3), abs=4.0 * np.sqrt(2.0 / 400))
    kept = (unit[1:] * unit[:-1]).mean(axis=0) / (unit**2).mean(axis=0)
    assert kept == pytest.approx(np.full(3, np.exp(-0.1 / slip.time_constant)), abs=0.06)


def test_start_is_drawn_from_what_the_filter_does_not_know():
    estimator = PoseEstimator(ALPHA, "inertia-online", settings=SETTINGS)
    known = np.flatnonzero(np.diagonal(estimator.covariance))
    starts = np.array([draw(bend(0.0), seed).states[0] for seed in range(300)])
    unit = (starts - estimator.state)[:, known] / np.sqrt(np.diagonal(estimator.covariance)[known])
    # Draws that no vehicle has are left out, which takes a little from the tails of the parameters.
    assert unit.std(axis=0) == pytest.approx(np.ones(len(known)), abs=0.25)
    assert unit.mean(axis=0) == pytest.approx(np.zeros(len(known)), abs=0.35)


@pytest.mark.thorough
def test_the_filter_is_as_sure_as_it_may_be():
    runs, found = 20, []
    times = np.arange(501) * DT
    speeds = 0.5 + 0.2 * np.sin(times)[:, None] * [-1.0, 1.0]
    for seed in range(runs):
        run = draw(speeds, seed)
        estimator = PoseEstimator(ALPHA, "inertia-online", settings=SETTINGS)
        for measurement in run.measurements:
            estimator.feed(measurement)
        estimate = estimator.snapshot()
        error = estimate.state[s.POSE] - run.states[-1, s.POSE]
        slip = estimate.twist - run.twists[-1]
        found.append(
            (
                error @ np.linalg.solve(estimate.covariance[s.POSE, s.POSE], error),
                slip @ np.linalg.solve(estimate.twist_covariance, slip),
            )
        )
    low, high = chi2.interval(0.999, 3 * runs)
    for total in np.sum(found, axis=0):
        assert low < total < high
