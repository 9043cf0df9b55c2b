"""Loop over the steps of filters side by side, for numba."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.constants import PER_STEP
from icreckon.estimator.engine.layout import INPUTS, TWIST
from icreckon.estimator.engine.schedule import (
    AHEAD,
    HEADING,
    MOVE,
    POSITION,
    STEP_COLUMNS,
    TICK,
    UPDATE,
)
from icreckon.estimator.filter.gate import FORCED, SKIPPED
from icreckon.estimator.filter.reacquisition import MOST, laid_over
from icreckon.estimator.tracing.jit_kernel import entry, inner
from icreckon.estimator.tracing.kernel import FLAG_BITS

# Rows of an estimate, the output at a tick.
ESTIMATE = ("x", "y", "yaw", "xx", "xy", "x_yaw", "yy", "y_yaw", "yaw_yaw", *TWIST)
QUIET, MODE = INPUTS["quiet_mean"], INPUTS["fix_mode"]
FIX_X, FIX_Y, FIX_VARIANCE = INPUTS["fix_x"], INPUTS["fix_y"], INPUTS["fix_variance"]
ROWS = len(INPUTS)
# Time of a fix: the end of a step, the end of a step that is a tick, between two steps, and between two
# steps at a tick.
AT_STEP, AT_TICK, BETWEEN_STEPS, TICK_BETWEEN_STEPS = range(4)


class Places(NamedTuple):
    """Places in the workspace that the loop reads and writes itself.

    Attributes:
        estimate: (n,) rows of the output at a tick: those of `ESTIMATE`, and more.
        with_pose: (3, n) rows of the covariances with the pose.
        rejected: row of the time of rejected position fixes.
        used: row of the number of position fixes used.
        at_fix: (6,) rows of the place of the antenna and the yaw, before and after the newest fix.
        interval: place of the interval of the IMU among the constants.
        row_count: number of rows of the workspace.
        constant_count: number of constants.
    """

    estimate: Any
    with_pose: Any
    rejected: int
    used: int
    at_fix: Any
    interval: int
    row_count: int
    constant_count: int


class LaneKernels(NamedTuple):
    """Kernels of one filter shape, each a function of workspace, inputs and constants.

    Attributes:
        usual: step with an IMU sample, while no lane can be at a standstill.
        full: step with an IMU sample and a test for standstill; the twist at its end is computed.
        update: IMU sample at the stamp of the filter, without propagation.
        move: propagation without an IMU sample.
        move_tick: propagation, with the twist at its end.
        position: position fix at the end of a step; returns lanes that are lost, and that used it.
        position_tick: position fix, with the twist after it.
        position_ahead: position fix between two steps.
        position_ahead_tick: position fix between two steps, with the twist after it.
        heading: heading fix at the end of a step.
        heading_tick: heading fix, with the twist after it.
        heading_ahead: heading fix between two steps.
        heading_ahead_tick: heading fix between two steps, with the twist after it.
    """

    usual: Any
    full: Any
    update: Any
    move: Any
    move_tick: Any
    position: Any
    position_tick: Any
    position_ahead: Any
    position_ahead_tick: Any
    heading: Any
    heading_tick: Any
    heading_ahead: Any
    heading_ahead_tick: Any


def lane_worker(kernels: LaneKernels, shape_digest: str) -> Any:
    """Compile the loop over steps of one filter shape, see `BatchFilter.work_through`.

    Args:
        kernels: kernels of that shape.
        shape_digest: digest that separates the machine code of this shape from that of others.
    """
    usual, full, update, move, move_tick, *of_fixes = kernels
    position, position_tick, position_ahead, position_ahead_tick = of_fixes[:4]
    heading, heading_tick, heading_ahead, heading_ahead_tick = of_fixes[4:]

    @inner(shape_digest)
    def update_position(workspace: Floats, given: Floats, constants: Floats, when: int) -> Any:
        """Update with a position fix; at a tick, compute the body velocity after it."""
        if when == TICK_BETWEEN_STEPS:
            return position_ahead_tick(workspace, given, constants)
        if when == BETWEEN_STEPS:
            return position_ahead(workspace, given, constants)
        if when == AT_TICK:
            return position_tick(workspace, given, constants)
        return position(workspace, given, constants)

    @inner(shape_digest)
    def process_position(
        workspace: Floats,
        given: Floats,
        constants: Floats,
        rejected: Floats,
        rejected_count: Any,
        at_fix: Floats,
        places: Places,
        when: int,
    ) -> None:
        """Update with a position fix, and relocate lost lanes, see `Reckoning._take_fix`."""
        width = workspace.shape[1]
        flags = update_position(workspace, given, constants, when)
        lost, used = flags & ((1 << FLAG_BITS) - 1), flags >> FLAG_BITS
        for lane in range(width):
            for axis in range(3):
                at_fix[axis, lane] = workspace[places.at_fix[axis], lane]
            count = rejected_count[lane]
            if count >= rejected.shape[1]:
                count = rejected.shape[1] - 1
                for k in range(count):
                    rejected[lane, k] = rejected[lane, k + 1]
            rejected[lane, count, 0] = given[FIX_X, lane]
            rejected[lane, count, 1] = given[FIX_Y, lane]
            rejected[lane, count, 2] = given[FIX_VARIANCE, lane]
            rejected[lane, count, 3] = at_fix[0, lane]
            rejected[lane, count, 4] = at_fix[1, lane]
            rejected_count[lane] = count + 1
        if lost:
            before = given[MODE].copy()
            for lane in range(width):
                given[MODE, lane] = SKIPPED
                if (lost >> lane) & 1:
                    if relocate(workspace, lane, rejected[lane], rejected_count[lane], places):
                        used |= 1 << lane
                    else:
                        given[MODE, lane] = FORCED
            flags = update_position(workspace, given, constants, when)
            used |= flags >> FLAG_BITS
            given[MODE] = before
        for lane in range(width):
            for axis in range(3, 6):
                at_fix[axis, lane] = workspace[places.at_fix[axis], lane]
            at_fix[6, lane] = (used >> lane) & 1
            if (used >> lane) & 1:
                rejected_count[lane] = 0
            elif given[MODE, lane] == SKIPPED:
                rejected_count[lane] -= 1

    @inner(shape_digest)
    def update_heading(workspace: Floats, given: Floats, constants: Floats, when: int) -> None:
        """Update with a heading fix; at a tick, compute the body velocity after it."""
        if when == TICK_BETWEEN_STEPS:
            heading_ahead_tick(workspace, given, constants)
        elif when == BETWEEN_STEPS:
            heading_ahead(workspace, given, constants)
        elif when == AT_TICK:
            heading_tick(workspace, given, constants)
        else:
            heading(workspace, given, constants)

    def work_through(
        workspace: Floats,
        inputs: Floats,
        constants: Floats,
        table: Floats,
        kinds: Any,
        extras: Any,
        fixes: Any,
        ticks: Any,
        estimates: Floats,
        rejected: Floats,
        rejected_count: Any,
        at_fixes: Floats,
        places: Places,
    ) -> None:
        """Run all lanes through some steps; see `BatchFilter.work_through`.

        Raises:
            ValueError: an array has the wrong size.
        """
        width, output_lanes, count = workspace.shape[1], estimates.shape[2], len(kinds)
        sizes_fit = len(workspace) == places.row_count and len(constants) >= places.constant_count
        sizes_fit &= len(inputs) >= count and inputs.shape[1] == ROWS and inputs.shape[2] == width
        sizes_fit &= len(table) >= count and table.shape[1] == STEP_COLUMNS
        sizes_fit &= len(extras) == count and len(ticks) == count and len(fixes) == count
        sizes_fit &= estimates.shape[1] >= len(places.estimate) and output_lanes <= width
        sizes_fit &= len(rejected) == width and rejected.shape[1:] == (MOST, 5)
        sizes_fit &= at_fixes.shape[1] == 7 and at_fixes.shape[2] == width
        if not sizes_fit or len(rejected_count) != width:
            raise ValueError(WRONG_SIZE)
        for k in range(count):
            if extras[k] & TICK and not 0 <= ticks[k] < len(estimates):
                raise ValueError(WRONG_SIZE)
            if extras[k] & POSITION and not 0 <= fixes[k] < len(at_fixes):
                raise ValueError(WRONG_SIZE)
        for k in range(count):
            for c in range(PER_STEP):
                constants[c] = table[k, c]
            constants[places.interval] = table[k, PER_STEP]
            given = inputs[k]
            is_tick = extras[k] & TICK
            if kinds[k] == AHEAD:
                when = TICK_BETWEEN_STEPS if is_tick else BETWEEN_STEPS
            else:
                when = AT_TICK if is_tick else AT_STEP
                if kinds[k] == MOVE:
                    if is_tick:
                        move_tick(workspace, given, constants)
                    else:
                        move(workspace, given, constants)
                elif kinds[k] == UPDATE:
                    update(workspace, given, constants)
                else:
                    quiet = False
                    for lane in range(width):
                        quiet |= given[QUIET, lane] == given[QUIET, lane]
                    if quiet or is_tick:
                        full(workspace, given, constants)
                    else:
                        usual(workspace, given, constants)
            if extras[k] & POSITION:
                at_fix = at_fixes[fixes[k]]
                process_position(
                    workspace, given, constants, rejected, rejected_count, at_fix, places, when
                )
            if extras[k] & HEADING:
                update_heading(workspace, given, constants, when)
            if is_tick:
                for row in range(len(places.estimate)):
                    for lane in range(output_lanes):
                        estimates[ticks[k], row, lane] = workspace[places.estimate[row], lane]

    return entry(work_through, shape_digest)


def relocate(workspace: Floats, lane: int, rejected: Floats, count: int, places: Places) -> bool:
    """Align the estimated path of one lane with the rejected fixes, if that fits."""
    fits, turn, turn_variance, x, y, to_x, to_y, variance = laid_over(rejected, count)
    if not fits:
        return False
    pose = places.estimate
    cos, sin = np.cos(turn), np.sin(turn)
    from_x, from_y = workspace[pose[0], lane] - x, workspace[pose[1], lane] - y
    away_x, away_y = cos * from_x - sin * from_y, sin * from_x + cos * from_y
    workspace[pose[0], lane], workspace[pose[1], lane] = to_x + away_x, to_y + away_y
    workspace[pose[2], lane] += turn
    for i in range(3):
        for row in places.with_pose[i]:
            workspace[row, lane] = 0.0
    by_turn = (-away_y, away_x, 1.0)
    place = 3
    for i in range(3):
        for j in range(i, 3):
            more = variance if i == j and i < 2 else 0.0
            workspace[pose[place], lane] = turn_variance * by_turn[i] * by_turn[j] + more
            place += 1
    workspace[places.rejected, lane] = 0.0
    workspace[places.used, lane] += 1.0
    return True
