"""Fixes at the end of a step, in traced numbers: what `estimator.reckoning` does with them, for many."""

from __future__ import annotations

import math
from collections.abc import Sequence

from estimator import state as s
from estimator.batch import trace
from estimator.batch.emit import Kernel
from estimator.batch.lane import FilterShape, Lane
from estimator.batch.trace import Traced, minimum, select
from estimator.gating import LARGEST_REOPENING

# How a fix is to be taken: not at all, as usual, or as true whatever it says.
NOT_AT_ALL, AS_USUAL, AS_TRUE = range(3)


def position_kernel(name: str, shape: FilterShape, *, tells: bool) -> Kernel:
    """A position fix; see `Reckoning._take_position`.

    The kernel returns in which lanes the filter is lost, which is for the caller to mend, and in which
    the fix was used.

    Args:
        name: of the kernel.
        shape: of the filter.
        tells: whether the body velocity is wanted.
    """
    lane = Lane(shape, with_fast_slip=tells)
    x, P, told = lane.x, lane.P, lane.told
    variance, how = told("fix_variance"), told("how")
    residual = told("fix_x") - x[s.X], told("fix_y") - x[s.Y]
    xx, xy, yy = P.entry(s.X, s.X) + variance, P.entry(s.X, s.Y), P.entry(s.Y, s.Y) + variance
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
    for axis, measured in ((s.X, "fix_x"), (s.Y, "fix_y")):
        lane.update(told(measured) - x[axis], {axis: trace.lift(1.0)}, variance, only=used)
    lane.keep_inside_bounds()
    lane.count("position", nis, admitted, admitted | reacquired, asked)
    return _finished(lane, name, (lost, used), tells=tells)


def heading_kernel(name: str, shape: FilterShape, *, tells: bool) -> Kernel:
    """A heading fix; see `Reckoning._take_heading`.

    Args:
        name: of the kernel.
        shape: of the filter.
        tells: whether the body velocity is wanted.
    """
    lane = Lane(shape, with_fast_slip=tells)
    turned = lane.told("fix_yaw") - lane.x[s.YAW]
    residual = turned - 2.0 * math.pi * trace.rounded(turned * (0.5 / math.pi))
    lane.gated(
        "heading",
        residual,
        {s.YAW: trace.lift(1.0)},
        lane.told("yaw_variance"),
        reopen=s.YAW,
        only=lane.told("how") > 0.5,
    )
    lane.keep_inside_bounds()
    return _finished(lane, name, (), tells=tells)


def _finished(lane: Lane, name: str, flags: Sequence[Traced], *, tells: bool) -> Kernel:
    if tells:
        speeds = lane.told("now_left"), lane.told("now_right")
        now = lane.twist_model(1.0, *speeds, lane.row("u"))
        for axis, row in enumerate(now.rows):
            row.update({i: lane.row(f"r{axis}_{i}") for i in lane.layout.parameters if i in row})
        lane.tell_twist(now)
    return lane.kernel(name, flags, with_fast_slip=tells)
