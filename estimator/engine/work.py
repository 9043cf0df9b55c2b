"""Loop over the steps of filters side by side, for numba."""

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.engine.constants import PER_STEP
from icreckon.estimator.engine.layout import INPUTS, TWIST
from icreckon.estimator.engine.schedule import AHEAD, HEADING, MOVE, POSITION, TICK, UPDATE, Steps
from icreckon.estimator.faults.scattering_fixes import TakenFix
from icreckon.estimator.filter.filter_record import wander_after
from icreckon.estimator.filter.gate import FORCED, SKIPPED
from icreckon.estimator.filter.reacquisition import add_rejected, relocate
from icreckon.estimator.filter.slip_factor import follow_scatter
from icreckon.estimator.tracing.kernel import FLAG_BITS, call_kernel

# Rows of an estimate, the output at a tick.
ESTIMATE = ("x", "y", "yaw", "xx", "xy", "x_yaw", "yy", "y_yaw", "yaw_yaw", *TWIST)
QUIET, MODE = INPUTS["quiet_mean"], INPUTS["fix_mode"]
FIX_X, FIX_Y, FIX_VARIANCE = INPUTS["fix_x"], INPUTS["fix_y"], INPUTS["fix_variance"]
NOT_COMPILED = "a kernel that a step needs was not compiled: `prepare` the same steps first"


class Places(NamedTuple):
    """Places in the workspace that the loop reads and writes itself."""

    estimate: Any  # (n,) rows of the output at a tick: those of `ESTIMATE`, and more
    states: Any  # (n,) indices of the uncertain states
    x: Any  # (n,) their rows
    variances: Any  # (n,) rows of their variances
    replaced: Any  # (k,) rows of the pose, and of the wander if fixes wander
    with_replaced: Any  # (k, m) rows of their covariances with all states
    of_replaced: Any  # (k, k) rows of their covariances with each other
    rejected: int  # row of the time of rejected position fixes
    used: int  # row of the number of position fixes used
    predicted: Any  # (3,) rows of the place of the antenna and the yaw before the newest fix
    updated: Any  # (3,) the same rows after it
    innovation: Any  # (5,) rows of its innovation, and of the covariance of that: xx, xy, yy
    interval: int  # place of the interval of the IMU among the constants
    row_count: int  # number of rows of the workspace
    constant_count: int  # number of constants
    wander_sigma: float  # standard deviation of the wander of fixes [m], 0 if they do not wander
    wander_time: float  # its correlation time [s]


class LaneKernels(NamedTuple):
    """Addresses of the kernels of one filter shape; 0 for those not needed."""

    usual: int = 0  # step with an IMU sample, while no lane can be at a standstill
    # step with an IMU sample and a test for standstill; the twist at its end is computed
    full: int = 0
    update: int = 0  # IMU sample at the stamp of the filter, without propagation
    # propagation without an IMU sample; the second with the twist at its end, for a tick
    moves: tuple[int, int] = (0, 0)
    # position fix at each `time_of_fix`, at ticks with the twist; returns lanes that are lost, and that
    # used it
    positions: tuple[int, int, int, int] = (0, 0, 0, 0)
    headings: tuple[int, int, int, int] = (0, 0, 0, 0)  # the same of heading fixes


def work_through(
    kernels: LaneKernels,
    workspace: Floats,
    inputs: Floats,
    constants: Floats,
    table: Floats,
    steps: Steps,
    estimates: Floats,
    fixes: Any,
    places: Places,
) -> None:
    """Run all lanes through some steps; see `BatchFilter.work_through`.

    It checks no sizes. The ticks of the steps are indices of `estimates`.

    Raises:
        ValueError: a kernel that a step needs is missing.
    """
    for k in range(len(steps.kinds)):
        for c in range(PER_STEP):
            constants[c] = table[k, c]
        constants[places.interval] = table[k, PER_STEP]
        step_inputs, kind, extra, stamp = inputs[k], steps.kinds[k], steps.extras[k], steps.ends[k]
        is_tick, fix_time = (extra & TICK) > 0, time_of_fix(kind, extra)
        if kind != AHEAD:
            kernel = kernel_of_step(kernels, kind, is_tick, step_inputs)
            run_kernel(kernel, workspace, step_inputs, constants)
        if extra & POSITION:
            kernel = kernels.positions[fix_time]
            process_position(kernel, workspace, step_inputs, constants, fixes, stamp, places)
        if extra & HEADING:
            for lane in range(workspace.shape[1]):
                let_wander(workspace, lane, fixes[lane], stamp, places)
            run_kernel(kernels.headings[fix_time], workspace, step_inputs, constants)
        if is_tick:
            for row in range(len(places.estimate)):
                for lane in range(estimates.shape[2]):
                    estimates[steps.ticks[k], row, lane] = workspace[places.estimate[row], lane]


