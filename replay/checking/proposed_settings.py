"""Settings for ROS before there is a complete robot file."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path

from icreckon.estimator.robot.robot_file import make_robot
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.checking.ros_settings import ros_settings
from icreckon.replay.inspection.filled_in import has_stand_in_gauge
from icreckon.replay.reading.read_log import read_log

# Mass that a robot file must have, and these settings do not use [kg].
ANY_MASS = 50.0


def proposed_ros_settings(
    proposed: str, paths: Sequence[Path], definitions: Definitions = ()
) -> str:
    """Format settings for ROS by a log and the robot file proposed for it.

    Args:
        proposed: text of the proposed robot file; mass and gauge may be missing.
        paths: files of the log.
        definitions: message types that bags lack, as for `read_log`.

    Raises:
        ReplayError: no track speeds in metres, since the effective radius is not known.
    """
    tables = tomllib.loads(proposed)
    vehicle, name = tables["vehicle"], tables.pop("name")
    tables.pop("format", None)
    if math.isnan(vehicle["sprocket_radius"]):
        raise ReplayError(
            "settings for ROS need the effective radius, which this log does not show: fill in "
            "sprocket_radius in the proposed robot file, then icreckon check --ros"
        )
    without_gauge = math.isnan(vehicle["track_gauge"])
    of_controller = tables.get("log", {}).get("tracks", {}).get("gauge", 1.0)
    for key, value in (("mass", ANY_MASS), ("track_gauge", of_controller)):
        if math.isnan(vehicle[key]):
            vehicle[key] = value
    robot = make_robot(name, **tables)
    log = read_log(list(paths), robot, definitions=definitions)
    return ros_settings([log], robot, proposed=without_gauge or has_stand_in_gauge(proposed))
