"""Paths on the globe as GeoJSON (RFC 7946), for QGIS and maps on the web."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.series import PoseSeries
from icreckon.replay.base.colours import FIX_COLOUR, TRUTH_COLOUR, colour_of
from icreckon.replay.base.outputs import write_text
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.export.formats import check_formats
from icreckon.replay.export.replay_bag import thinned
from icreckon.replay.mapping.geodesy import Origin, degrees

RATE = 5.0  # highest rate of the points of a path [Hz]
DECIMALS, HEIGHT_DECIMALS = 8, 3  # decimals of degrees and of metres: about a millimetre


def write_geojson(path: Path, comparison: Comparison) -> Path:
    """Write the paths of all runs, the truth and the fixes that were used.

    Each path is a LineString with the properties `name`, `start_ns`, `end_ns`, `stroke`; fixes are a
    MultiPoint. Coordinates are longitude, latitude [deg], WGS 84, and the height [m] if it is known.

    Raises:
        ReplayError: the log has no origin, the file exists, or it cannot be written.
    """
    log = comparison.log
    check_formats(("geojson",), log)
    assert log.origin is not None  # noqa: S101 - checked above
    features = [
        _line_feature(name, run.trajectory.pose_series, log.origin, colour_of(name))
        for name, run in comparison.runs.items()
    ]
    if log.truth is not None:
        features.append(_line_feature("ground_truth", log.truth.poses, log.origin, TRUTH_COLOUR))
    if log.fixes is not None and len(log.fixes.stamps):
        points = _coordinates(log.fixes.poses[:, :2], log.origin)
        properties = {"name": "fixes", "marker-color": FIX_COLOUR}
        features.append(_feature("MultiPoint", points, properties))
    text = json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False)
    return write_text(path, text + "\n")


def _line_feature(name: str, series: PoseSeries, origin: Origin, colour: str) -> dict[str, Any]:
    """Path as a LineString of at most `RATE` points a second."""
    rows = thinned(series.stamps, RATE)
    points = _coordinates(series.poses[rows, :2], origin)
    if series.spatial is not None:
        _latitude, _longitude, altitude = origin
        heights = np.round(altitude + series.spatial[rows, 0], HEIGHT_DECIMALS).tolist()
        points = [[*point, height] for point, height in zip(points, heights, strict=True)]
    if len(points) == 1:
        points *= 2  # a LineString has two positions or more
    times = {"start_ns": int(series.stamps[0]), "end_ns": int(series.stamps[-1])}
    return _feature("LineString", points, {"name": name, **times, "stroke": colour})


def _coordinates(positions: Floats, origin: Origin) -> list[list[float]]:
    """Longitude and latitude [deg], as GeoJSON has them, of positions (n, 2) [m]."""
    latitudes, longitudes = degrees(positions, origin).T
    points: list[list[float]] = np.round([longitudes, latitudes], DECIMALS).T.tolist()
    return points


def _feature(kind: str, points: list[list[float]], properties: dict[str, Any]) -> dict[str, Any]:
    """GeoJSON feature with a geometry of a kind, such as "LineString"."""
    geometry = {"type": kind, "coordinates": points}
    return {"type": "Feature", "properties": properties, "geometry": geometry}