def kernel_of_step(kernels: LaneKernels, kind: int, is_tick: bool, step_inputs: Floats) -> int:
    """Address of the kernel of a step that is no fix ahead."""
    if kind == MOVE:
        return kernels.moves[1 if is_tick else 0]
    if kind == UPDATE:
        return kernels.update
    may_stand = False
    for mean in step_inputs[QUIET]:
        may_stand |= mean == mean  # not NaN
    return kernels.full if may_stand or is_tick else kernels.usual


def time_of_fix(kind: Any, extra: Any) -> Any:
    """Time of a fix: 0, the end of a step; 2, between two steps; 1 more at a tick."""
    return 2 * (kind == AHEAD) + ((extra & TICK) > 0)


def process_position(
    kernel: int,
    workspace: Floats,
    step_inputs: Floats,
    constants: Floats,
    fixes: Any,
    stamp: int,
    places: Places,
) -> None:
    """Update with a position fix, see `Reckoning._take_position`.

    `kernel` is the address of its kernel, `stamp` that of the fix [ns]. Variances and modes among the
    inputs of the step are changed, and restored at the end.
    """
    width, before = workspace.shape[1], rows_of(workspace, places.x)
    stated_variances, modes = step_inputs[FIX_VARIANCE].copy(), step_inputs[MODE].copy()
    wandered = np.zeros(width)
    for lane in range(width):
        if modes[lane] != SKIPPED:
            wandered[lane] = let_wander(workspace, lane, fixes[lane], stamp, places)
            variance = fixes[lane].scatter.variance
            step_inputs[FIX_VARIANCE, lane] = max(step_inputs[FIX_VARIANCE, lane], variance)
    flags = run_kernel(kernel, workspace, step_inputs, constants)
    lost, used = flags & ((1 << FLAG_BITS) - 1), flags >> FLAG_BITS
    innovation = rows_of(workspace, places.innovation)
    predicted = rows_of(workspace, places.predicted)
    for lane in range(width):
        if modes[lane] != SKIPPED:
            fix = position_of_lane(step_inputs, lane, step_inputs[FIX_VARIANCE])
            place = three_rows(predicted, lane, 0)
            add_rejected(fixes[lane].rejected, fix, place, wandered[lane])
    if lost:
        # Again, in lost lanes alone, with the fix or with the relocated pose.
        used |= relocate_lost(lost, workspace, step_inputs, fixes, places)
        used |= run_kernel(kernel, workspace, step_inputs, constants) >> FLAG_BITS
    updated, is_inflated = rows_of(workspace, places.updated), False
    for lane in range(width):
        is_used = (used >> lane) & 1 == 1
        if modes[lane] != SKIPPED and not places.wander_sigma:
            x, y, variance = position_of_lane(step_inputs, lane, stated_variances)
            z, S = (innovation[0, lane], innovation[1, lane]), three_rows(innovation, lane, 2)
            places_of_antenna = three_rows(predicted, lane, 0), three_rows(updated, lane, 0)
            taken = TakenFix(stamp, x, y, variance, z, S, *places_of_antenna, is_used)
            scatter, x_before = fixes[lane].scatter, before[:, lane]
            is_inflated |= follow_in_lane(workspace, lane, scatter, taken, x_before, places)
        if is_used or modes[lane] == SKIPPED:
            fixes[lane].rejected.count = 0
    if is_inflated:
        # The twist's covariance follows the inflation.
        step_inputs[MODE, :] = SKIPPED
        run_kernel(kernel, workspace, step_inputs, constants)
    for lane in range(width):
        step_inputs[FIX_VARIANCE, lane] = stated_variances[lane]
        step_inputs[MODE, lane] = modes[lane]


