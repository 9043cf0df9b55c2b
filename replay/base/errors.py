"""Error type of the replay package."""

from icreckon.estimator.base.errors import IcreckonError


class ReplayError(IcreckonError):
    """A log cannot be read, mapped or replayed as requested."""


OF_ROBOT_FILE = "robot file: "
"""First words of the notes on a log that contradict the robot file."""
