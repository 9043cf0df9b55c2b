"""Selection of the fixes of a replay: logged ones in a part, or from the truth."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix, PoseFix
from icreckon.estimator.log.scores import without_fixes
from icreckon.estimator.log.series import FixSeries, PoseSeries, Truth, rows_of
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.reading.conversions import fit_for_truth

OF_FIXES = "fixes that were not used"  # source of a truth made of unused fixes
TRUTH_FIX_PERIOD = 1.0  # period of fixes from a truth [s]
TRUTH_FIX_SIGMA = (0.05, 0.02)  # their standard deviations [m, rad]
SCORED_OUTAGE = 15.0  # shortest gap between fixes that is scored as dead reckoning [s]


class Bound(NamedTuple):
    """A time in a log."""

    value: float  # seconds since the log's start, or a share of its duration [-]
    is_share: bool  # True for a share

    def stamp(self, log: Log) -> int:
        """Convert to a stamp [ns] of a log."""
        seconds = self.value * log.duration if self.is_share else self.value
        return log.start + round(seconds / NANOSECOND)


class LogPart(NamedTuple):
    """A part of a log; `parse_part` makes one of a text such as "0:40%"."""

    start: Bound
    end: Bound


def parse_part(text: str) -> LogPart:
    """Parse a part of a log: «0:40%» (a share) or «12:90» (seconds since its start).

    Raises:
        ReplayError: the text is not a part.
    """
    try:
        first, last = text.split(":")
        return LogPart(_bound(first), _bound(last))
    except ValueError:
        raise ReplayError(
            f"{text!r} is no part of a log; give seconds (12:90) or shares of it (0:40%)"
        ) from None


def _bound(word: str) -> Bound:
    """Time of a text such as "12" or "40%"; a ValueError if it is none."""
    is_share = word.endswith("%")
    value = float(word[:-1]) / 100.0 if is_share else float(word)
    if not 0.0 <= value < float("inf"):
        raise ValueError(word)
    return Bound(value, is_share)


def with_truth_of_fixes(log: Log) -> Log:
    """Use at least two fixes as the truth, too, of a log without one."""
    fixes = log.fixes
    if log.truth is not None or fixes is None or len(fixes.stamps) < 2:
        return log
    headings = bool(np.isfinite(fixes.poses[:, 2]).all())
    fits = fit_for_truth(fixes.variances[:, 0])
    places = PoseSeries(fixes.stamps[fits], fixes.poses[fits])
    truth = Truth(places, None, None, OF_FIXES, headings)
    return replace(log, truth=truth)


def with_fixes_within(log: Log, part: LogPart) -> Log:
    """Restrict a log's fixes to a part of it; take them from the truth if it has none.

    Other measurements of heading or pose are restricted, too.

    Raises:
        ReplayError: the part is empty, or the log has neither fixes nor truth.
    """
    start, end = part.start.stamp(log), part.end.stamp(log)
    if not start < end:
        raise ReplayError("the interval for fixes is empty")
    fixes = log.fixes if log.fixes is not None else _fixes_from_truth(log)
    inside = (fixes.stamps >= start) & (fixes.stamps <= end)
    if not inside.any():
        first, last = ((fixes.stamps[[0, -1]] - log.start) * NANOSECOND).tolist()
        raise ReplayError(
            f"the interval for fixes has none of the log's {len(inside)} fixes, "
            f"which are from {first:.0f} to {last:.0f} s of {log.duration:.0f} s"
        )
    others = [
        measurement
        for measurement in log.others
        if not isinstance(measurement, HeadingFix | PoseFix) or start <= measurement.stamp <= end
    ]
    return replace(log, fixes=rows_of(fixes, inside), others=tuple(others))


def scored_intervals(log: Log) -> list[tuple[int, int]]:
    """Intervals of scored drift: a whole log without fixes, else its long outages."""
    if log.fixes is None or len(log.fixes.stamps) == 0:
        return [(log.start, log.end)]
    return without_fixes(log.fixes.stamps, log.start, log.end, SCORED_OUTAGE)


def _fixes_from_truth(log: Log) -> FixSeries:
    """Make fixes of the truth, one each `TRUTH_FIX_PERIOD`, without added noise."""
    if log.truth is None:
        raise ReplayError(
            f"{log.name}: neither fixes nor a truth to take them from; if the log has some, [log.fixes] "
            "in the robot file must name their topic (icreckon inspect shows it)"
        )
    poses = log.truth.poses
    period = int(TRUTH_FIX_PERIOD / NANOSECOND)
    # The first pose of each period.
    _, rows = np.unique((poses.stamps - poses.stamps[0]) // period, return_index=True)
    variances, fix_poses = np.tile(np.square(TRUTH_FIX_SIGMA), (len(rows), 1)), poses.poses[rows]
    if not log.truth.headings:
        fix_poses[:, 2] = np.nan
    return FixSeries(poses.stamps[rows], fix_poses, variances)
