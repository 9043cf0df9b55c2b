"""Start of the pose in `map`: by fixes that come late."""

import numpy as np
import pytest

from icreckon import PoseEstimator, Scenario, load_robot, simulate
from icreckon.estimator.base.frames import compose, rotate, wrap_angle
from icreckon.estimator.log.measurements import HeadingFix, PositionFix
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.replay.live.map_frame import MapFrame

ALPHA, LATE = load_robot("auriga-alpha"), 150_000_000
IN_MAP = np.array([40.0, -7.0, 2.0])  # pose of odom in map


@pytest.mark.parametrize("of_heading", [LATE, 3 * LATE])
def test_a_robot_that_turns_starts_where_it_is_now(of_heading: int) -> None:
    """Not where it was as fix and heading were measured."""
    log = simulate(Scenario(duration=12.0, seed=4, trajectory="random", fix_rate=0.0), ALPHA)
    assert log.truth is not None
    twists = log.truth.twists
    now = int(twists.stamps[np.abs(twists.twists[:, 2]).argmax()])
    odom, frame = PoseEstimator(ALPHA, "inertia-online"), MapFrame()
    for measurement in log.measurements():
        if measurement.stamp > now:
            break
        odom.feed(measurement)
        frame.take([measurement], odom, in_odom=False)
    stamps = np.array([now - of_heading, now - LATE, odom.stamp])
    at_heading, at_fix, at_end = compose(IN_MAP, interpolate_poses(log.truth.poses, stamps))
    assert abs(at_end[2] - at_heading[2]) > 0.04
    x, y = at_fix[:2] + rotate((0.5, 0.1), at_fix[2])
    heading = HeadingFix(int(stamps[0]), float(at_heading[2]), 1e-4)
    frame.take([heading], odom, in_odom=False)
    fix = PositionFix(int(stamps[1]), float(x), float(y), 1e-4, 0.5, 0.1)
    frame.take([fix], odom, in_odom=False)
    assert frame.estimator is not None
    off = frame.estimator.pose - at_end
    assert np.hypot(*off[:2]) < 0.02
    assert abs(wrap_angle(off[2])) < 0.01
