"""Checks of fixes: place of the antenna, offset of a heading."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.check import SIGMAS, Check, Measured, in_base, mapped_table
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
    vertical, _ = in_base(log.imu, robot)
    found = fit_fixes(log, vertical) if len(places) == 1 else None
    if found is None:
        if places.any():
            yield Check(name, in_file, "not seen: no three spans of 30 s with fixes and turns")
        return
    if found.is_late:
        yield _latency(log, robot, found)
    place, shift = found.place, float(np.hypot(*(found.place - places[0, :2])))
    measured = Measured(shift, "m", 0.0, found.sigma)
    check = Check(name, in_file, f"{_metres(place)} ± {found.sigma:.2g}", measured=measured)
    if not found.differs(places[0, :2]):
        yield check
        return
    whole = [*place.round(2).tolist(), *places[0, 2:].tolist()]
    moved = replace(fixes, antennas=np.tile(whole, (len(fixes.stamps), 1)))
    yield check.contradicted(
        f"the fixes are of a point {shift:.2f} m from the file's: with fixes, poses are as far off",
        f"position = {whole} in [log.fixes]",
        lambda log, robot: (replace(log, fixes=moved), robot),
        {f"{mapped_table(robot, 'fixes')}.position": whole},
    )


def _latency(log: Log, robot: Robot, found: FixFit) -> Check:
    """Contradiction of the latency of the fixes."""
    mapped, fixes = topic_map(robot).keys_of("fixes"), log.fixes
    stated = 0.0 if mapped is None else mapped.latency
    assert fixes is not None  # noqa: S101 - checked by the caller
    in_time = replace(fixes, stamps=fixes.stamps - round(found.lag / NANOSECOND))
    latency = stated + found.lag
    measured = Measured(latency, "s", stated, found.lag_sigma)
    in_log = f"{latency:.2f} ± {found.lag_sigma:.1g} s"
    table = mapped_table(robot, "fixes")
    return Check("latency of the fixes", f"{stated:g} s", in_log, measured=measured).contradicted(
        f"the fixes are {abs(found.lag):.2f} s {'late' if found.lag > 0.0 else 'early'}",
        f"latency = {latency:.2f} in [{table}]",
        lambda log, robot: (replace(log, fixes=in_time), robot),
        {f"{table}.latency": round(latency, 2)},
    )


def _metres(place: Floats) -> str:
    return f"{place[0] + 0.0:.2f}, {place[1] + 0.0:.2f} m"


def check_heading(log: Log, robot: Robot) -> Iterator[Check]:
    """Offset of a heading from the direction of driving, by fixes or truth."""
    mapped, found = topic_map(robot).keys_of("heading"), heading_offset(log)
    if mapped is None:
        return
    name, in_file = "offset of the heading", f"{mapped.offset_deg:g} deg"
    if found is None:
        yield Check(name, in_file, "not seen: no clear courses by fixes, no truth with headings")
        return
    # `read_log` has added the offset of the file to the headings.
    left, sigma = found.value, found.sigma
    offset = math.degrees(wrap_angle(math.radians(mapped.offset_deg + left)))
    check = Check(
        name,
        in_file,
        f"{offset:.1f} ± {sigma:.1g} deg, by the {'truth' if log.fixes is None else 'fixes'}",
        measured=Measured(offset, "deg", mapped.offset_deg, sigma),
    )
    if abs(found.change) > max(LEAST_OFFSET, SIGMAS * found.change_sigma):
        others = tuple(other for other in log.others if not isinstance(other, HeadingFix))
        yield check.contradicted(
            f"the headings turn by {abs(found.change):.0f} ± {found.change_sigma:.1g} deg against the "
            "direction of driving over the log",
            "leave [log.heading] out, or look what turns it: iron, currents, a lost antenna",
            lambda log, robot: (replace(log, others=others), robot),
        )
        return
    if abs(left) < max(LEAST_OFFSET, SIGMAS * sigma):
        yield check
        return

    def turned(log: Log, robot: Robot) -> tuple[Log, Robot]:
        """Correction of the headings."""
        others = list(log.others)
        for k, other in enumerate(others):
            if isinstance(other, HeadingFix):
                others[k] = replace(other, yaw=wrap_angle(other.yaw + math.radians(left)))
        return replace(log, others=tuple(others)), robot

    side = "right" if left > 0.0 else "left"
    yield check.contradicted(
        f"the headings are {abs(left):.0f} deg {side} of the direction of driving",
        f"offset_deg = {offset:.1f} in [log.heading]",
        turned,
        {f"{mapped_table(robot, 'heading')}.offset_deg": round(offset, 1)},
    )
