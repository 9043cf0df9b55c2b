"""Conversion of track sensor units (rates, angles, counts, ...) to track speeds."""

import math
from typing import Literal, get_args

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps

SpeedUnit = Literal["rad/s", "deg/s", "rpm", "turns/s", "m/s", "mm/s", "km/h"]
CounterUnit = Literal["rad", "deg", "turns", "counts", "m", "mm"]
TrackUnit = Literal[SpeedUnit, CounterUnit]
COUNTER_UNITS: set[TrackUnit] = {*get_args(CounterUnit)}

OF_SPROCKET = {"rad": 1.0, "deg": math.pi / 180.0, "turns": math.tau, "rpm": math.tau / 60.0}
"""Angles of the sprocket in rad, and so rates in rad/s; rpm in rad/s. Counts depend on the encoder."""
OF_GROUND = {"m/s": 1.0, "mm/s": 1e-3, "km/h": 1.0 / 3.6, "m": 1.0, "mm": 1e-3}
"""Speeds and distances of the track in m/s and m."""
ANY_COUNTS = 1.0  # counts of a turn with which counters are read until a person fills them in
LONGEST_DIFFERENCE = 1.0  # longest interval between two samples of a counter that gives a speed [s]
TOO_FAST = 10.0  # a counter that is faster than this many times the fastest track jumped [-]


def metres(unit: TrackUnit, sprocket_radius: float, counts_per_turn: float | None) -> float:
    """Factor from a unit to m/s, or to m for cumulative units."""
    if unit in OF_GROUND:
        return OF_GROUND[unit]
    of_count = 2.0 * math.pi / (counts_per_turn or ANY_COUNTS)
    return sprocket_radius * (
        of_count if unit == "counts" else OF_SPROCKET[unit.removesuffix("/s")]
    )


def counter_range(counts: Floats) -> tuple[float | None, float]:
    """Range of counters (n, k) that wrap at 16 or 32 bits, or None; span of readings."""
    columns = [column[np.isfinite(column)] for column in counts.T]
    step = max(float(np.abs(np.diff(column)).max(initial=0.0)) for column in columns)
    span = max(float(np.ptp(column)) if len(column) else 0.0 for column in columns)
    return next((size for size in (2.0**16, 2.0**32) if 0.5 * size < step < size), None), span


def differences(
    stamps: Stamps, distances: Floats, wrap: float | None, fastest: float
) -> tuple[Stamps, Floats, dict[str, int]]:
    """Mean speeds between the samples of counters, without gaps and jumps.

    Args:
        stamps: (n,) [ns], rising.
        distances: (n, k) readings of the counters [m].
        wrap: range of the counters [m], or None.
        fastest: highest speed of a track [m/s].

    Returns:
        (m,) stamps of the later of two samples, (m, k) speeds [m/s], and numbers of omitted ones, by
        reason.
    """
    seconds = np.diff(stamps) * NANOSECOND
    steps = np.diff(distances, axis=0)
    if wrap is not None:
        steps = (steps + 0.5 * wrap) % wrap - 0.5 * wrap
    speeds = steps / seconds[:, None]
    apart = seconds > LONGEST_DIFFERENCE
    jumps = (np.abs(speeds) > TOO_FAST * fastest).any(axis=1) & ~apart
    lost = {
        f"counter not read for {LONGEST_DIFFERENCE:g} s": int(apart.sum()),
        "counter jumps": int(jumps.sum()),
    }
    keep, omitted = ~apart & ~jumps, {reason: count for reason, count in lost.items() if count}
    return stamps[1:][keep], speeds[keep], omitted
