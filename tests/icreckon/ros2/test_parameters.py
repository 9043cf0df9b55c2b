"""Parameters of the node, and messages, without ROS."""

from array import array

import numpy as np
import pytest

from bag_messages import pose_with_covariance
from icreckon.estimator.base.errors import EstimatorError
from icreckon.ros2.messages import pose_of
from icreckon.ros2.parameters import check_qos, constraints, options_from, unknown_parameters


def test_unknown_parameters_come_with_the_nearest() -> None:
    (text,) = unknown_parameters(["robot", "base_offset", "use_sim_time", "robot_fle"])
    assert text == "parameter 'robot_fle' is unknown and has no effect; did you mean 'robot'?"


def test_qos_is_that_of_a_topic_of_the_node() -> None:
    given = {"qos_overrides./tf.publisher.depth": 5, "qos_overrides./imu.subscription.depth": 5}
    assert check_qos(given, ["/tf.publisher", "/imu.subscription"]) == []
    (text,) = check_qos(given, ["/tf.publisher", "/imus.subscription"])
    assert text.startswith("parameter 'qos_overrides./imu.subscription.depth' is unknown")
    assert "did you mean 'qos_overrides./imus.subscription.depth'?" in text


@pytest.mark.parametrize(
    ("policy", "value", "match"),
    [
        ("depth", "ten", "must be a whole number, found 'ten'"),
        ("depth", -1, "must be a whole number, found -1"),
        ("reliability", "best_efort", "did you mean 'best_effort'"),
        ("history", 3, "there is .keep_all., .keep_last."),
    ],
)
def test_an_invalid_qos_is_refused(policy: str, value: object, match: str) -> None:
    with pytest.raises(EstimatorError, match=match):
        check_qos({f"qos_overrides./tf.publisher.{policy}": value}, ["/tf.publisher"])


@pytest.mark.parametrize("name", ["start_pose", "base_offset"])
@pytest.mark.parametrize(
    ("values", "match"),
    [
        ([1.0, 2.0], "{} must be three numbers, x, y"),
        ([1.0, 2.0, float("nan")], "{} must be three numbers, x, y"),
        ([1.0, 2.0, 90.0], r"90 rad is more than a full turn.* 1\.5708 rad"),
    ],
)
def test_no_pose_or_a_yaw_in_degrees_is_one_clear_line(name, values, match):
    with pytest.raises(EstimatorError, match=match.format(name)):
        options_from({"robot": "a", name: values})


def test_a_pose_message_is_planar() -> None:
    turned = (0.0, 0.0, 2.0 * np.sin(0.2), 2.0 * np.cos(0.2))
    message = pose_with_covariance(0, (0.1, 0.2, 0.3), x=1.0, y=2.0, q=turned)
    pose, covariance = pose_of(message)
    assert pose == pytest.approx((1.0, 2.0, 0.4))
    assert np.array_equal(np.array(covariance), np.diag([0.1, 0.2, 0.3]))
    for zero in ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, np.nan, 1.0)):
        with pytest.raises(EstimatorError, match="orientation is no rotation"):
            pose_of(pose_with_covariance(0, (0.1, 0.2, 0.3), q=zero))


@pytest.mark.parametrize("values", [[1, 2, 0], array("d", [1.0, 2.0, 0.0]), array("q", [1, 2, 0])])
def test_a_pose_is_three_numbers_of_any_kind_or_none(values: object) -> None:
    options = options_from({"robot": "a", "start_pose": values, "base_offset": values})
    assert options.start == options.base == (1.0, 2.0, 0.0)
    options = options_from({"robot": "a", "start_pose": []})
    assert (options.start, options.base) == (None, (0.0, 0.0, 0.0))


def test_constraints_are_those_that_are_checked() -> None:
    assert constraints("reorder") == "from 0 to 10"
    assert constraints("input_reliability") == "auto, reliable, best_effort"
    assert constraints("robot") == constraints("start_pose") == ""
