"""Export formats of trajectories in a result folder."""

from collections.abc import Sequence

from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.log.log import Log
from icreckon.replay.base.errors import ReplayError

# Content of each format, for help and messages.
FORMATS = {
    "tum": "trajectories, t x y z qx qy qz qw",
    "csv": "time series",
    "parquet": "time series",
    "mcap": "messages, for Foxglove, PlotJuggler and ROS 2",
    "ros1": "the same messages as a ROS 1 bag",
    "geojson": "paths on the globe, for maps",
}
DEFAULT_FORMATS = ("tum", "mcap")


def parse_formats(text: str | None) -> tuple[str, ...]:
    """Parse comma-separated names into the order of `FORMATS`; None is the default.

    Raises:
        ReplayError: there is no such format, or none is named; "none" alone is allowed.
    """
    if text is None:
        return DEFAULT_FORMATS
    words = [word.strip().lower() for word in text.split(",") if word.strip()]
    if words == ["none"]:
        return ()
    if not words:
        raise ReplayError("--formats names none; to write no trajectories, say --formats none")
    for word in words:
        if word not in FORMATS:
            raise ReplayError(f"--formats {word!r}{nearest_hint(word, list(FORMATS))}")
    return tuple(name for name in FORMATS if name in words)


def check_formats(formats: Sequence[str], log: Log) -> None:
    """Raise a ReplayError if a format needs a place on the globe that a log lacks."""
    if "geojson" in formats and log.origin is None:
        raise ReplayError(
            f"--formats geojson needs places on the globe, and log {log.name!r} has none: its fixes, or "
            "its truth if it has one, must be NavSatFix messages or columns of latitude and longitude"
        )