def relocate_lost(
    lost: int, workspace: Floats, step_inputs: Floats, fixes: Any, places: Places
) -> int:
    """Relocate lanes that are lost; the bits of those whose rejected fixes fit.

    Modes change so that only lost lanes that do not fit use the fix: a relocated pose contains it.
    """
    relocated = 0
    for lane in range(workspace.shape[1]):
        step_inputs[MODE, lane] = SKIPPED
        if (lost >> lane) & 1:
            if relocate_lane(workspace, lane, fixes[lane].rejected, places):
                relocated |= 1 << lane
            else:
                step_inputs[MODE, lane] = FORCED
    return relocated


def run_kernel(kernel: int, workspace: Floats, step_inputs: Floats, constants: Floats) -> int:
    """Call a kernel, see `call_kernel`; a ValueError if there is none."""
    if kernel == 0:
        raise ValueError(NOT_COMPILED)
    return call_kernel(kernel, workspace, step_inputs, constants)


def rows_of(workspace: Floats, rows: Any) -> Floats:
    """Copy some rows of the workspace (k, lanes)."""
    copied = np.empty((len(rows), workspace.shape[1]))
    for k in range(len(rows)):
        for lane in range(workspace.shape[1]):
            copied[k, lane] = workspace[rows[k], lane]
    return copied


def position_of_lane(
    step_inputs: Floats, lane: int, variances: Floats
) -> tuple[float, float, float]:
    """Position fix of a lane: x, y [m], and its variance of those given [m²]."""
    return float(step_inputs[FIX_X, lane]), float(step_inputs[FIX_Y, lane]), float(variances[lane])


def three_rows(rows: Floats, lane: int, first: int) -> tuple[float, float, float]:
    """Numbers of a lane in three successive rows, from row `first` on."""
    return rows[first, lane], rows[first + 1, lane], rows[first + 2, lane]


def let_wander(workspace: Floats, lane: int, fixes: Any, stamp: int, places: Places) -> float:
    """Propagate the wander of one lane to a stamp [ns]; return its noise [m²]."""
    if not places.wander_sigma:
        return 0.0
    decay, variance = wander_after(fixes, stamp, places.wander_sigma, places.wander_time)
    for k in range(3, len(places.replaced)):
        workspace[places.replaced[k], lane] *= decay
        for row in places.with_replaced[k]:
            workspace[row, lane] *= decay
        # Of all covariances with a state, that with itself is one, and has two such factors.
        row = places.of_replaced[k, k]
        workspace[row, lane] = workspace[row, lane] * decay + variance
    return variance


def relocate_lane(workspace: Floats, lane: int, rejected: Any, places: Places) -> bool:
    """Align the pose of one lane with the rejected fixes, if that fits."""
    pose, covariance, replaced = np.empty(3), np.empty((5, 5)), places.replaced
    for k in range(3):
        pose[k] = workspace[replaced[k], lane]
    if not relocate(rejected, pose, covariance, places.wander_sigma):
        return False
    for k in range(len(replaced)):
        workspace[replaced[k], lane] = pose[k] if k < 3 else 0.0
        for row in places.with_replaced[k]:
            workspace[row, lane] = 0.0
    for i in range(len(replaced)):
        for j in range(len(replaced)):
            workspace[places.of_replaced[i, j], lane] = covariance[i, j]
    workspace[places.rejected, lane] = 0.0
    workspace[places.used, lane] += 1.0
    return True


def follow_in_lane(
    workspace: Floats, lane: int, scatter: Any, fix: TakenFix, before: Floats, places: Places
) -> bool:
    """Add a fix to the scatter of one lane; return True if its covariance is inflated.

    States that scattering fixes have moved become uncertain by as much, as in
    `Reckoning._take_position`. `before` (n,) are the lane's states before the update, x and y first.
    """
    correction = np.zeros(s.SIZE)
    for k in range(len(before)):
        correction[places.states[k]] = workspace[places.x[k], lane] - before[k]
    if not follow_scatter(scatter, fix, correction):
        return False
    for k in range(len(before)):
        moved = scatter.moved[places.states[k]]
        # Scatter has no direction: what moved x makes y uncertain, too, and the reverse.
        first, end = (0, s.Y + 1) if k <= s.Y else (k, k + 1)
        for place in range(first, end):
            workspace[places.variances[place], lane] += moved * moved
    return True
