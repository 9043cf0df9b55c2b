"""Error types of the replay package, and first words of notes of weight."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from icreckon.estimator.base.errors import IcreckonError


class ReplayError(IcreckonError):
    """A log cannot be read, mapped or replayed as requested."""


class EqualStampsError(ReplayError):
    """All times of a table are equal."""


@contextmanager
def os_errors(path: Path, what: str) -> Iterator[None]:
    """Report errors of the file system with the path, and what cannot be done with it."""
    try:
        yield
    except OSError as problem:
        raise ReplayError(f"{path}: {what}: {problem.strerror or problem}") from None


OF_STAMPS = "stamps: "  # first words of the notes on coarse stamps, which come before all else
OF_LEFT_OUT = "the log holds "  # first words of the notes on streams that the robot file leaves out
OF_ROBOT_FILE = "robot file: "  # first words of the notes on a log that contradict the robot file


def coarse_stamps(notes: Iterable[str]) -> list[str]:
    """Notes on coarse stamps, among those of a log."""
    return [note for note in notes if note.startswith(OF_STAMPS)]


class ApartError(ReplayError):
    """Track speeds and IMU that do not overlap in time."""


class NoRowsError(ReplayError):
    """A table without rows; among several files of a log it is left out."""
