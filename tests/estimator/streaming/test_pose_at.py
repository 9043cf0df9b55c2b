"""Predicted pose a little after the estimate, as a scan matcher asks for it."""

from itertools import islice

import numpy as np
import pytest

import icreckon
from fed_estimators import feed_all, known
from icreckon import ImuSample, Log, PoseEstimator
from icreckon.estimator.log.scores import interpolate_poses, nees

ROBOT = icreckon.load_robot("auriga-alpha")
AHEAD = 60_000_000


@pytest.fixture(scope="module")
def log() -> Log:
    scenario = icreckon.Scenario(trajectory="random", duration=90.0, seed=5, fix_rate=1.0)
    return icreckon.simulate(scenario, ROBOT)


@pytest.mark.parametrize("variant", ["gyro", "constant-online", "inertia-online"])
def test_it_is_where_the_robot_then_is_within_its_covariance(log: Log, variant: str) -> None:
    estimator = PoseEstimator(ROBOT, variant)
    found = []
    for measurement in log.measurements():
        estimator.feed(measurement)
        stamp = estimator.stamp
        due = (
            isinstance(measurement, ImuSample) and stamp is not None and stamp % 500_000_000 < 10**7
        )
        if due and stamp + AHEAD < log.end and stamp > log.start + 10 * 10**9:
            found.append(estimator.pose_at(stamp + AHEAD))
    assert len(found) > 100
    stamps = np.array([one.stamp for one in found])
    errors = np.array([one.pose for one in found]) - interpolate_poses(log.truth.poses, stamps)
    errors[:, 2] = (errors[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    mean = float(nees(errors, np.array([one.covariance for one in found])).mean())
    assert 0.3 < mean < 9.0, mean


def test_it_moves_and_leaves_the_estimate_alone(log: Log) -> None:
    asked, left_alone = PoseEstimator(ROBOT), PoseEstimator(ROBOT)
    moved = 0.0
    for measurement in islice(log.measurements(), 3000):
        asked.feed(measurement)
        left_alone.feed(measurement)
        if asked.stamp is not None and isinstance(measurement, ImuSample):
            ahead = asked.pose_at(asked.stamp + AHEAD)
            moved = max(moved, float(np.hypot(*(ahead.pose - asked.pose)[:2])))
            spread = np.linalg.eigvalsh(ahead.covariance)
            assert spread[0] >= -1e-15
    assert 0.01 < moved < 0.2
    assert known(asked) == known(left_alone)
    # At the stamp of the estimate it is the estimate.
    found = asked.pose_at(asked.stamp)
    np.testing.assert_allclose(found.pose, asked.pose, atol=1e-12)
    np.testing.assert_allclose(found.covariance, asked.pose_covariance, atol=1e-12)


def test_before_the_first_measurement_there_is_none() -> None:
    with pytest.raises(icreckon.EstimatorError, match="before the first measurement"):
        PoseEstimator(ROBOT).pose_at(0)


@pytest.mark.parametrize(
    ("off", "words"),
    [
        (-1, "for the past set a mark"),
        (400_000_000, r"\+0.4 s from the estimate, and must be 0 to 0.3 s"),
        (0.5, "integer"),
    ],
)
def test_other_stamps_are_refused(log: Log, off: float, words: str) -> None:
    estimator = feed_all(PoseEstimator(ROBOT), islice(log.measurements(), 200))
    with pytest.raises(icreckon.EstimatorError, match=words):
        estimator.pose_at(estimator.stamp + off)  # type: ignore[arg-type]
