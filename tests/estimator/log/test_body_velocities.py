"""Velocities of the robot by the poses and twists of another odometry."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

import icreckon
from icreckon.estimator.base.frames import compose
from icreckon.estimator.log.body_velocities import of_twists

MILLISECOND = 1_000_000
PLACES = st.floats(-1.0, 1.0)


def arc(twist, times) -> np.ndarray:
    """Poses (n, 3) of a robot with a constant twist at some times [s]."""
    v_x, v_y, w = twist
    moved = [expm(time * np.array([[0, -w, v_x], [w, 0, v_y], [0, 0, 0]])) for time in times]
    poses = [(m[0, 2], m[1, 2], np.arctan2(m[1, 0], m[0, 0])) for m in moved]
    return np.reshape(poses, (-1, 3))


@given(
    twist=st.tuples(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(-2.0, 2.0)),
    sensor=st.tuples(PLACES, PLACES, st.floats(-3.0, 3.0)),
    frame=st.tuples(PLACES, PLACES, st.floats(-3.0, 3.0)),
)
def test_a_constant_twist_is_found_by_a_sensor_at_any_place_in_any_frame(twist, sensor, frame):
    stamps = np.arange(8) * 100 * MILLISECOND
    robot = compose(np.array(frame), arc(twist, stamps * 1e-9))
    seen = icreckon.PoseSeries(stamps, compose(robot, np.array(sensor)))
    found = icreckon.body_velocities(seen, 0.1, sensor[:2], sensor[2])
    assert [one.stamp for one in found] == (stamps[:-1] + 50 * MILLISECOND).tolist()
    np.testing.assert_allclose([(one.v_x, one.v_y) for one in found], [twist[:2]] * 7, atol=1e-9)
    assert {one.variance for one in found} == {0.1**2}
    # A sensor that measures its twist itself.
    x, y, yaw = sensor
    v_x, v_y = twist[0] - twist[2] * y, twist[1] + twist[2] * x
    cos, sin = np.cos(yaw), np.sin(yaw)
    turned = np.array([[cos * v_x + sin * v_y, cos * v_y - sin * v_x, twist[2]]])
    (own,) = of_twists(stamps[:1], turned, 0.1, (x, y), yaw)
    np.testing.assert_allclose((own.v_x, own.v_y), twist[:2], atol=1e-9)


def test_poses_that_come_in_bursts_or_stay_away_give_no_velocity():
    times = np.array([0, 40, 100, 101, 200, 900, 980])  # a burst at 100 ms, a hole of 700 ms
    found = icreckon.body_velocities(
        icreckon.PoseSeries(times * MILLISECOND, arc((1.0, 0.0, 0.0), times * 1e-3)), 0.1
    )
    assert [one.stamp // MILLISECOND for one in found] == [50, 150, 940]
    assert icreckon.body_velocities(icreckon.PoseSeries(times[:0], arc((0, 0, 0), ())), 0.1) == []


@pytest.mark.parametrize("sigma", [0.0, -1.0, float("nan"), None])
def test_a_sigma_is_positive(sigma):
    with pytest.raises(icreckon.EstimatorError, match="sigma"):
        icreckon.body_velocities(icreckon.PoseSeries(np.arange(1), np.zeros((1, 3))), sigma)
