"""Estimators that were fed a log, and what they remember, compared to the last bit."""

import numpy as np

from icreckon import FixSpec, Scenario, load_robot, simulate

ALPHA = load_robot("auriga-alpha")


def remembered(estimator):
    return estimator.stamp, estimator.state, estimator.covariance, estimator.twist


def assert_same(before, after):
    assert before[0] == after[0]
    for a, b in zip(before[1:], after[1:], strict=True):
        assert (a == b).all()


def feed_all(estimator, log):
    for measurement in log.measurements():
        estimator.feed(measurement)
    return estimator


def short_log(**options):
    scenario = {"duration": 20.0, "trajectory": "aggressive", "seed": 5, "track_rate": 25.0}
    scenario |= {"imu_rate": 50.0, "fixes": FixSpec(heading_sigma=0.05)} | options
    return simulate(Scenario(**scenario), ALPHA)


def flaw(P):
    """What is wrong with a covariance, or None."""
    if not np.isfinite(P).all():
        return "not finite"
    if not np.array_equal(P, P.T):
        return "not symmetric"
    variances = P.diagonal()
    exact = variances <= 0.0
    if variances.min() < 0.0 or np.abs(P[exact]).max(initial=0.0) > 1e-90:
        return f"variance {variances.min()} of state {variances.argmin()}"
    if exact.all():
        return None
    sigmas = np.sqrt(variances[~exact])
    least = np.linalg.eigvalsh(P[np.ix_(~exact, ~exact)] / sigmas / sigmas[:, None])[0]
    return f"eigenvalue {least} of the correlations" if least < -1e-6 else None
