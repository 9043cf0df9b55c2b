"""Kernels of a filter in C that the filter in Python has in other forms."""

from icreckon.estimator.base import state as s
from icreckon.estimator.engine import model
from icreckon.estimator.engine.lane import FAST, FilterShape, Lane, array_rows
from icreckon.estimator.engine.step import Step, StepKind
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.kernel import Kernel, Store

# Places of the indices and of the derivatives in what `motion_kernel` stores.
INDICES, DERIVATIVES = 9, 12


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
    """Make the kernel of a body velocity.

    It stores into an array: the twist (3,), the density of the fast slip (3, 3) above its diagonal, the
    indices (3,), and the derivatives (3, n) of the twist by all states, which are not smoothed.
    """
    lane = Lane(shape, with_fast_slip=True)
    now = lane.twist_model(lane.input("left"), lane.input("right"))
    density = Step(lane, StepKind(draws=False, moves=False, imu=False)).density(now)
    values = [*now.twist, *(density[i][j] for i in range(3) for j in range(i, 3))]
    values += now.motion.indices
    values += [row.get(i, 0.0) for row in now.rows for i in (*shape.states, *FAST)]
    stores = [Store("found", place, trace.lift(value)) for place, value in enumerate(values)]
    return Kernel(name, array_rows(shape.layout), stores, (), [])


def inside_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel that projects the parameters onto their bounds."""
    lane = Lane(shape, with_fast_slip=True)
    lane.keep_inside_bounds()
    return lane.kernel(name, with_fast_slip=True)
