"""Checks of fixes: place of the antenna, offset of a heading."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.series import FixSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.check import SIGMAS, Check, Measured, imu_yaw_rates, mapped_table
from icreckon.replay.estimates.fix_wander import FixFit, fit_fixes
from icreckon.replay.estimates.wheels import heading_offset
from icreckon.replay.mapping.topics import topic_map

LEAST_OFFSET = 10.0  # a robot that slides in bends drives some degrees off its heading [deg]


def check_antenna(log: Log, robot: Robot) -> Iterator[Check]:
    """Place of the antenna of position fixes, and their latency, by odometry in bends."""
    fixes = log.fixes
    if fixes is None or log.imu is None:
        return
    places = np.unique(fixes.lever_arms, axis=0)
    name, in_file = "place of the antenna", "; ".join(map(_metres, places))
    fit = fit_fixes(log, imu_yaw_rates(log.imu, robot)) if len(places) == 1 else None
    if fit is None:
        if places.any():
            yield Check(name, in_file, "not seen: no three spans of 30 s with fixes and turns")
        return
    if fit.is_late:
        yield _latency(fixes, robot, fit)
    shift = float(np.hypot(*(fit.place - places[0, :2])))
    measured = Measured(shift, "m", 0.0, fit.sigma)
    check = Check(name, in_file, f"{_metres(fit.place)} ± {fit.sigma:.2g}", measured=measured)
    if not fit.differs(places[0, :2]):
        yield check
        return
    place = [*fit.place.round(2).tolist(), *places[0, 2:].tolist()]
    moved = replace(fixes, antennas=np.tile(place, (len(fixes.stamps), 1)))
    yield check.contradicted(
        f"the fixes are of a point {shift:.2f} m from the file's: with fixes, poses are as far off",
        f"position = {place} in [log.fixes]",
        lambda log, robot: (replace(log, fixes=moved), robot),
        {f"{mapped_table(robot, 'fixes')}.position": place},
    )


def _latency(fixes: FixSeries, robot: Robot, fit: FixFit) -> Check:
    """Contradiction of the latency of the fixes."""
    mapped, table = topic_map(robot).keys_of("fixes"), mapped_table(robot, "fixes")
    stated = 0.0 if mapped is None else mapped.latency
    in_time = replace(fixes, stamps=fixes.stamps - round(fit.lag / NANOSECOND))
    latency = stated + fit.lag
    measured = Measured(latency, "s", stated, fit.lag_sigma)
    in_log = f"{latency:.2f} ± {fit.lag_sigma:.1g} s"
    return Check("latency of the fixes", f"{stated:g} s", in_log, measured=measured).contradicted(
        f"the fixes are {abs(fit.lag):.2f} s {'late' if fit.lag > 0.0 else 'early'}",
        f"latency = {latency:.2f} in [{table}]",
        lambda log, robot: (replace(log, fixes=in_time), robot),
        {f"{table}.latency": round(latency, 2)},
    )


def _metres(place: Floats) -> str:
    """Text of a place, forward and left [m], without -0.00."""
    return f"{place[0] + 0.0:.2f}, {place[1] + 0.0:.2f} m"


def check_heading(log: Log, robot: Robot) -> Iterator[Check]:
    """Offset of a heading from the direction of driving, by fixes or truth."""
    mapped, measured_offset = topic_map(robot).keys_of("heading"), heading_offset(log)
    if mapped is None:
        return
    name, in_file = "offset of the heading", f"{mapped.offset_deg:g} deg"
    if measured_offset is None:
        yield Check(name, in_file, "not seen: no clear courses by fixes, no truth with headings")
        return
    # `read_log` has added the offset of the file to the headings.
    remaining, sigma, change, change_sigma = measured_offset
    offset = math.degrees(wrap_angle(math.radians(mapped.offset_deg + remaining)))
    check = Check(
        name,
        in_file,
        f"{offset:.1f} ± {sigma:.1g} deg, by the {'truth' if log.fixes is None else 'fixes'}",
        measured=Measured(offset, "deg", mapped.offset_deg, sigma),
    )
    if abs(change) > max(LEAST_OFFSET, SIGMAS * change_sigma):
        others = tuple(other for other in log.others if not isinstance(other, HeadingFix))
        yield check.contradicted(
            f"the headings turn by {abs(change):.0f} ± {change_sigma:.1g} deg against the "
            "direction of driving over the log",
            "leave [log.heading] out, or look what turns it: iron, currents, a lost antenna",
            lambda log, robot: (replace(log, others=others), robot),
        )
        return
    if abs(remaining) < max(LEAST_OFFSET, SIGMAS * sigma):
        yield check
        return

    def turned(log: Log, robot: Robot) -> tuple[Log, Robot]:
        """Correction of the headings."""
        others = list(log.others)
        for k, other in enumerate(others):
            if isinstance(other, HeadingFix):
                others[k] = replace(other, yaw=wrap_angle(other.yaw + math.radians(remaining)))
        return replace(log, others=tuple(others)), robot

    side = "right" if remaining > 0.0 else "left"
    yield check.contradicted(
        f"the headings are {abs(remaining):.0f} deg {side} of the direction of driving",
        f"offset_deg = {offset:.1f} in [log.heading]",
        turned,
        {f"{mapped_table(robot, 'heading')}.offset_deg": round(offset, 1)},
    )
