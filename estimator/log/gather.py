"""Conversion of single measurements to series."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.input_checks import STREAMS, Admission, Key, key_of
from icreckon.estimator.log.measurements import (
    HeadingFix,
    ImuSample,
    Measurement,
    PositionFix,
    TrackSpeeds,
)
from icreckon.estimator.log.series import FixSeries, ImuSeries, TrackSpeedSeries

NO_LIMIT = 1e300  # no stamp and no speed is rejected here for being far from others


def gathered(measurements: Iterable[Measurement]) -> dict[str, Any]:
    """Sort measurements into the fields of a `Log`, by name.

    A heading fix at the stamp of a position fix belongs to it. What has no series is in `others`.
    """
    admission, dropped = Admission(0.0, NO_LIMIT), dict[str, int]()
    kept: dict[Key, Measurement] = {}
    for measurement, objection in map(admission.checked, measurements):
        key = key_of(measurement)
        reason = objection or ("duplicate stamp" if key in kept else None)
        if reason is None:
            kept[key] = measurement
        else:
            name = f"{STREAMS[type(measurement)]}: {reason}"
            dropped[name] = dropped.get(name, 0) + 1
    ordered = [kept[key] for key in sorted(kept)]
    tracks = [m for m in ordered if isinstance(m, TrackSpeeds)]
    samples = [m for m in ordered if isinstance(m, ImuSample)]
    positions = [m for m in ordered if isinstance(m, PositionFix)]
    stamps = {m.stamp for m in positions}
    headings = {m.stamp: m for m in ordered if isinstance(m, HeadingFix) and m.stamp in stamps}
    rest = [m for m in ordered if not isinstance(m, TrackSpeeds | ImuSample | PositionFix)]
    others = [m for m in rest if not (isinstance(m, HeadingFix) and m.stamp in headings)]
    return {
        "tracks": _tracks(tracks),
        "imu": _imu(samples) if samples else None,
        "fixes": _fixes(positions, headings) if positions else None,
        "dropped": dropped,
        "others": tuple(others),
    }


def _tracks(speeds: list[TrackSpeeds]) -> TrackSpeedSeries:
    """Series of track speeds; wheels are kept if all samples have as many."""
    stamps, means = _stamps(speeds), _array([(m.left, m.right) for m in speeds], 2)
    counts = {(len(m.left_wheels), len(m.right_wheels)) for m in speeds}
    if counts <= {(0, 0)}:
        return TrackSpeedSeries(stamps, means)
    if len(counts) > 1:
        raise EstimatorError(
            "track speeds of one log have as many wheels in each sample; found (left, right) "
            f"{', '.join(map(str, sorted(counts)))}"
        )
    ((left, right),) = counts  # the only one
    left_wheels = _array([m.left_wheels for m in speeds], left)
    return TrackSpeedSeries(
        stamps, means, left_wheels, _array([m.right_wheels for m in speeds], right)
    )


def _imu(samples: list[ImuSample]) -> ImuSeries:
    """Series of IMU samples; without forces if no sample has one."""
    forces: Floats | None = None
    if any(m.linear_acceleration is not None for m in samples):
        no_force = (np.nan, np.nan, np.nan)
        forces = _array([m.linear_acceleration or no_force for m in samples], 3)
    return ImuSeries(_stamps(samples), _array([m.angular_velocity for m in samples], 3), forces)


def _fixes(positions: list[PositionFix], headings: dict[int, HeadingFix]) -> FixSeries:
    """Series of fixes with the headings at their stamps; NaN for a fix without one."""
    no_heading = HeadingFix(0, np.nan, np.nan)
    antennas = _array([(m.forward, m.left) for m in positions], 2)
    pairs = [(m, headings.get(m.stamp, no_heading)) for m in positions]
    return FixSeries(
        _stamps(positions),
        _array([(m.x, m.y, heading.yaw) for m, heading in pairs], 3),
        _array([(m.variance, heading.variance) for m, heading in pairs], 2),
        antennas if antennas.any() else None,
    )


def _stamps(measurements: list[Any]) -> Stamps:
    return np.array([m.stamp for m in measurements], dtype=np.int64)


def _array(rows: list[Any], width: int) -> Floats:
    return np.array(rows, dtype=float).reshape(-1, width)
