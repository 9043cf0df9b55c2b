"""Updates with fixes in traced numbers, as in `icreckon.estimator.filter.ekf`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

from icreckon.estimator.base import state as s
from icreckon.estimator.engine.covariance import Vector, combined, dot, shift_of
from icreckon.estimator.engine.lane import FilterShape, Lane, Numbers
from icreckon.estimator.engine.layout import FACTORS, PLACE, TREND
from icreckon.estimator.engine.model import (
    departure_after,
    lasting_slip,
    normalised,
    patience_for,
    present_factor_after,
    slip_factor_after,
    trend_after,
    turn,
)
from icreckon.estimator.engine.step import PredictedPose, Step, StepKind
from icreckon.estimator.faults.departing_fixes import Departure, errors_by_cause
from icreckon.estimator.filter.ekf import LEAST_VARIANCE
from icreckon.estimator.filter.filter_record import DEPARTURE
from icreckon.estimator.filter.gate import LARGEST_INFLATION
from icreckon.estimator.filter.slip_factor import LARGEST_FACTOR
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.kernel import Kernel
from icreckon.estimator.tracing.trace import maximum, minimum, select


class FixKind(NamedTuple):
    """Kind of a fix, on which the code of its kernel depends."""

    fast_slip: bool = False  # the fast slip of the newest step is still a state
    twist: bool = False  # compute the body velocity after it
    ahead: bool = False  # it lies between the end of the last step and that of the next
    updated: bool = True  # compute the place of the antenna after it


def position_kernel(
    name: str, shape: FilterShape, kind: FixKind, numbers: Numbers | None = None
) -> Kernel:
    """Make the kernel of a position fix; see `Reckoning._take_fix`.

    The kernel returns two flags: lanes whose filter is lost, for the caller to relocate, and lanes that
    used the fix. For `numbers` see `Lane`.
    """
    lane = Lane(shape, numbers, with_fast_slip=kind.fast_slip)
    x, P = lane.x, lane.P
    variance, mode = lane.input("fix_variance"), lane.input("fix_mode")
    predicted, rows, covariance = _antenna(lane, _predicted(lane, kind))
    values = list(predicted)  # with the wander of the fixes
    if s.WANDER_X in shape.states:
        for axis, wander in ((s.X, s.WANDER_X), (s.Y, s.WANDER_Y)):
            values[axis], rows[axis][wander] = values[axis] + x[wander], 1.0
    before = x.copy()
    fix = lane.input("fix_x"), lane.input("fix_y")
    z = z_x, z_y = fix[0] - values[s.X], fix[1] - values[s.Y]
    R = [maximum(variance + covariance[axis][axis], LEAST_VARIANCE) for axis in (s.X, s.Y)]
    smooth = lane.input("smooth_left"), lane.input("smooth_right")
    interval, heading = lane.input("fix_interval"), turn(values[s.YAW])

    def innovation_spread() -> tuple[Any, Any, Any, Any]:
        """Innovation covariance xx, xy, yy, and normalised innovation squared."""
        with_x, with_y = P.times(rows[s.X]), P.times(rows[s.Y])
        xx = dot(with_x, rows[s.X]) + R[s.X]
        xy = dot(with_x, rows[s.Y]) + covariance[s.X][s.Y]
        yy = dot(with_y, rows[s.Y]) + R[s.Y]
        by_x, by_y = z_x * yy - z_y * xy, z_y * xx - z_x * xy
        return xx, xy, yy, (z_x * by_x + z_y * by_y) / (xx * yy - xy * xy)

    # Modes of a fix (`gate`): 0 skipped, 1 gated, 2 forced.
    is_tried, is_forced = mode > 0.5, mode > 1.5
    judged = is_tried & (mode < 1.5)

    def inflate(states: Sequence[int], error: Sequence[Any], only: Any) -> None:
        """Inflate by an error that moves several states, in some lanes."""
        moved = [select(only, part, 0.0) for part in error[: len(states)]]
        P.add_error(dict(zip(states, moved, strict=True)))
        products = [a * b for a, b in combinations_with_replacement(moved, 2)]
        lane.report("motion", products, states)

    inflate((s.X, s.Y, s.SLIP_X), lasting_slip(x[s.SLIP_X], heading, interval), judged)
    # A fix that the gate would reject may depart from the path, which makes the states uncertain.
    *S, nis = innovation_spread()
    is_off = judged & ~(nis <= lane.constant("position_threshold"))
    earlier = Departure(*(lane.row(name) for name in DEPARTURE))
    fastest, gauge = lane.constant("fastest"), lane.constant("gauge")
    departure, is_followed, indicated = departure_after(
        earlier, fix, z, tuple(S), heading, fastest, gauge, interval
    )
    departs = is_off & is_followed
    for states, error in errors_by_cause(indicated):
        # A considered bias, the last state of an error, is not inflated.
        inflate(states[: len(states) - (states[-1] in shape.considered)], error, departs)
    # Gate: admit or reject. After some time a forced fix is re-acquired; a gated one marks a lost lane.
    xx, xy, yy, nis = innovation_spread()
    admitted = nis <= lane.constant("position_threshold")
    square = z_x * z_x + z_y * z_y
    patience = patience_for(square, lane.constant("patience"), fastest)
    patience_ends = lane.row("position_rejected_for") >= patience
    reacquires = ~admitted & patience_ends
    lost, reacquired = judged & reacquires, is_forced & reacquires
    tested = is_tried & ~lost
    used = tested & (admitted | reacquired)
    at_fix, at_path = Departure(0.0, *fix, *z), Departure(0.0, values[s.X], values[s.Y], *z)
    choices = zip(DEPARTURE, at_fix, departure, at_path, earlier, strict=True)
    for row, if_used, if_off, otherwise, old in choices:
        after = select(used | lost, if_used, select(is_off, if_off, otherwise))
        lane.stores[row] = select(judged | used, after, old)
    # Update with both coordinates, one after the other.
    added = select(reacquired, minimum(square, LARGEST_INFLATION * minimum(xx, yy)), 0.0)
    for axis in (s.X, s.Y):
        P.add_error({axis: 1.0}, added)
        lane.report("inflated", (added,), (axis,))
    for axis in (s.X, s.Y):
        residual = z[axis] - shift_of(rows[axis], x, before)
        lane.update(residual, rows[axis], R[axis], fixed=shape.considered, only=used)
    lane.cover_rounding(after_fix=True)
    lane.keep_inside_bounds()
    lane.count("position", nis, admitted, admitted | reacquired, tested, interval)
    # Factors on the slip: innovations to the same side increase them, a departure sets the largest.
    slip_factor, present_factor = (
        select(departs, LARGEST_FACTOR, lane.row(name)) for name in FACTORS
    )
    forward, left, size = (lane.row(name) for name in TREND)
    innovation_forward, innovation_left = normalised(z, (xx, xy, yy), heading)
    trend = trend_after((forward, left, size), innovation_forward, innovation_left)
    present_after = present_factor_after(present_factor, trend, *smooth)
    counts = tested & admitted
    slip_after = slip_factor_after(slip_factor, present_after, *smooth)
    lane.stores["slip_factor"] = select(counts, slip_after, slip_factor)
    lane.stores["present_factor"] = select(counts, present_after, present_factor)
    for row, value_before, value_after in zip(TREND, (forward, left, size), trend, strict=True):
        lane.stores[row] = select(counts, value_after, value_before)
    # Outputs: places of the antenna, and the innovation.
    places = {"predicted": predicted}
    if kind.updated:
        places["updated"] = _antenna(lane, _predicted(lane, kind)).values
    for when, place in places.items():
        lane.stores |= {f"{when}_{axis}": value for axis, value in zip(PLACE, place, strict=True)}
    innovation = {"z_x": z_x, "z_y": z_y, "S_xx": xx, "S_xy": xy, "S_yy": yy}
    for part, value in innovation.items():
        lane.stores[f"position_{part}"] = select(is_tried, value, lane.row(f"position_{part}"))
    return _finished(lane, name, (lost, used), kind)


def heading_kernel(name: str, shape: FilterShape, kind: FixKind) -> Kernel:
    """Make the kernel of a heading fix; see `Reckoning._take_fix`."""
    lane = Lane(shape, with_fast_slip=kind.fast_slip, innovations=True)
    values, rows, covariance = _predicted(lane, kind)
    unwrapped = lane.input("fix_yaw") - values[s.YAW]
    lane.gated(
        "heading",
        unwrapped - 2.0 * math.pi * trace.rounded(unwrapped * (0.5 / math.pi)),
        rows[s.YAW],
        maximum(lane.input("yaw_variance") + covariance[s.YAW][s.YAW], LEAST_VARIANCE),
        inflated=s.YAW,
        fixed=shape.considered,
        patience=lane.constant("patience"),
        interval=lane.input("heading_interval"),
    )
    lane.cover_rounding(after_fix=True)
    lane.keep_inside_bounds()
    return _finished(lane, name, (), kind)


def _predicted(lane: Lane, kind: FixKind) -> PredictedPose:
    """Pose at the fix: that of the state, or a prediction if the fix lies ahead."""
    if kind.ahead:
        # The fast slip of the step before does not go on.
        before, lane.x = lane.x, lane.x.copy()
        lane.x[s.FAST_SLIP] = 0.0
        pose = Step(lane, StepKind(draws=False, moves=False, imu=False)).predict_pose()
        lane.x = before
        return pose
    rows: list[Vector] = [{axis: 1.0} for axis in range(3)]
    return PredictedPose([lane.x[axis] for axis in range(3)], rows, [[0.0] * 3] * 3)


def _antenna(lane: Lane, pose: PredictedPose) -> PredictedPose:
    """Predicted position of the antenna and yaw, see `predictions.point_on_robot`."""
    values, (x_row, y_row, yaw_row), covariance = pose
    forward, left = lane.input("fix_forward"), lane.input("fix_left")
    cos, sin = turn(values[s.YAW])
    ahead, beside = cos * forward - sin * left, sin * forward + cos * left
    rows = [combined(x_row, (-beside, yaw_row)), combined(y_row, (ahead, yaw_row)), yaw_row]
    by_pose = [{s.X: 1.0, s.YAW: -beside}, {s.Y: 1.0, s.YAW: ahead}, {s.YAW: 1.0}]
    # J C J' of the pose's covariance C, one row of J after another.
    with_pose = [[dot(by, dict(enumerate(row))) for row in covariance] for by in by_pose]
    antenna_covariance = [[dot(a, dict(enumerate(row))) for row in with_pose] for a in by_pose]
    place = [values[s.X] + ahead, values[s.Y] + beside, values[s.YAW]]
    return PredictedPose(place, rows, antenna_covariance)


def _finished(lane: Lane, name: str, flags: Sequence[Any], kind: FixKind) -> Kernel:
    """Make the kernel of a lane after a fix, with the twist if the kind has it."""
    if kind.twist:
        lane.store_twist()
    return lane.kernel(name, flags, with_fast_slip=kind.fast_slip)
