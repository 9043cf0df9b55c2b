"""The loop over the steps of filters side by side, for numba."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.fixes import AS_TRUE, NOT_AT_ALL
from icreckon.estimator.engine.layout import INPUTS, STEP_CONSTANTS, TWIST
from icreckon.estimator.engine.schedule import AHEAD, HEADING, MOVE, POSITION, TICK, UPDATE
from icreckon.estimator.filter.reacquisition import laid_over
from icreckon.estimator.motion.friction_step import step_motion
from icreckon.estimator.tracing.emit import FLAG_BITS
from icreckon.estimator.tracing.jit_kernel import entry, inner

# What is told at a tick.
ESTIMATE = ("x", "y", "yaw", "xx", "xy", "x_yaw", "yy", "y_yaw", "yaw_yaw", *TWIST)
MEAN_LEFT, MEAN_RIGHT, DT = INPUTS["mean_left"], INPUTS["mean_right"], STEP_CONSTANTS.index("dt")
QUIET, HOW = INPUTS["quiet_mean"], INPUTS["how"]
FIX_X, FIX_Y, FIX_VARIANCE = INPUTS["fix_x"], INPUTS["fix_y"], INPUTS["fix_variance"]
PER_STEP, ROWS = len(STEP_CONSTANTS), len(INPUTS)
# When a fix comes: at the end of a step, at one whose estimate is wanted, on the way to the next, and
# there where the estimate is wanted.
AT_STEP, AT_TICK, ON_THE_WAY, TOLD_ON_THE_WAY = range(4)


class Places(NamedTuple):
    """Where in the workspace things are that the loop looks at itself.

    Attributes:
        estimate: (n,) rows of what is told at a tick: those of `ESTIMATE`, and more.
        with_pose: (3, n) rows of the covariances with the pose.
        rejected: row of the position fixes rejected in a row.
        used: row of those used.
        believed_x: row of where the filter thought to be at the newest fix.
        believed_y: the same.
        interval: which of the constants is the interval of the IMU.
        memory: (m,) rows of the motion model's memory.
        parameters: (8,) rows of the parameters; -1 for those that are constants.
        fixed: place of the first parameter among the constants.
        track_scale: row of the track scale; -1 if it is zero.
        row_count: how many rows the workspace has.
        constant_count: how many constants there are.
    """

    estimate: Any
    with_pose: Any
    rejected: int
    used: int
    believed_x: int
    believed_y: int
    interval: int
    memory: Any
    parameters: Any
    fixed: int
    track_scale: int
    row_count: int
    constant_count: int


class LaneKernels(NamedTuple):
    """Kernels of one filter shape, each a function of workspace, inputs and constants.

    Attributes:
        usual: step with an IMU sample, while no lane can be at a standstill.
        full: step with an IMU sample and a test for standstill; the twist at its end is computed.
        update: IMU sample at the stamp of the filter, without propagation.
        move: propagation without an IMU sample.
        move_told: propagation, with the twist at its end.
        position: position fix at the end of a step; returns lanes that are lost, and that used it.
        position_told: position fix, with the twist after it.
        position_ahead: position fix between two steps.
        position_ahead_told: position fix between two steps, with the twist after it.
        heading: heading fix at the end of a step.
        heading_told: heading fix, with the twist after it.
        heading_ahead: heading fix between two steps.
        heading_ahead_told: heading fix between two steps, with the twist after it.
    """

    usual: Any
    full: Any
    update: Any
    move: Any
    move_told: Any
    position: Any
    position_told: Any
    position_ahead: Any
    position_ahead_told: Any
    heading: Any
    heading_told: Any
    heading_ahead: Any
    heading_ahead_told: Any


def lane_worker(kernels: LaneKernels, advance: Any, shape_digest: str) -> Any:
    """Compile the loop over the steps of filters of one shape; see `BatchFilter.work_through`.

    Args:
        kernels: kernels of that shape.
        advance: compiled function that advances the motion models in time, see `advance_memory`.
        shape_digest: digest that separates the machine code of this shape from that of others.
    """
    usual, full, update, move, move_told, *of_fixes = kernels
    position, position_told, position_ahead, position_ahead_told = of_fixes[:4]
    heading, heading_told, heading_ahead, heading_ahead_told = of_fixes[4:]

    @inner(shape_digest)
    def position_of(lanes: Floats, told: Floats, constants: Floats, when: int) -> Any:
        """Take a position fix; at a tick, tell the body velocity after it."""
        if when == TOLD_ON_THE_WAY:
            return position_ahead_told(lanes, told, constants)
        if when == ON_THE_WAY:
            return position_ahead(lanes, told, constants)
        if when == AT_TICK:
            return position_told(lanes, told, constants)
        return position(lanes, told, constants)

    @inner(shape_digest)
    def take_position(
        lanes: Floats,
        told: Floats,
        constants: Floats,
        refused: Floats,
        refused_count: Any,
        places: Places,
        when: int,
    ) -> None:
        """A position fix; where a filter is lost, see `Reckoning._take_fix`."""
        width = lanes.shape[1]
        flags = position_of(lanes, told, constants, when)
        lost, used = flags & ((1 << FLAG_BITS) - 1), flags >> FLAG_BITS
        for lane in range(width):
            count = refused_count[lane]
            if count >= refused.shape[1]:
                raise ValueError(WRONG_SIZE)
            refused[lane, count, 0] = told[FIX_X, lane]
            refused[lane, count, 1] = told[FIX_Y, lane]
            refused[lane, count, 2] = told[FIX_VARIANCE, lane]
            refused[lane, count, 3] = lanes[places.believed_x, lane]
            refused[lane, count, 4] = lanes[places.believed_y, lane]
            refused_count[lane] = count + 1
        if lost:
            before = told[HOW].copy()
            for lane in range(width):
                told[HOW, lane] = NOT_AT_ALL
                if (lost >> lane) & 1:
                    if move_pose(lanes, lane, refused[lane], refused_count[lane], places):
                        used |= 1 << lane
                    else:
                        told[HOW, lane] = AS_TRUE
            flags = position_of(lanes, told, constants, when)
            used |= flags >> FLAG_BITS
            told[HOW] = before
        for lane in range(width):
            if (used >> lane) & 1:
                refused_count[lane] = 0
            elif told[HOW, lane] == NOT_AT_ALL:
                refused_count[lane] -= 1

    @inner(shape_digest)
    def take_heading(lanes: Floats, told: Floats, constants: Floats, when: int) -> None:
        """Take a heading fix, likewise."""
        if when == TOLD_ON_THE_WAY:
            heading_ahead_told(lanes, told, constants)
        elif when == ON_THE_WAY:
            heading_ahead(lanes, told, constants)
        elif when == AT_TICK:
            heading_told(lanes, told, constants)
        else:
            heading(lanes, told, constants)

    def work_through(
        lanes: Floats,
        inputs: Floats,
        constants: Floats,
        table: Floats,
        kinds: Any,
        extras: Any,
        ticks: Any,
        estimates: Floats,
        refused: Floats,
        refused_count: Any,
        model_constants: Any,
        places: Places,
    ) -> None:
        """Work through steps; see `BatchFilter.work_through`.

        Raises:
            ValueError: an array has the wrong size.
        """
        width, told_lanes, steps = lanes.shape[1], estimates.shape[2], len(kinds)
        sizes_fit = len(lanes) == places.row_count and len(constants) == places.constant_count
        sizes_fit &= len(inputs) >= steps and inputs.shape[1] == ROWS and inputs.shape[2] == width
        sizes_fit &= len(table) >= steps and table.shape[1] == PER_STEP + 1
        sizes_fit &= len(extras) == steps and len(ticks) == steps
        sizes_fit &= estimates.shape[1] >= len(places.estimate) and told_lanes <= width
        sizes_fit &= len(refused) == width and refused.shape[2] == 5 and len(refused_count) == width
        if not sizes_fit:
            raise ValueError(WRONG_SIZE)
        for k in range(steps):
            if extras[k] & TICK and not 0 <= ticks[k] < len(estimates):
                raise ValueError(WRONG_SIZE)
        for k in range(len(kinds)):
            for c in range(PER_STEP):
                constants[c] = table[k, c]
            constants[places.interval] = table[k, PER_STEP]
            told = inputs[k]
            tells = extras[k] & TICK
            if kinds[k] == AHEAD:
                how = TOLD_ON_THE_WAY if tells else ON_THE_WAY
            else:
                how = AT_TICK if tells else AT_STEP
                if kinds[k] != UPDATE:
                    advance(lanes, told, constants, model_constants, places)
                if kinds[k] == MOVE:
                    if tells:
                        move_told(lanes, told, constants)
                    else:
                        move(lanes, told, constants)
                elif kinds[k] == UPDATE:
                    update(lanes, told, constants)
                else:
                    quiet = False
                    for lane in range(width):
                        quiet |= told[QUIET, lane] == told[QUIET, lane]
                    if quiet or tells:
                        full(lanes, told, constants)
                    else:
                        usual(lanes, told, constants)
            if extras[k] & POSITION:
                take_position(lanes, told, constants, refused, refused_count, places, how)
            if extras[k] & HEADING:
                take_heading(lanes, told, constants, how)
            if tells:
                for row in range(len(places.estimate)):
                    for lane in range(told_lanes):
                        estimates[ticks[k], row, lane] = lanes[places.estimate[row], lane]

    return entry(work_through, shape_digest)


def keep_memory(
    lanes: Floats, told: Floats, constants: Floats, model_constants: Any, places: Places
) -> None:
    """Advance motion models without memory in time: they do not change."""


def advance_memory(
    lanes: Floats, told: Floats, constants: Floats, model_constants: Any, places: Places
) -> None:
    """Advance the friction models of all lanes by a step, see `MotionModel.begin_step`.

    Args:
        lanes: workspace.
        told: inputs of the step.
        constants: constants of all lanes and of the step.
        model_constants: constants of the friction model.
        places: places in the workspace.
    """
    memory, parameters = np.empty(len(places.memory)), np.empty(len(places.parameters))
    for lane in range(lanes.shape[1]):
        scale = 1.0
        if places.track_scale >= 0:
            scale += lanes[places.track_scale, lane]
        for k in range(len(places.parameters)):
            row = places.parameters[k]
            parameters[k] = lanes[row, lane] if row >= 0 else constants[places.fixed + k]
        for k in range(len(places.memory)):
            memory[k] = lanes[places.memory[k], lane]
        left, right = scale * told[MEAN_LEFT, lane], scale * told[MEAN_RIGHT, lane]
        step_motion(model_constants, parameters, left, right, constants[DT], memory)
        for k in range(len(places.memory)):
            lanes[places.memory[k], lane] = memory[k]


def move_pose(lanes: Floats, lane: int, refused: Floats, count: int, places: Places) -> bool:
    """Lay the believed path of one filter over the fixes that were refused, if that fits."""
    fits, turn, turn_variance, x, y, to_x, to_y, variance = laid_over(refused, count)
    if not fits:
        return False
    pose = places.estimate
    cos, sin = np.cos(turn), np.sin(turn)
    from_x, from_y = lanes[pose[0], lane] - x, lanes[pose[1], lane] - y
    away_x, away_y = cos * from_x - sin * from_y, sin * from_x + cos * from_y
    lanes[pose[0], lane], lanes[pose[1], lane] = to_x + away_x, to_y + away_y
    lanes[pose[2], lane] += turn
    for i in range(3):
        for row in places.with_pose[i]:
            lanes[row, lane] = 0.0
    by_turn = (-away_y, away_x, 1.0)
    place = 3
    for i in range(3):
        for j in range(i, 3):
            more = variance if i == j and i < 2 else 0.0
            lanes[pose[place], lane] = turn_variance * by_turn[i] * by_turn[j] + more
            place += 1
    lanes[places.rejected, lane] = 0.0
    lanes[places.used, lane] += 1.0
    return True
