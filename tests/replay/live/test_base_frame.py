"""The published base frame may be another point of the robot than the centre of its tracks."""

import numpy as np
import pytest

from icreckon.estimator.base.frames import compose, relative, rpy_to_matrix
from icreckon.estimator.robot.robot_file import Imu
from icreckon.replay.live.base_frame import BaseFrame, Pose

OFFSETS: list[Pose] = [(0.0, 0.0, 0.0), (-0.4, 0.1, 0.0), (0.3, -0.2, 0.7), (0.0, 0.0, np.pi)]
POSE, TWIST = np.array([1.0, -2.0, 0.6]), np.array([0.5, 0.1, 0.8])
SPREAD = np.array([[0.04, 0.01, 0.02], [0.01, 0.09, -0.01], [0.02, -0.01, 0.05]])
SMALL = 1e-6


def moved(change, at):
    """Jacobian (3, 3) of a change of a vector (3,), by differences."""
    return np.column_stack(
        [(change(at + step) - change(at - step)) / (2 * SMALL) for step in SMALL * np.eye(3)]
    )


@pytest.mark.parametrize("offset", OFFSETS)
def test_the_base_frame_is_at_its_place_on_the_robot(offset: Pose) -> None:
    base = BaseFrame(offset)
    in_map, _ = base.pose_in_map(POSE, SPREAD)
    assert in_map == pytest.approx(compose(POSE, offset))
    assert base.centre((in_map[0], in_map[1], in_map[2])) == pytest.approx(POSE.tolist())
    # It begins at the origin of odom.
    begun, _ = base.pose_in_odom(np.zeros(3), SPREAD)
    assert begun == pytest.approx(np.zeros(3), abs=1e-12)
    in_odom, _ = base.pose_in_odom(POSE, SPREAD)
    first, _ = base.pose_in_map(np.zeros(3), SPREAD)
    assert in_odom == pytest.approx(relative(first, in_map))
    x, y = base.point(0.0, 0.0)
    assert compose(offset, (x, y, 0.0))[:2] == pytest.approx([0.0, 0.0])


def test_an_imu_on_the_base_frame_is_placed_on_the_robot() -> None:
    base, upside_down = BaseFrame((0.3, -0.2, np.pi / 2)), rpy_to_matrix(np.pi, 0.0, 0.0)
    imu = base.mounted(Imu(), np.array([0.1, 0.0, 0.4]), upside_down)
    assert imu.position == pytest.approx((0.3, -0.1, 0.4))
    on_robot = rpy_to_matrix(*np.radians(imu.rotation_rpy_deg))
    np.testing.assert_allclose(
        on_robot, rpy_to_matrix(0.0, 0.0, np.pi / 2) @ upside_down, atol=1e-12
    )


@pytest.mark.parametrize("offset", OFFSETS)
def test_covariances_are_those_of_the_same_point(offset: Pose) -> None:
    base = BaseFrame(offset)
    for change in (base.pose_in_odom, base.pose_in_map, base.twist):
        jacobian = moved(lambda at, change=change: change(at, SPREAD)[0], POSE)
        expected = jacobian @ SPREAD @ jacobian.T
        assert change(POSE, SPREAD)[1] == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("offset", OFFSETS)
def test_the_twist_is_the_motion_of_the_pose(offset: Pose) -> None:
    base, seconds = BaseFrame(offset), 1e-5
    before, _ = base.pose_in_odom(POSE, SPREAD)
    after, _ = base.pose_in_odom(compose(POSE, TWIST * seconds), SPREAD)
    motion = relative(before, after) / seconds
    assert base.twist(TWIST, SPREAD)[0] == pytest.approx(motion, abs=1e-4)
