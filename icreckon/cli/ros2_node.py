"""`icreckon ros2-node`: the ROS 2 node."""

from __future__ import annotations

from icreckon.ros2.node import run_node


def run_ros2_node(*, robot: str | None, variant: str | None, arguments: list[str]) -> None:
    """Run `icreckon ros2-node`; arguments as in its help."""
    run_node(robot, variant, arguments)
