"""An accelerometer that is wrong for a moment does not turn the ground into a cliff."""

from __future__ import annotations

import numpy as np
import pytest

from icreckon.estimator.base import state as s
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

ALPHA = load_robot("auriga-alpha")
STEP = 10_000_000


@pytest.mark.parametrize("variant", [one for one in VARIANTS if VARIANTS[one].accelerometers])
def test_a_short_fault_leaves_gravity_and_motion_as_they_were(variant: str) -> None:
    """Forty m/s² for 0.4 s, in a bend: long enough for the gate to give in."""
    estimator = PoseEstimator(ALPHA, variant)
    twists = []
    for k in range(1200):
        stamp = k * STEP
        if k % 2 == 0:
            estimator.feed(TrackSpeeds(stamp, 0.3, 0.6))
        v_x, v_y, w = estimator.twist.tolist()
        knocked = 40.0 if 600 <= k < 640 else 0.0
        estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.27), (-w * v_y, w * v_x + knocked, 9.81)))
        twists.append(estimator.twist)
    assert estimator.health.sensors["accelerometer_y"].reacquired > 0
    assert np.hypot(*estimator.state[s.GRAVITY]) < 0.5
    # Some uncertainty of the slip is used to explain it, too.
    assert np.abs(np.array(twists[600:]) - twists[590]).max() < 0.1
    assert estimator.twist == pytest.approx(twists[590], abs=0.02)
