"""Encoders that jitter while the robot stands."""

import numpy as np
import pytest

from icreckon import ImuSample, PoseEstimator, TrackSpeeds, load_robot
from icreckon.estimator.base import state as s


@pytest.mark.xfail(strict=True, reason="the gyro's noise teaches eta0 by the noise of the tracks")
def test_it_teaches_no_parameter() -> None:
    rng = np.random.default_rng(0)
    estimator = PoseEstimator(load_robot("auriga-alpha"))
    before = estimator.state[s.ETA0]
    for k in range(2000):
        stamp = k * 10_000_000
        if k % 5 == 0:
            estimator.feed(TrackSpeeds(stamp, *(0.002 * rng.normal(size=2)).tolist()))
        estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.002 * rng.normal()), (0.0, 0.0, 9.81)))
    assert estimator.state[s.ETA0] == pytest.approx(before, abs=0.1)
