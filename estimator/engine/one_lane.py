"""Traced step of one filter, on the state and covariance of `IcrEkf`.

The kernels are those of many filters side by side, compiled for one lane. State and covariance are copied
to the workspace of the kernel before each call, and back afterwards.
"""

from __future__ import annotations

import hashlib
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.lane import FAST, FilterShape, Lane
from icreckon.estimator.engine.layout import INPUTS, MOTION, SLIP_SHARES, TWIST
from icreckon.estimator.engine.model import TracedModel, traced_model
from icreckon.estimator.engine.schedule import PER_STEP, SMOOTHING, step_constants
from icreckon.estimator.engine.step import StepKind, step_kernel
from icreckon.estimator.filter.gate import count_verdict
from icreckon.estimator.filter.health import ADMITTED, REACQUIRED, REJECTED
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.sensors.measurement_models import ACCELEROMETERS
from icreckon.estimator.tracing.emit import Kernel, kernel_on_demand
from icreckon.estimator.tracing.jit_kernel import entry

COUNT = s.PARAMETER_COUNT
PARAMETERS, FAST_SLIP = s.PARAMETERS.start, s.FAST_SLIP.start
ROWS = len(INPUTS)
# Places of a constant of a step, and of inputs of a kernel.
LEFT, RIGHT = INPUTS["left"], INPUTS["right"]


class OneLane(NamedTuple):
    """Compiled functions of one filter shape at one lane.

    Attributes:
        shape: shape of the filter.
        imu_step: step with an IMU sample at its end.
        time_step: step without one.
        twist: body velocity with its derivatives.
    """

    shape: FilterShape
    imu_step: Any
    time_step: Any
    twist: Any


class LanePlaces(NamedTuple):
    """Places in the workspace of one lane.

    Attributes:
        size: number of states of the filter.
        states: indices of the uncertain states, the fast slip last.
        parameters: indices of the uncertain parameters.
        x: (n,) rows of the states.
        P: (n, n) rows of the covariance.
        regressors: row of the first regressor.
        memory: row of the first number of the model's memory.
        memory_size: number of numbers of the memory.
        stood: row that is 1 if the robot was found standing.
        slip_factor: row of the factor on the slip.
        gyro: rows of the gyro: rejections in a row, number admitted, innovation, its variance.
        accelerometers: the same rows of the accelerometers, forward and left.
        twist: row of the twist's first component.
        motion: row of the first value of `MOTION`.
        by_state: (3, n) rows of the twist's derivatives by the states.
        fixed: place of the first parameter among the constants.
        interval: place of the interval of the IMU among them.
        slip_shares: place of the first factor on the slip of an evaluated twist among them.
        row_count: number of rows.
        constant_count: number of constants.
    """

    size: int
    states: Any
    parameters: Any
    x: Any
    P: Any
    regressors: int
    memory: int
    memory_size: int
    stood: int
    slip_factor: int
    gyro: tuple[int, int, int, int]
    accelerometers: tuple[tuple[int, int, int, int], tuple[int, int, int, int]]
    twist: int
    motion: int
    by_state: Any
    fixed: int
    interval: int
    slip_shares: int
    row_count: int
    constant_count: int


def one_lane(
    model: MotionModel, considered: tuple[int, ...], *, wanders: bool = False
) -> OneLane | None:
    """Compile the step of a motion model for one lane; None if it has no traced form.

    Every parameter, bias and scale is a state, so that all variants of a model share the machine code.

    Args:
        model: the motion model.
        considered: consider states.
        wanders: the wander of position fixes is part of the state.
    """
    described = traced_model(model)
    return None if described is None else _one_lane(described, considered, wanders)


