"""Very precise measurements of a state that is hardly known: the covariance stays positive."""

from dataclasses import replace

import numpy as np
import pytest

from fed_estimators import flaw
from icreckon import FixWander, GateSettings, Log, PoseEstimator, Settings, load_robot, run
from icreckon.estimator.base import state as s
from icreckon.estimator.filter.ekf import SHARP
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)

ALPHA = load_robot("auriga-alpha")
EPOCH = 1_700_000_000_000_000_000
STEP = 10_000_000
VARIANTS = "inertia-online", "constant-online", "differential"


def drive(rng, count, precise):
    """A drive with fixes of all kinds; variances from 1e-300 on if `precise`."""
    stamp, yaw, x, y = EPOCH, 0.0, 0.0, 0.0
    gap = int(rng.integers(20, count))

    def variance():
        return float(10.0 ** rng.uniform(-300.0 if rng.random() < 0.3 else -20.0, 0.0))

    for k in range(count):
        stamp += 10**9 * int(rng.choice([1, 50])) if k == gap else STEP
        rests = 30 < k % 90 < 50
        left, right = (0.0, 0.0) if rests else (rng.normal(0.5, 0.1), rng.normal(0.6, 0.1))
        yield TrackSpeeds(stamp, left, right)
        rate = 0.8 * (right - left)
        yaw += rate * 0.01
        x, y = x + 0.005 * (left + right) * np.cos(yaw), y + 0.005 * (left + right) * np.sin(yaw)
        force = (
            None if precise and k % 9 == 4 else (rng.normal(0.0, 0.1), rng.normal(0.0, 0.1), 9.81)
        )
        yield ImuSample(stamp + 3, (0.0, 0.0, rng.normal(rate, 0.002)), force)
        if rng.random() > 0.3:
            continue
        at, error = stamp + int(rng.integers(4, STEP)), rng.normal(0.0, 0.02, 3)
        kind = rng.integers(0, 6 if precise else 2)
        if kind == 0:
            yield PositionFix(at, x + error[0], y + error[1], variance(), 0.3, -0.1)
        elif kind == 1:
            yield HeadingFix(at, yaw + error[2], variance())
        elif kind == 2:
            yield BodyVelocity(at, 0.5 * (left + right) + error[0], error[1], variance())
        elif kind == 3:
            yield ZeroVelocity(at, tuple(max(variance(), 1e-290) ** 0.5 for _ in range(3)))
        else:
            mixing = rng.normal(size=(3, 3))
            sigmas = np.sqrt([max(variance(), 1e-290) for _ in range(3)])
            correlation = 0.999 * np.corrcoef(mixing) + 0.001 * np.eye(3)
            P = sigmas[:, None] * correlation * sigmas
            yield PoseFix(at, x + error[0], y + error[1], yaw + error[2], 0.5 * (P + P.T))


@pytest.mark.parametrize("sigma", [0.0, 1e6, 1e9])
def test_the_covariance_stays_positive_whatever_precision_is_claimed(sigma):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        settings = Settings(
            gates=GateSettings(patience=int(rng.choice([0, 3]))),
            wander=FixWander(1.0, 10.0) if rng.random() < 0.3 else None,
        )
        estimator = PoseEstimator(
            ALPHA, VARIANTS[seed % 3], settings=settings, start_sigma=(sigma, sigma, sigma)
        )
        for k, m in enumerate(drive(rng, 120, precise=True)):
            if k == 100:
                estimator.mark()
            estimator.feed(m)
            assert flaw(estimator.covariance) is None, (seed, k, m)
            assert np.isfinite(estimator.state).all(), (seed, k, m)
            assert np.isfinite(estimator.twist_covariance).all()
            for mark in estimator.marks:
                assert flaw(estimator.relative_motion(mark).covariance) is None, (seed, k, m)


def positions_alone(seed, count):
    """Log of a drive with position fixes, which filters side by side support."""
    measurements = drive(np.random.default_rng(seed), count, precise=False)
    log = Log.from_measurements(sorted(measurements, key=lambda m: m.stamp))
    return replace(log, others=())


@pytest.mark.parametrize("seed", range(6))
def test_lanes_stay_positive_too(seed):
    """With fixes at random places."""
    settings = Settings(gates=GateSettings(patience=0))
    options = {"settings": settings, "start_sigma": (1e6, 1e6, 1e3)}
    trajectory = run(positions_alone(seed, 300), ALPHA, "inertia-online", **options).trajectory
    for covariances in (trajectory.pose_covariances, trajectory.twist_covariances):
        flaws = [flaw(0.5 * (P + P.T)) for P in covariances]
        assert flaws == [None] * len(flaws)


def test_a_sharp_update_leaves_what_everyday_measurements_give():
    """One centimetre after ten metres is no sharp measurement: nothing is added to the variances."""
    estimator = PoseEstimator(ALPHA, start_sigma=(10.0, 10.0, 0.1))
    assert SHARP < 1e-4 / 100.0
    estimator.feed(PositionFix(EPOCH, 1.0, 1.0, 1e-4))
    expected = 100.0 * 1e-4 / (100.0 + 1e-4)
    variances = estimator.covariance.diagonal()
    assert variances[s.X] == pytest.approx(expected, rel=1e-9)
    assert variances[s.YAW] == pytest.approx(0.1**2, rel=1e-15)


def test_a_smoothed_drive_with_sharp_fixes_stays_finite():
    from icreckon.estimator.streaming.smoother import smooth

    log = positions_alone(5, 200)
    before, after = smooth(log, ALPHA, "inertia-online", start_sigma=(1e6, 1e6, 1e3))
    for found in (before, after):
        assert np.isfinite(found.trajectory.poses).all()
        variances = found.trajectory.pose_covariances.diagonal(axis1=1, axis2=2)
        assert np.isfinite(variances).all()
        assert variances.min() >= 0.0
