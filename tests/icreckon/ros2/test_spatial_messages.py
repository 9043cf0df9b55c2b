"""Messages of the node in three dimensions, and the same in two."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from icreckon import HeightFix, ImuSample, PositionFix, TrackSpeeds, load_robot
from icreckon.replay.bags.message_types import ODOMETRY, TRANSFORM
from icreckon.replay.bags.messages import Messages
from icreckon.replay.live.base_frame import Pose
from icreckon.replay.live.odometry import LiveEstimate, LiveOdometry
from icreckon.ros2.messages import fill_odometry, fill_transform

MESSAGES, STEP = Messages(ros1=False), 10_000_000


def on_a_slope(offset: Pose = (0.0, 0.0, 0.0)) -> LiveEstimate:
    """Estimate of a robot that drives up a slope, with fixes of position and height."""
    live = LiveOdometry(load_robot("auriga-alpha"), start_pose=(0.0, 0.0, 0.0), base_offset=offset)
    force = (0.6, 0.3, 9.78)
    for k in range(600):
        group = [TrackSpeeds(k * STEP, 0.4, 0.5), ImuSample(k * STEP, (0.01, -0.02, 0.1), force)]
        for measurement in group:
            live.odom.feed(measurement)
        fixes = [PositionFix(k * STEP, 0.0, 0.0, 100.0), HeightFix(k * STEP, 40.0, 1.0)]
        live.map.take(group + fixes * (k == 300), live.odom, in_odom=False)
    found: LiveEstimate = live._estimate()
    return found


def test_odometry_has_height_roll_and_pitch_if_asked() -> None:
    one = on_a_slope()
    flat = fill_odometry(MESSAGES.new(ODOMETRY), one, "odom", "base_link")
    full = fill_odometry(MESSAGES.new(ODOMETRY), one, "odom", "base_link", planar=False)
    at, q = full.pose.pose.position, full.pose.pose.orientation
    assert (at.x, at.y, at.z) == tuple(one.pose3d.position)
    assert at.z > 0.05
    turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
    assert turn.as_euler("xyz") == pytest.approx(one.pose3d.rpy)
    assert np.reshape(full.pose.covariance, (6, 6)) == pytest.approx(one.pose3d.covariance)
    rates = full.twist.twist.angular
    assert [rates.x, rates.y, rates.z] == pytest.approx(one.twist3d.angular.tolist())
    assert rates.z == pytest.approx(0.1, abs=0.02)
    variances = np.reshape(full.twist.covariance, (6, 6)).diagonal()
    assert variances[2] == 1e6
    assert variances[[0, 1, 3, 4, 5]].max() < 1.0
    at, q = flat.pose.pose.position, flat.pose.pose.orientation
    assert (at.z, q.x, q.y) == (0.0, 0.0, 0.0)
    assert np.reshape(flat.pose.covariance, (6, 6)).diagonal()[2:5].tolist() == [1e6] * 3


def test_the_map_has_the_height_of_its_fixes() -> None:
    one = on_a_slope()
    in_map, placed = one.in_map(planar=False), one.odom_in_map(planar=False)
    assert in_map.position[2] == pytest.approx(40.0, abs=2.0)
    message = fill_transform(MESSAGES.new(TRANSFORM), 0, "map", "odom", placed)
    # Base frame in map by way of odom.
    height = message.transform.translation.z + one.pose3d.position[2]
    assert height == pytest.approx(in_map.position[2])
    assert one.odom_in_map(planar=True).position[2] == 0.0
    without = one._replace(map_pose=None, map_covariance=None, fixed=None)
    assert without.odom_in_map(planar=False) is None


@pytest.mark.parametrize("offset", [(0.3, -0.1, 0.0), (0.0, 0.0, np.pi / 2), (0.2, 0.4, -0.6)])
def test_a_base_frame_elsewhere_is_tilted_as_the_robot_is(offset: Pose) -> None:
    centre, one = on_a_slope().pose3d, on_a_slope(offset).pose3d
    turn = Rotation.from_euler("xyz", centre.rpy)
    lever = turn.apply([offset[0], offset[1], 0.0])
    assert one.position[2] == pytest.approx(centre.position[2] + lever[2])
    up = Rotation.from_euler("xyz", one.rpy).inv().apply([0.0, 0.0, 1.0])
    expected = Rotation.from_euler("z", -offset[2]).apply(turn.inv().apply([0.0, 0.0, 1.0]))
    assert up == pytest.approx(expected)
    assert one.covariance[3:5, 3:5].trace() == pytest.approx(centre.covariance[3:5, 3:5].trace())
