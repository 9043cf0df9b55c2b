"""Test vectors of a filter in C: measurements and the estimates in Python."""

from collections.abc import Iterable

from icreckon.estimator.log.input_checks import key_of
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    Measurement,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

HEADER = "kind,stamp,used,values..."
EVERY = 50  # measurements between two rows of states


def vectors_of(
    robot: Robot, variant: Variant, states: list[int], measurements: Iterable[Measurement]
) -> str:
    """Make the rows of `test_vectors.csv`.

    A row of a measurement has its stamp [ns], 1 if the Python filter used it, and its values. A row of
    states has the value and the variance of each.

    Args:
        robot: the robot.
        variant: the filter variant.
        states: indices of the states that the filter in C estimates.
        measurements: those that the filter in C takes, in any order.
    """
    estimator, rows = PoseEstimator(robot, variant.name), [HEADER]
    ordered = sorted(measurements, key=key_of)
    for number, measurement in enumerate(ordered, 1):
        row = values_of(measurement)
        if row is None:
            continue
        kind, values = row
        used = int(estimator.feed(measurement))
        rows.append(",".join([kind, str(measurement.stamp), str(used), *map(repr, values)]))
        if number % EVERY == 0 and estimator.stamp is not None:
            snapshot = estimator.snapshot()
            pairs = ((snapshot.state[i], snapshot.covariance[i, i]) for i in states)
            values = [float(value) for pair in pairs for value in pair]
            rows.append(",".join(["state", str(snapshot.stamp), "1", *map(repr, values)]))
    return "\n".join([*rows, ""])


def values_of(measurement: Measurement) -> tuple[str, list[float]] | None:
    """Kind and values of a measurement in C; None if the filter in C does not take it."""
    match measurement:
        case TrackSpeeds(left=left, right=right):
            return "tracks", [left, right]
        case ImuSample(angular_velocity=rates, linear_acceleration=force):
            return "imu", [*rates, *(force or (float("nan"),) * 3)]
        case PositionFix(x=x, y=y, variance=variance, forward=forward, left=left, up=up):
            return "position", [x, y, variance, forward, left, up]
        case HeadingFix(yaw=yaw, variance=variance):
            return "heading", [yaw, variance]
        case BodyVelocity(v_x=v_x, v_y=v_y, variance=variance):
            return "velocity", [v_x, v_y, variance]
        case ZeroVelocity(sigma=sigma):
            return "zero", [*sigma]
    return None
