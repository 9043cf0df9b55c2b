"""Runs drawn from the filter's own model: they are what it assumes, and it is as sure as it may be."""

import numpy as np
import pytest
from _sampled_model import ModelSampler
from scipy.stats import chi2

from icreckon import PoseEstimator, Settings, StandstillSettings, load_robot
from icreckon.estimator.base import state as s
from icreckon.estimator.robot.variants import find_variant

ALPHA = load_robot("auriga-alpha")
VARIANT = find_variant("inertia-online")
SETTINGS = Settings(standstill=StandstillSettings(track_speed=0.0))
DT = 0.02


@pytest.mark.thorough
def test_the_filter_is_as_sure_as_it_may_be():
    runs, found = 20, []
    sampler = ModelSampler(ALPHA, VARIANT, SETTINGS)
    times = np.arange(501) * DT
    speeds = 0.5 + 0.2 * np.sin(times)[:, None] * [-1.0, 1.0]
    for seed in range(runs):
        run = sampler.run(speeds, DT, np.random.default_rng(seed))
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
