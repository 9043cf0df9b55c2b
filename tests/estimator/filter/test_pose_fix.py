"""Pose fixes with a full covariance: the dense Kalman update, one gate, and a way back."""

import numpy as np
import pytest

from fed_estimators import feed_all
from icreckon import GateSettings, PoseEstimator, Scenario, Settings, load_robot, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.filter.gate import CHI_SQUARE_1E4
from icreckon.estimator.log.measurements import HeadingFix, PoseFix, TrackSpeeds
from icreckon.estimator.sensors.predictions import pose_ahead
from same_runs import apart

ALPHA = load_robot("auriga-alpha")
STEP = 10_000_000
START = {"start": (1.0, 2.0, 3.0), "start_sigma": (0.3, 0.2, 0.1)}
SMALL = ((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.001))


def driven(seconds=9.0, **options):
    """An estimator in a slalom, its covariance full; at its stamp there was an IMU sample."""
    settings = Settings(**options)
    estimator = PoseEstimator(ALPHA, settings=settings, **START)
    log = simulate(
        Scenario(duration=seconds, trajectory="slalom", fix_rate=0.0, seed=4, imu_rate=50.0), ALPHA
    )
    feed_all(estimator, log)
    return estimator


def random_covariance(rng, scale=(0.2, 0.3, 0.1)):
    root = np.array(scale)[:, None] * rng.normal(size=(3, 3))
    return root @ root.T


def dense_update(x, P, residual, H, R):
    """The textbook's."""
    S = H @ P @ H.T + R
    gain = np.linalg.solve(S, H @ P).T
    left = np.eye(s.SIZE) - gain @ H
    return x + gain @ residual, left @ P @ left.T + gain @ R @ gain.T


@pytest.mark.parametrize("seed", range(2))
def test_it_is_the_dense_update(seed):
    rng = np.random.default_rng(seed)
    estimator, R = driven(), random_covariance(rng)
    x, P = estimator.state, estimator.covariance
    H = np.eye(s.SIZE)[s.POSE]
    residual = rng.multivariate_normal(np.zeros(3), H @ P @ H.T + R)
    pose = (x[s.POSE] + residual).tolist()
    assert estimator.feed(PoseFix(estimator.stamp, *pose, R)) is True
    assert apart(estimator, *dense_update(x, P, residual, H, R)) < 1e-9


@pytest.mark.parametrize("seed", range(2))
def test_between_imu_samples_it_is_the_dense_update_of_the_prediction(seed):
    rng = np.random.default_rng(seed)
    estimator, R = driven(), random_covariance(rng, (0.01, 0.01, 0.005))
    x, P, stamp = estimator.state, estimator.covariance, estimator.stamp
    reckoning, elapsed = estimator._reckoning, 0.013
    model, later = reckoning.model_over(elapsed), stamp + round(elapsed * 1e9)
    density = 1e4 * reckoning._fast_slip_density(later, model)
    reckoning._fast_slip_density = lambda *_: density
    predicted = pose_ahead(x, model, density, elapsed)
    assert np.abs(predicted.R / R).max() > 0.1, "or its correlations count for nothing"
    residual = rng.normal(size=3) * np.sqrt(R.diagonal())
    fix = PoseFix(later, *(predicted.values + residual).tolist(), R)
    assert estimator.feed(fix) is True
    assert estimator.stamp == stamp
    expected = dense_update(x, P, residual, predicted.H, R + predicted.R)
    assert apart(estimator, *expected) < 1e-9


def test_the_gate_asks_all_three_together():
    """Along its long axis a fix may be far off, across it not."""
    estimator = driven()
    covariance = np.array([[1.0, 0.999, 0.0], [0.999, 1.0, 0.0], [0.0, 0.0, 0.01]])
    P, (x, y, yaw) = estimator.pose_covariance, estimator.pose
    spread = P + covariance
    for direction, used in (((1.0, -1.0, 0.0), False), ((1.0, 1.0, 0.0), True)):
        away = np.array(direction)
        far = np.sqrt(1.2 * CHI_SQUARE_1E4[3] / (away @ np.linalg.solve(spread, away)))
        near = far / 1.2
        dx, dy, _ = away * (near if used else far)
        assert (
            estimator.feed(PoseFix(estimator.stamp + used, x + dx, y + dy, yaw, covariance)) is used
        )
    assert estimator.health.rejections() == {"pose: gate": 1}
    assert estimator.health.sensors["pose"].degrees == 3


