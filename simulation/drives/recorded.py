"""Trajectory from recorded track speeds: a CSV file, or a log in memory."""

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.drives.smooth_speeds import STANDSTILL, blend_duration

COLUMNS = ("t", "left", "right")
# A longer recording has its times in another unit than seconds [s].
LONGEST_RECORDING = 1e6
FINAL_REST = 1.0  # [s]


@dataclass(frozen=True)
class Recorded:
    """Track speeds through given points by monotone cubics (Fritsch and Butland).

    Speed and acceleration are continuous, and between two points no speed leaves their range. Before
    the first point and after the last one, the speeds are constant.
    """

    times: Floats  # (k,) ascending [s]
    speeds: Floats  # (k, 2) left, right [m/s]

    def __call__(self, times: Floats) -> Floats:
        """Track speeds (n, 2) [m/s] at times (n,) [s]."""
        return np.asarray(self._curve(np.clip(times, self.times[0], self.times[-1])))

    @property
    def top_speed(self) -> float:
        """Highest speed of a track, forward or backward [m/s]."""
        return float(np.abs(self.speeds).max())

    @cached_property
    def _curve(self) -> Any:
        from scipy.interpolate import PchipInterpolator

        # A slope too flat for its reciprocal is level.
        with np.errstate(over="ignore"):
            return PchipInterpolator(self.times, self.speeds)


def recorded(
    series: TrackSpeedSeries, *, factor: Annotated[float, msgspec.Meta(gt=0.0)] = 1.0
) -> Recorded:
    """Commands of a recording: standstill, ramp up, the recording, ramp to standstill.

    The first standstill lasts for `STANDSTILL`, the last one for `FINAL_REST` [s]; a factor multiplies
    the speeds of the recording.

    Raises:
        SimulationError: fewer than two samples, a number that is not finite, times that do not rise,
            or times that span more than `LONGEST_RECORDING`.
    """
    times = np.asarray(series.stamps * NANOSECOND)
    _check_samples(times, series.speeds, "the recorded track speeds")
    elapsed_s = (series.stamps - series.stamps[0]) * NANOSECOND
    speeds = factor * series.speeds
    start = STANDSTILL + blend_duration(np.abs(speeds[0]).max())
    end = start + elapsed_s[-1] + blend_duration(np.abs(speeds[-1]).max())
    rest = np.zeros((2, 2))
    return Recorded(
        np.concatenate([[0.0, STANDSTILL], start + elapsed_s, [end, end + FINAL_REST]]),
        np.concatenate([rest, speeds, rest]),
    )


def read_recording(path: Path) -> TrackSpeedSeries:
    """Read recorded track speeds from a CSV file with columns t, left and right.

    The first line holds the column names. t is in seconds from any start, left and right are in m/s,
    forward positive; other columns are ignored.

    Raises:
        SimulationError: no such file, no text, a missing or repeated column, a cell that is not a
            finite number, times that do not rise or are not in seconds, or fewer than two samples.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [row for row in csv.reader(file) if row]
    except FileNotFoundError:
        raise SimulationError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise SimulationError(f"{path}: is a folder; give the CSV file itself") from None
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise SimulationError(f"{path}: cannot be read as CSV: {problem}") from None
    if not rows:
        raise SimulationError(f"{path}: is empty; it needs the columns {', '.join(COLUMNS)}")
    names = [name.strip() for name in rows[0]]
    if len(names) == 1 and ";" in names[0]:
        raise SimulationError(f"{path}: has semicolons between its columns; write commas")
    for column in COLUMNS:
        if column not in names:
            raise SimulationError(
                f"{path}: no column {column!r} in its first line; found "
                f"{', '.join(map(repr, names))}{nearest_hint(column, names)}"
            )
        if names.count(column) > 1:
            raise SimulationError(f"{path}: has {names.count(column)} columns {column!r}; keep one")
    places = [names.index(column) for column in COLUMNS]
    numbers = []
    for number, row in enumerate(rows[1:], 1):
        where = f"{path}: row {number}"
        try:
            numbers.append([float(row[place]) for place in places])
        except IndexError:
            raise SimulationError(
                f"{where} has {len(row)} cells, fewer than the first line"
            ) from None
        except ValueError as problem:
            raise SimulationError(
                f"{where}: {problem}; t, left and right must be numbers"
            ) from None
    table = np.array(numbers).reshape(-1, len(COLUMNS))
    _check_samples(table[:, 0], table[:, 1:], str(path))
    stamps = np.rint((table[:, 0] - table[0, 0]) / NANOSECOND).astype(np.int64)
    return TrackSpeedSeries(stamps, table[:, 1:])


def _check_samples(times: Floats, speeds: Floats, source: str) -> None:
    """Reject times (n,) [s] and speeds (n, 2) [m/s] that cannot be a recording."""
    if len(times) < 2:
        raise SimulationError(f"{source}: a recording needs at least 2 samples, found {len(times)}")
    bad = ~(np.isfinite(times) & np.isfinite(speeds).all(axis=1))
    if bad.any():
        raise SimulationError(f"{source}: a number of row {bad.argmax() + 1} is not finite")
    if np.ptp(times) > LONGEST_RECORDING:
        raise SimulationError(
            f"{source}: t spans {np.ptp(times):.3g} s, {np.ptp(times) / 86400.0:.3g} days; is it in "
            "seconds?"
        )
    does_not_rise = np.diff(times) < NANOSECOND
    if does_not_rise.any():
        before = int(does_not_rise.argmax())
        raise SimulationError(
            f"{source}: t must rise from row to row, found {times[before]:.9g} s and then "
            f"{times[before + 1]:.9g} s in row {before + 2}; sort the rows or remove the duplicate"
        )
