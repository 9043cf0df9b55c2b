"""`icreckon robots`: the robots that ship."""

from rich.table import Table

from icreckon.cli.common.console import results
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, load_robot, robot_names


def command() -> None:
    """List the robots that ship with icreckon, for --robot.

    Their files are in the folder that is printed, to begin a file of your own with.
    """
    table = Table()
    table.add_column("robot", no_wrap=True)
    for heading in ("mass\nkg", "track gauge\nm", "radius\nm"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("track speeds and IMU in its logs")
    for name in robot_names():
        robot = load_robot(name)
        vehicle = robot.vehicle
        topics = [robot.log.get(stream, {}).get("topic", "") for stream in ("tracks", "imu")]
        numbers = (vehicle.mass, vehicle.track_gauge, vehicle.sprocket_radius)
        cells = [f"{number:.4g}" for number in numbers]
        table.add_row(name, *cells, "\n".join(filter(None, topics)))
    console = results()
    console.print(table)
    console.print(f"Files: {ROBOTS_FOLDER}", soft_wrap=True)
