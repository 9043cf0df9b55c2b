"""Options that several commands have."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from icreckon.estimator.robot.robot_file import robot_names
from icreckon.estimator.robot.variants import VARIANTS

LOG_FILES = "a ROS 1 .bag, a ROS 2 folder, an .mcap or a .db3, a CSV or Parquet table"


def completed_by(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Completion by names, also of the last one of several with commas between."""

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        return [f"{before}{comma}{name}" for name in names() if name.startswith(last)]

    return complete


VARIANT_NAMES = completed_by(lambda: VARIANTS)


def robot_option(more: str = "") -> Any:
    """Option --robot, completed by the names of the robots that ship."""
    text = f"Name of a robot that ships with icreckon, or a TOML file{more}."
    return Option("--robot", help=text, autocompletion=completed_by(robot_names))


def logs(text: str) -> Any:
    """Argument of one or more logs."""
    return Argument(help=text, metavar="LOG...", show_default=False)


Logs = Annotated[
    list[Path], logs(f"{LOG_FILES[0].upper()}{LOG_FILES[1:]}; several files are read as one log.")
]
RobotName = Annotated[str | None, robot_option(". Required")]
MessageFiles = Annotated[
    list[Path] | None,
    Option(
        "--msg",
        help="Definition of a message type that the bag lacks, as our_msgs/msg/Rate.msg; "
        "repeatable.",
    ),
]
Ros = Annotated[
    Path | None,
    Option(help="Write settings for ROS here: diff_drive_controller, covariances, IMU frame."),
]
Formats = Annotated[
    str | None,
    Option(
        help="Formats of the trajectories, separated by commas: tum, csv, parquet, mcap, "
        "ros1, geojson, or none (default: tum,mcap)."
    ),
]
Out = Annotated[Path | None, Option(help="Folder for the results (default: a new one, printed).")]
Json = Annotated[bool, Option("--json", help="Print JSON instead of text.")]
Wide = Annotated[bool, Option("--wide", help="Show all columns, however narrow the terminal is.")]
Overwrite = Annotated[bool, Option("--overwrite", help="Replace what icreckon wrote there before.")]
Workers = Annotated[int | None, Option(min=1, help="Threads (default: one for each core).")]