@pytest.mark.parametrize("away", [(40.0, -30.0, 2.5), (0.0, 0.0, 2.5), (0.0, 25.0, 0.0)])
def test_a_robot_that_was_carried_away_is_found_again(away):
    estimator = driven(gates=GateSettings(patience=1.0))
    there = estimator.pose + away
    stamp, used = estimator.stamp, []
    for k in range(1, 60):
        stamp += 20 * STEP
        estimator.feed(TrackSpeeds(stamp, 0.0, 0.0))
        used.append(estimator.feed(PoseFix(stamp + k, *there.tolist(), SMALL)))
    # The first has no interval; what is far away has to wait for six times as long.
    waits = 1.0 if away[:2] == (0.0, 0.0) else 6.0
    rejected = round(waits / (20 * STEP * 1e-9)) + 1
    assert used == [False] * rejected + [True] * (59 - rejected)
    wrong = estimator.pose - there
    wrong[2] = wrap_angle(wrong[2])
    assert np.abs(wrong).max() < 0.1


def with_element(row, column, value):
    covariance = np.array(SMALL)
    covariance[row, column] = value
    return covariance


BAD = {
    "covariance is not finite": [with_element(0, 1, np.nan)],
    "variance not positive": [with_element(1, 1, 0.0), with_element(2, 2, -0.1)],
    "covariance not symmetric": [
        with_element(2, 0, 1e-5),
        [[1e-200, 1e200, 0.0], [-1e200, 1e-200, 0.0], [0.0, 0.0, 1.0]],
    ],
    "covariance not positive definite": [
        [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        # Each pair would do, the three of them do not.
        [[1.0, 0.9, 0.9], [0.9, 1.0, 0.0], [0.9, 0.0, 1.0]],
        # A correlation that no float holds.
        [[1e-200, 1e200, 0.0], [1e200, 1e-200, 0.0], [0.0, 0.0, 1.0]],
    ],
}


@pytest.mark.parametrize(
    ("reason", "covariance"), [(reason, one) for reason, many in BAD.items() for one in many]
)
def test_a_covariance_that_cannot_be_is_refused_by_its_reason(reason, covariance):
    estimator = driven(0.5)
    before = estimator.state.tolist()
    assert estimator.feed(PoseFix(estimator.stamp, 0.0, 0.0, 0.0, covariance)) is False
    assert estimator.state.tolist() == before
    assert estimator.health.rejections() == {f"pose: {reason}": 1}


@pytest.mark.parametrize("turn", [0.0, 0.7, 1.2])
def test_a_corridor_may_lie_in_any_direction(turn):
    """Along it nothing is known: a kilometre, next to a centimetre across."""
    along = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0]])
    axes = np.vstack([along, [0.0, 0.0, 1.0]])
    estimator = driven()
    before, off = estimator.pose, axes @ (0.0, 0.1, 0.0)
    covariance = axes @ np.diag([1e6, 1e-4, 1e-4]) @ axes.T
    assert estimator.feed(PoseFix(estimator.stamp, *before + off, covariance))
    assert axes.T @ (estimator.pose - before) == pytest.approx((0.0, 0.1, 0.0), abs=0.05)


def test_a_covariance_that_is_symmetric_but_for_rounding_is_taken_as_symmetric():
    tilted = np.array([[0.04, 0.01, 0.0], [0.01 + 1e-12, 0.05, 0.0], [0.0, 0.0, 0.01]])
    one, other = driven(), driven()
    assert one.feed(PoseFix(one.stamp, *one.pose + 0.05, tilted))
    assert other.feed(PoseFix(other.stamp, *other.pose + 0.05, tilted.T))
    assert (one.state == other.state).all()


@pytest.mark.parametrize("kind", ["pose", "heading"])
def test_a_heading_of_another_frame_is_a_finding_while_it_is_rejected(kind):
    log = simulate(Scenario(duration=25.0, trajectory="slalom", fix_rate=0.0, seed=4), ALPHA)
    estimator, due = PoseEstimator(ALPHA), log.start + 20_000_000_000
    for measurement in log.measurements():
        estimator.feed(measurement)
        if measurement.stamp < due:
            continue
        due += 1_000_000_000
        yaw = estimator.pose[2] + 1.0
        fix = HeadingFix(measurement.stamp, yaw, 1e-4)
        if kind == "pose":
            place = estimator.pose[:2].tolist()
            fix = PoseFix(measurement.stamp, *place, yaw, np.diag([0.01, 0.01, 1e-4]))
        assert not estimator.feed(fix)
    found = estimator.health.finding("rejected")
    assert (found.sensor, found.size) == (kind, pytest.approx(4.0, abs=1.1))
