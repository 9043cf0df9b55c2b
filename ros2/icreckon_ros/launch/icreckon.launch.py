"""Launch the odometry: `ros2 launch icreckon_ros icreckon.launch.py robot:=robot.toml`."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "robot": ("", "Robot file, or name of a shipped robot; empty: that of params_file"),
    "variant": ("", "Filter variant; empty: that of params_file"),
    "state_file": ("", "File of learnt parameters; empty: that of params_file"),
    "params_file": (
        PathJoinSubstitution([FindPackageShare("icreckon_ros"), "config", "icreckon.yaml"]),
        "Values of all parameters",
    ),
    "use_sim_time": ("false", "Use the time of /clock"),
    "namespace": ("", "Namespace of the node and of its relative topics"),
    "respawn": ("false", "Start the node again, two seconds after it ends"),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the node."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=make_node)])


def make_node(context: LaunchContext) -> list[Node]:
    """Make the node; an empty argument leaves the value of params_file."""
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=str)
        for name in ("robot", "variant", "state_file")
        if LaunchConfiguration(name).perform(context)
    }
    parameters["use_sim_time"] = ParameterValue(
        LaunchConfiguration("use_sim_time"), value_type=bool
    )
    return [
        Node(
            package="icreckon_ros",
            executable="odometry",
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), parameters],
            output="screen",
            respawn=LaunchConfiguration("respawn"),
            respawn_delay=2.0,
        )
    ]
