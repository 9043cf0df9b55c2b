"""Log reader: ROS 1 and ROS 2 bags and tables to a screened log in memory."""

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.mapping.topics import TopicMap, topic_map
from icreckon.replay.reading.gather import as_paths, first_path, gather
from icreckon.replay.reading.to_log import assemble

LOGGER = logging.getLogger(__name__)


def read_log(
    path: Path | str | Sequence[Path | str],
    robot: Robot,
    *,
    topics: TopicMap | None = None,
    definitions: Definitions = (),
    progress: Callable[[float], None] | None = None,
) -> Log:
    """Read bags and tables as one log.

    Supported are ROS 1 `.bag` files, ROS 2 folders, bare `.mcap` and `.db3` files, CSV and Parquet
    tables. A bag that was cut short is read up to the break; `notes` reports it. Messages that are
    late by less than a second are sorted, which is noted. Every stream is screened; `dropped` counts
    the lost samples.

    Args:
        path: the file or folder, or several that make one log. If one holds its own mapping (see
            `write_log`), that is used and noted.
        robot: the robot, for its topic mapping and its sprocket radius and gauge.
        topics: a mapping to use instead of the robot file's and the bag's.
        definitions: message types that bags lack, see `icreckon.replay.bags.decoding.read_definitions`.
        progress: called periodically with the share of the messages that is read, 0 to 1.

    Returns:
        The log, named after the first file. If the mapping has no track speeds, they are empty.

    Raises:
        ReplayError: no bag or table, no topic or no usable message for the track speeds, or an
            unsupported message type. Other missing streams are left out and noted.
    """
    paths = as_paths(path)
    mapping = topics if topics is not None else topic_map(robot)
    gathered = gather(
        paths, mapping, own_mapping=topics is None, definitions=definitions, progress=progress
    )
    first = first_path(path)
    log = assemble(gathered, robot, first.stem if first.is_file() else first.name)
    LOGGER.info("read %r", log)
    return log