@cache
def _one_lane(model: TracedModel, considered: tuple[int, ...], wanders: bool) -> OneLane:
    parameters = tuple(PARAMETERS + k for k in model.parameters)
    others = (i for i in range(FAST_SLIP) if not PARAMETERS <= i < s.PARAMETERS.stop)
    wander = (s.WANDER_X, s.WANDER_Y) if wanders else ()
    shape = FilterShape(tuple(sorted((*others, *parameters, *wander))), (), model, considered)
    of_sample = StepKind(stands=True, may_lack_force=True, innovations=True, fast_slip=True)
    of_time = StepKind(imu=False, accelerometer=False, fast_slip=True)
    kernels = {
        "imu_step": partial(step_kernel, "imu_step", shape, of_sample),
        "time_step": partial(step_kernel, "time_step", shape, of_time),
        "twist": partial(_twist_kernel, "twist", shape),
    }
    compiled = {name: kernel_on_demand(name, make, 1, shape.bits) for name, make in kernels.items()}
    shape_digest = hashlib.sha256(repr(shape).encode()).hexdigest()[:12]
    places = _places(shape)
    return OneLane(
        shape,
        compile_imu_step(compiled["imu_step"], places, shape_digest),
        compile_time_step(compiled["time_step"], places, shape_digest),
        compile_twist(compiled["twist"], places, shape_digest),
    )


