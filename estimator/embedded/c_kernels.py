"""Kernels of a filter in C that the filter in Python has in other forms."""

from __future__ import annotations

from icreckon.estimator.base import state as s
from icreckon.estimator.engine import model
from icreckon.estimator.engine.lane import FilterShape, Lane
from icreckon.estimator.engine.layout import MOTION
from icreckon.estimator.tracing.kernel import Kernel


def first_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of the first track speeds: a moving robot may slip already."""
    lane = Lane(shape)
    slip = model.SlipConstants(*(lane.constant(field) for field in model.SlipConstants._fields))
    smooth, factor = (
        (lane.input("smooth_left"), lane.input("smooth_right")),
        lane.row("slip_factor"),
    )
    sigmas = model.slip_at(*smooth, slip, lane.constant("gauge"), lane.eta, False, factor)
    for state, sigma in zip((s.SLIP_X, s.SLIP_Y, s.SLIP_W), sigmas, strict=True):
        lane.P.add(state, state, sigma * sigma)
    return lane.kernel(name)


def motion_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of a body velocity with its covariance and indices."""
    lane = Lane(shape, with_fast_slip=True)
    now = lane.twist_model(lane.input("left"), lane.input("right"))
    lane.stores.update(zip(MOTION, now.motion.indices, strict=False))
    lane.store_twist(lane.with_smoothed_derivatives(now))
    return lane.kernel(name, with_fast_slip=True)


def derivatives_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of the regressors before the first step, not smoothed."""
    lane = Lane(shape, with_fast_slip=True)
    for axis, row in enumerate(lane.twist_model(lane.input("left"), lane.input("right")).rows):
        lane.stores |= {f"r{axis}_{i}": row[i] for i in lane.layout.parameters if i in row}
    return lane.kernel(name, with_fast_slip=True)
