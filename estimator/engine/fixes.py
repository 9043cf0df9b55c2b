"""Fixes at the end of a step, in traced numbers: gate and update of `estimator.filter.filter`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from icreckon.estimator.base import state as s
from icreckon.estimator.engine.covariance import dot
from icreckon.estimator.engine.lane import FilterShape, Lane
from icreckon.estimator.engine.step import Foretold, Step, StepKind, shift_of
from icreckon.estimator.filter.gate import LARGEST_REOPENING
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.emit import Kernel
from icreckon.estimator.tracing.trace import Traced, minimum, select

# How a fix is to be taken: not at all, as usual, or as true whatever it says.
NOT_AT_ALL, AS_USUAL, AS_TRUE = range(3)


class FixKind(NamedTuple):
    """What goes with a fix.

    Attributes:
        tells: whether the body velocity after it is wanted.
        ahead: whether it lies between the end of the last step and that of the next.
    """

    tells: bool = False
    ahead: bool = False


def position_kernel(name: str, shape: FilterShape, kind: FixKind) -> Kernel:
    """A position fix; see `Reckoning._take_fix`.

    The kernel returns in which lanes the filter is lost, which is for the caller to mend, and in which
    the fix was used.

    Args:
        name: of the kernel.
        shape: of the filter.
        kind: what goes with it.
    """
    lane = Lane(shape, with_fast_slip=kind.tells)
    x, P, told = lane.x, lane.P, lane.told
    variance, how = told("fix_variance"), told("how")
    values, rows, more_spread = _foretold(lane, kind)
    before = x.copy()
    residual = told("fix_x") - values[s.X], told("fix_y") - values[s.Y]
    of_x, of_y = P.times(rows[s.X]), P.times(rows[s.Y])
    xx = dot(of_x, rows[s.X]) + more_spread[s.X][s.X] + variance
    xy = dot(of_x, rows[s.Y]) + more_spread[s.X][s.Y]
    yy = dot(of_y, rows[s.Y]) + more_spread[s.Y][s.Y] + variance
    by_x, by_y = residual[0] * yy - residual[1] * xy, residual[1] * xx - residual[0] * xy
    nis = (residual[0] * by_x + residual[1] * by_y) / (xx * yy - xy * xy)
    admitted = nis <= lane.constant("position_threshold")
    gives_up = lane.row("position_row") >= lane.constant("patience")
    refused = ~admitted & gives_up
    lost = (how > 0.5) & refused & (how < 1.5)
    reacquired = refused & (how > 1.5)
    asked = (how > 0.5) & ~lost
    used = asked & (admitted | reacquired)
    square = residual[0] * residual[0] + residual[1] * residual[1]
    more = select(reacquired, minimum(square, LARGEST_REOPENING * minimum(xx, yy)), 0.0)
    P.add(s.X, s.X, more)
    P.add(s.Y, s.Y, more)
    for axis in (s.X, s.Y):
        left = residual[axis] - shift_of(rows[axis], x, before)
        spread = variance + more_spread[axis][axis]
        lane.update(left, rows[axis], spread, kept=shape.considered, only=used)
    lane.keep_inside_bounds()
    lane.count("position", nis, admitted, admitted | reacquired, asked)
    lane.stores.update(believed_x=values[s.X], believed_y=values[s.Y])
    judged = {"x": residual[0], "y": residual[1], "xx": xx, "xy": xy, "yy": yy}
    for part, value in judged.items():
        lane.stores[f"position_{part}"] = select(how > 0.5, value, lane.row(f"position_{part}"))
    return _finished(lane, name, (lost, used), kind)


def heading_kernel(name: str, shape: FilterShape, kind: FixKind) -> Kernel:
    """A heading fix; see `Reckoning._take_fix`.

    Args:
        name: of the kernel.
        shape: of the filter.
        kind: what goes with it.
    """
    lane = Lane(shape, with_fast_slip=kind.tells, judged=True)
    values, rows, more_spread = _foretold(lane, kind)
    turned = lane.told("fix_yaw") - values[s.YAW]
    lane.gated(
        "heading",
        turned - 2.0 * math.pi * trace.rounded(turned * (0.5 / math.pi)),
        rows[s.YAW],
        lane.told("yaw_variance") + more_spread[s.YAW][s.YAW],
        reopen=s.YAW,
        kept=shape.considered,
        only=lane.told("how") > 0.5,
    )
    lane.keep_inside_bounds()
    return _finished(lane, name, (), kind)


def _foretold(lane: Lane, kind: FixKind) -> Foretold:
    if kind.ahead:
        # The fast slip of the step before does not go on.
        before, lane.x = lane.x, lane.x.copy()
        lane.x[s.FAST_SLIP] = trace.lift(0.0)
        found = Step(lane, StepKind(moves=False, imu=False)).foretell_pose()
        lane.x = before
        return found
    rows = [{axis: trace.lift(1.0)} for axis in range(3)]
    return Foretold([lane.x[axis] for axis in range(3)], rows, [[0.0] * 3] * 3)


def _finished(lane: Lane, name: str, flags: Sequence[Traced], kind: FixKind) -> Kernel:
    if kind.tells:
        speeds = lane.told("now_left"), lane.told("now_right")
        now = lane.twist_model(1.0, *speeds, lane.row("u"))
        lane.store_twist(lane.with_kept_derivatives(now))
    return lane.kernel(name, flags, with_fast_slip=kind.tells)