def _twist_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel that evaluates a body velocity with its derivatives."""
    lane = Lane(shape, with_fast_slip=True)
    shares = [lane.constant(name) for name in SLIP_SHARES]
    now = lane.twist_model(lane.input("left"), lane.input("right"), shares)
    lane.store_motion(now)
    return lane.kernel(name, with_fast_slip=True)


def _places(shape: FilterShape) -> LanePlaces:
    layout = shape.layout
    rows, constants = layout.rows, layout.constants
    states = (*shape.states, *FAST)

    def of_gate(sensor: str) -> tuple[int, int, int, int]:
        parts = ("rejected_for", "admitted", "z", "S")
        rejected_for, admitted, z, S = (rows[f"{sensor}_{part}"] for part in parts)
        return rejected_for, admitted, z, S

    memory = shape.model.memory
    return LanePlaces(
        max(states) + 1,
        np.array(states, np.uintp),
        np.array(layout.parameters, np.uintp),
        np.array([rows[f"x{i}"] for i in states], np.uintp),
        np.array([[rows[f"P{min(i, j)}_{max(i, j)}"] for j in states] for i in states], np.uintp),
        rows[f"r0_{layout.parameters[0]}"],
        rows["memory0"] if memory else 0,
        memory,
        rows["stood"],
        rows["slip_factor"],
        of_gate("gyro"),
        (of_gate(ACCELEROMETERS[0]), of_gate(ACCELEROMETERS[1])),
        rows[TWIST[0]],
        rows[MOTION[0]],
        np.array([[rows[f"{axis}_by_{i}"] for i in states] for axis in TWIST[:3]]),
        constants[f"fixed{PARAMETERS}"],
        constants["interval"],
        constants[SLIP_SHARES[0]],
        len(rows),
        len(constants),
    )


# --- compiled functions -----------------------------------------------------------------------------


def fill_state(
    lane: Floats, constants: Floats, x: Floats, memory: Floats, places: LanePlaces
) -> None:
    """Copy state and memory of the motion model into the workspace.

    Raises:
        ValueError: an array has the wrong size.
    """
    sizes_fit = lane.shape == (places.row_count, 1) and len(constants) >= places.constant_count
    if not sizes_fit or x.shape != (places.size,) or len(memory) != places.memory_size:
        raise ValueError(WRONG_SIZE)
    for a in range(len(places.states)):
        lane[places.x[a], 0] = x[places.states[a]]
    for k in range(COUNT):
        constants[places.fixed + k] = x[PARAMETERS + k]
    for k in range(len(memory)):
        lane[places.memory + k, 0] = memory[k]


def fill_covariance(lane: Floats, P: Floats, regressors: Floats, places: LanePlaces) -> None:
    """Copy covariance and regressors into the workspace.

    Raises:
        ValueError: an array has the wrong size.
    """
    if P.shape != (places.size, places.size) or regressors.shape != (3, COUNT):
        raise ValueError(WRONG_SIZE)
    n = len(places.states)
    for a in range(n):
        i = places.states[a]
        for b in range(a, n):
            lane[places.P[a, b], 0] = P[i, places.states[b]]
    row = places.regressors
    for axis in range(3):
        for i in places.parameters:
            lane[row, 0] = regressors[axis, i - PARAMETERS]
            row += 1


def empty_lane(
    lane: Floats, x: Floats, P: Floats, regressors: Floats, memory: Floats, places: LanePlaces
) -> None:
    """Copy the filter out of the workspace."""
    for k in range(len(memory)):
        memory[k] = lane[places.memory + k, 0]
    n = len(places.states)
    for a in range(n):
        i = places.states[a]
        x[i] = lane[places.x[a], 0]
        for b in range(a, n):
            j = places.states[b]
            P[i, j] = P[j, i] = lane[places.P[a, b], 0]
    row = places.regressors
    for axis in range(3):
        for i in places.parameters:
            regressors[axis, i - PARAMETERS] = lane[row, 0]
            row += 1


def fill_constants(
    record: Any, lane: Floats, constants: Floats, stamp: int, is_first: bool, places: LanePlaces
) -> None:
    """Compute the constants of a step to a stamp [ns], and the factor on the slip.

    The first step does not smooth.
    """
    values = step_constants((stamp - record.stamp) * NANOSECOND)
    for k in range(PER_STEP):
        constants[k] = values[k]
    if is_first:
        constants[SMOOTHING] = 1.0
    constants[places.interval] = record.imu.interval
    lane[places.slip_factor, 0] = record.slip_factor


def set_gate(counts: Any, lane: Floats, rows: tuple[int, int, int, int]) -> None:
    """Copy the rejections of a gate into the workspace."""
    rejected_for, admitted, _, _ = rows
    lane[rejected_for, 0], lane[admitted, 0] = counts.rejected_for, 0.0


def count_sample(
    counts: Any, stamp: int, interval: float, lane: Floats, rows: tuple[int, int, int, int]
) -> bool:
    """Count the verdict of a gate on the newest sample; return True if it is used."""
    rejected_for, admitted, innovation, variance = rows
    z, S = lane[innovation, 0], lane[variance, 0]
    if S == 0.0:
        return False
    verdict = REACQUIRED
    if lane[admitted, 0] > 0.0:
        verdict = ADMITTED
    elif lane[rejected_for, 0] > 0.0:
        verdict = REJECTED
    count_verdict(counts, verdict, z * z / S, 1, interval)
    counts.stamp, counts.verdict, counts.z[0], counts.S[0] = stamp, verdict, z, S
    return verdict != REJECTED


def compile_imu_step(kernel: Any, places: LanePlaces, shape_digest: str) -> Any:
    """Compile a step with an IMU sample at its end."""

    def step_with_imu(
        records: Any,
        x: Floats,
        P: Floats,
        regressors: Floats,
        memory: Floats,
        lane: Floats,
        inputs: Floats,
        constants: Floats,
        stamp: int,
        is_first: bool,
    ) -> bool:
        """Draw the fast slip, update by the gyro and the accelerometer, and propagate.

        Args:
            records: (1,) record of the filter, see `FilterRecord`, changed in place.
            x: (SIZE,) the state, changed in place.
            P: (SIZE, SIZE) its covariance, changed in place.
            regressors: (3, 9) smoothed derivatives by the parameters, changed in place.
            memory: memory of the motion model, changed in place.
            lane: workspace.
            inputs: (n, 1) inputs of the kernel.
            constants: constants of the kernel.
            stamp: stamp of the sample [ns].
            is_first: the step is the first, so that there are no regressors yet.

        Returns:
            True if the yaw rate is used.

        Raises:
            ValueError: an array has the wrong size.
        """
        if inputs.shape != (ROWS, 1):
            raise ValueError(WRONG_SIZE)
        record = records[0]
        fill_state(lane, constants, x, memory, places)
        fill_covariance(lane, P, regressors, places)
        fill_constants(record, lane, constants, stamp, is_first, places)
        set_gate(record.gyro, lane, places.gyro)
        set_gate(record.accelerometer_x, lane, places.accelerometers[0])
        set_gate(record.accelerometer_y, lane, places.accelerometers[1])
        kernel(lane, inputs, constants)
        empty_lane(lane, x, P, regressors, memory, places)
        record.stamp, record.stands = stamp, int(lane[places.stood, 0])
        count_sample(
            record.accelerometer_x, stamp, record.imu.interval, lane, places.accelerometers[0]
        )
        count_sample(
            record.accelerometer_y, stamp, record.imu.interval, lane, places.accelerometers[1]
        )
        return count_sample(record.gyro, stamp, record.imu.interval, lane, places.gyro)

    return entry(step_with_imu, shape_digest)


def compile_time_step(kernel: Any, places: LanePlaces, shape_digest: str) -> Any:
    """Compile a step without an IMU sample."""

    def step_without_imu(
        records: Any,
        x: Floats,
        P: Floats,
        regressors: Floats,
        memory: Floats,
        lane: Floats,
        inputs: Floats,
        constants: Floats,
        stamp: int,
        is_first: bool,
    ) -> None:
        """Draw the fast slip and propagate; arguments as in `step_with_imu`."""
        if inputs.shape != (ROWS, 1):
            raise ValueError(WRONG_SIZE)
        record = records[0]
        fill_state(lane, constants, x, memory, places)
        fill_covariance(lane, P, regressors, places)
        fill_constants(record, lane, constants, stamp, is_first, places)
        lane[places.stood, 0] = 0.0
        kernel(lane, inputs, constants)
        empty_lane(lane, x, P, regressors, memory, places)
        record.stamp = stamp

    return entry(step_without_imu, shape_digest)


def compile_twist(kernel: Any, places: LanePlaces, shape_digest: str) -> Any:
    """Compile the body velocity with its derivatives."""

    def evaluate_twist(
        x: Floats,
        memory: Floats,
        lane: Floats,
        inputs: Floats,
        constants: Floats,
        left: float,
        right: float,
        share_x: float,
        share_y: float,
        share_w: float,
        twist: Floats,
        jacobian: Floats,
        by_speeds: Floats,
    ) -> Any:
        """Evaluate the body velocity, see `IcrEkf.twist_model`.

        Args:
            x: (SIZE,) the state.
            memory: memory of the motion model.
            lane: workspace.
            inputs: (n, 1) inputs of the kernel.
            constants: constants of the kernel.
            left: speed of the left track [m/s].
            right: speed of the right track [m/s].
            share_x: factor on the slip of v_x.
            share_y: that of v_y.
            share_w: that of w.
            twist: (3,) written to.
            jacobian: (3, SIZE) written to.
            by_speeds: (3, 2) written to.

        Returns:
            zeta, epsilon, eta, u and force, see `Motion`.

        Raises:
            ValueError: an array has the wrong size.
        """
        sizes_fit = twist.shape == (3,) and jacobian.shape == (3, places.size)
        if not sizes_fit or by_speeds.shape != (3, 2) or inputs.shape != (ROWS, 1):
            raise ValueError(WRONG_SIZE)
        fill_state(lane, constants, x, memory, places)
        inputs[LEFT, 0], inputs[RIGHT, 0] = left, right
        first = places.slip_shares
        constants[first], constants[first + 1], constants[first + 2] = share_x, share_y, share_w
        kernel(lane, inputs, constants)
        jacobian[:] = 0.0
        for axis in range(3):
            twist[axis] = lane[places.twist + axis, 0]
            for a in range(len(places.states)):
                jacobian[axis, places.states[a]] = lane[places.by_state[axis, a], 0]
            for side in range(2):
                by_speeds[axis, side] = lane[places.motion + 5 + 2 * axis + side, 0]
        m = places.motion
        return lane[m, 0], lane[m + 1, 0], lane[m + 2, 0], lane[m + 3, 0], lane[m + 4, 0]

    return entry(evaluate_twist, shape_digest)
