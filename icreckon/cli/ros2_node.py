"""`icreckon ros2-node`: the ROS 2 node."""

from __future__ import annotations

from icreckon.estimator.base.errors import EstimatorError
from icreckon.ros2.node import run_node


def run_ros2_node(*, robot: str | None, variant: str | None, arguments: list[str]) -> None:
    """Run `icreckon ros2-node`; arguments as in its help."""
    if arguments and arguments[0] != "--ros-args":
        raise EstimatorError(
            f"unknown argument {arguments[0]!r}: arguments of the command are --robot and --variant, "
            "those of ROS come after --ros-args"
        )
    run_node(robot, variant, arguments)
