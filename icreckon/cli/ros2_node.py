"""`icreckon ros2-node`: the ROS 2 node."""

from typing import Annotated

import typer
from typer import Option

from icreckon.cli.common.options import VARIANT_NAMES, robot_option
from icreckon.ros2.node import run_node

CONTEXT_SETTINGS = {"allow_extra_args": True, "ignore_unknown_options": True}


def command(
    context: typer.Context,
    robot: Annotated[str | None, robot_option(" whose [log] names the topics")] = None,
    variant: Annotated[
        str | None,
        Option(help="Filter variant (default: inertia-online).", autocompletion=VARIANT_NAMES),
    ] = None,
) -> None:
    """Run as a ROS 2 node: odometry, tf and diagnostics, live.

    Other arguments go to ROS, as --ros-args -p publish_tf:=false; docs/reference/ros2-node.md lists the
    parameters.
    """
    run_node(robot, variant, context.args)
