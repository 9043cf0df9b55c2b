"""Estimators that were fed a log, and what they say, to the last bit."""

import numpy as np

from icreckon import EstimatorError, FixSpec, Log, Scenario, load_robot, simulate

ALPHA = load_robot("auriga-alpha")


def seconds(value):
    """Nanoseconds of a time in seconds."""
    return round(value * 1e9)


def known(estimator):
    """All that an estimator says of the robot, to the last bit."""
    arrays = estimator.state, estimator.covariance, estimator.twist, estimator.twist_covariance
    numbers = [array.tobytes() for array in arrays]
    return estimator.stamp, estimator.stands, estimator.marks, *numbers


def known_with_health(estimator):
    return known(estimator), estimator.health


def result_of(call, estimator):
    """What a call returns, or the text of its error."""
    try:
        return call(estimator)
    except EstimatorError as problem:
        return str(problem)


def feed_all(estimator, measurements):
    """Feed a log, or measurements."""
    if isinstance(measurements, Log):
        measurements = measurements.measurements()
    for measurement in measurements:
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
