"""Steps of one filter, on its state and covariance.

The kernels are those of many filters side by side, at one lane; they report all changes. State and
covariance are copied to the workspace of a kernel before each call, and back afterwards. The functions
are compiled, or executed in Python (`Settings.engine`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.constants import PER_STEP, SMOOTHING, step_constants
from icreckon.estimator.engine.fixes import FixKind, position_kernel
from icreckon.estimator.engine.lane import FAST, FilterShape, plain_kernel
from icreckon.estimator.engine.lane_inputs import (
    move_inputs,
    sample_inputs,
    take_tracks_of,
)
from icreckon.estimator.engine.layout import (
    FACTORS,
    INPUTS,
    MOTION,
    PLACES,
    SLIP_SHARES,
    TREND,
    TWIST,
)
from icreckon.estimator.engine.model import TracedModel, described
from icreckon.estimator.engine.step import StepKind, step_kernel, twist_kernel
from icreckon.estimator.filter.filter_record import DEPARTURE
from icreckon.estimator.filter.gate import count_verdict
from icreckon.estimator.filter.health import ADMITTED, REACQUIRED, REJECTED
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.sensors.measurement_models import ACCELEROMETERS
from icreckon.estimator.tracing.kernel import Kernel

PARAMETERS, FAST_SLIP = s.PARAMETERS.start, s.FAST_SLIP.start
ROWS = len(INPUTS)
# Places of a constant of a step, and of inputs of a kernel.
LEFT, RIGHT = INPUTS["left"], INPUTS["right"]
# Steps of a filter that reports its changes: with an IMU sample at its end, and at its start; without
# one; its two halves; and position fixes, at its end and ahead of it.
OF_SAMPLE = StepKind(stands=True, may_lack_force=True, innovations=True, fast_slip=True)
OF_TIME = StepKind(imu=False, accelerometer=False, fast_slip=True)
STEPS = {
    "imu_step": OF_SAMPLE,
    "imu_update": OF_SAMPLE._replace(draws=False, moves=False, resumes=True),
    "time_step": OF_TIME,
    "begin": OF_TIME._replace(moves=False),
    "propagate": OF_TIME._replace(draws=False, resumes=True),
}
FIXES = {"position": FixKind(fast_slip=True), "position_ahead": FixKind(fast_slip=True, ahead=True)}
# Rows that the record of a filter holds.
OF_RECORD = (*FACTORS, *TREND, *DEPARTURE)


class OneLane(NamedTuple):
    """Functions of one filter shape at one lane.

    Attributes:
        shape: shape of the filter.
        is_plain: the functions are executed in Python.
        steps: function of each of `STEPS` and `FIXES`, by name.
        twist: body velocity with its derivatives.
        take_tracks: see `lane_inputs`, as the others.
        fill_sample: see `lane_inputs`.
        fill_move: see `lane_inputs`.
        first_report: first of the rows with the changes that a kernel reports.
        position: rows of the innovation of a position fix and its covariance, of the number admitted,
            and of place and yaw before and after it.
    """

    shape: FilterShape
    is_plain: bool
    steps: dict[str, Any]
    twist: Any
    take_tracks: Any
    fill_sample: Any
    fill_move: Any
    first_report: int
    position: Any


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
        of_record: rows of `OF_RECORD`.
        gyro: rows of the gyro: rejections in a row, number admitted, innovation, its variance.
        accelerometers: the same rows of the accelerometers, forward and left.
        position_rejected_for: row of the time of rejected position fixes.
        position_admitted: row of the number of admitted ones.
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
    of_record: Any
    gyro: tuple[int, int, int, int]
    accelerometers: tuple[tuple[int, int, int, int], tuple[int, int, int, int]]
    position_rejected_for: int
    position_admitted: int
    twist: int
    motion: int
    by_state: Any
    fixed: int
    interval: int
    slip_shares: int
    row_count: int
    constant_count: int


def one_lane(
    model: MotionModel, considered: tuple[int, ...], *, wanders: bool, compiles: bool
) -> OneLane:
    """Make the functions of a motion model for one lane.

    Every parameter, bias and scale is a state, so that all variants of a model share the machine code. A
    model that has no traced form is computed in Python.

    Args:
        model: the motion model.
        considered: consider states.
        wanders: the wander of position fixes is part of the state.
        compiles: compile the functions, or load their machine code.
    """
    found = described(model)
    if found.kind == "plain" or not compiles:
        return _plain(found, considered, wanders, model if found.kind == "plain" else None)
    return _compiled(found, considered, wanders)


def shape_of(model: TracedModel, considered: tuple[int, ...], wanders: bool) -> FilterShape:
    """Shape of a filter at one lane."""
    parameters = tuple(PARAMETERS + k for k in model.parameters)
    others = (i for i in range(FAST_SLIP) if not PARAMETERS <= i < s.PARAMETERS.stop)
    wander = (s.WANDER_X, s.WANDER_Y) if wanders else ()
    states = tuple(sorted((*others, *parameters, *wander)))
    return FilterShape(states, (), model, considered, reports=True)


def kernel_makers(shape: FilterShape) -> dict[str, Callable[..., Kernel]]:
    """Make the functions that make the kernels, by name."""
    steps = {name: partial(step_kernel, name, shape, kind) for name, kind in STEPS.items()}
    fixes = {name: partial(position_kernel, name, shape, kind) for name, kind in FIXES.items()}
    return {**steps, **fixes, "twist": partial(twist_kernel, "twist", shape)}


@cache
def _compiled(model: TracedModel, considered: tuple[int, ...], wanders: bool) -> OneLane:
    from icreckon.estimator.tracing.emit import kernel_on_demand
    from icreckon.estimator.tracing.jit_kernel import entry

    shape = shape_of(model, considered, wanders)
    digest = hashlib.sha256(repr(shape).encode()).hexdigest()[:12]
    kernels = {
        name: kernel_on_demand(name, make, 1, shape.bits)
        for name, make in kernel_makers(shape).items()
    }

    def of_shape(function: Any, name: str) -> Any:
        # Functions of one name would share their machine code.
        return entry(function, f"{digest}_{name}")

    return _functions(shape, kernels, of_shape, _entry)


@cache
def _entry(function: Any) -> Any:
    """Compile a function, once for all shapes."""
    from icreckon.estimator.tracing.jit_kernel import entry

    return entry(function)


def _plain(
    model: TracedModel,
    considered: tuple[int, ...],
    wanders: bool,
    of_user: MotionModel | None,
) -> OneLane:
    shape = shape_of(model, considered, wanders)

    def plain(make: Callable[..., Kernel]) -> Any:
        return plain_kernel(lambda numbers: make(numbers=numbers), of_user)

    kernels = {name: plain(make) for name, make in kernel_makers(shape).items()}
    found = _functions(shape, kernels, lambda function, _: function, lambda function: function)
    return found._replace(is_plain=True)


def _functions(
    shape: FilterShape,
    kernels: dict[str, Any],
    of_shape: Callable[[Any, str], Any],
    of_all: Callable[[Any], Any],
) -> OneLane:
    """Make the functions of one lane.

    Args:
        shape: shape of the filter.
        kernels: kernels by name.
        of_shape: compiles a function that depends on the shape, under a name, or returns it as it is.
        of_all: the same of one that does not.
    """
    places, rows = _places(shape), shape.layout.rows
    made = {name: position_update(kernels[name], places) for name in FIXES}
    for name, kind in STEPS.items():
        if kind.imu:
            made[name] = step_with_imu(kernels[name], places)
        else:
            made[name] = step_without_imu(kernels[name], places, arrives=kind.moves)
    steps = {name: of_shape(function, name) for name, function in made.items()}
    innovation = [f"position_{part}" for part in ("z_x", "z_y", "S_xx", "S_xy", "S_yy", "admitted")]
    return OneLane(
        shape,
        False,
        steps,
        of_shape(twist_function(kernels["twist"], places), "twist"),
        of_all(take_tracks_of),
        of_all(sample_inputs),
        of_all(move_inputs),
        rows["report0"],
        np.array([rows[name] for name in (*innovation, *PLACES)]),
    )


def _places(shape: FilterShape) -> LanePlaces:
    layout, rows, constants = shape.layout, shape.layout.rows, shape.layout.constants
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
        np.array([rows[name] for name in OF_RECORD], np.uintp),
        of_gate("gyro"),
        (of_gate(ACCELEROMETERS[0]), of_gate(ACCELEROMETERS[1])),
        rows["position_rejected_for"],
        rows["position_admitted"],
        rows[TWIST[0]],
        rows[MOTION[0]],
        np.array([[rows[f"{axis}_by_{i}"] for i in states] for axis in TWIST[:3]]),
        constants[f"fixed{PARAMETERS}"],
        constants["interval"],
        constants[SLIP_SHARES[0]],
        len(rows),
        len(constants),
    )


# --- functions -----------------------------------------------------------------------------


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
    for k in range(s.PARAMETER_COUNT):
        constants[places.fixed + k] = x[PARAMETERS + k]
    for k in range(len(memory)):
        lane[places.memory + k, 0] = memory[k]


def fill_covariance(lane: Floats, P: Floats, regressors: Floats, places: LanePlaces) -> None:
    """Copy covariance and regressors into the workspace.

    Raises:
        ValueError: an array has the wrong size.
    """
    if P.shape != (places.size, places.size) or regressors.shape != (3, s.PARAMETER_COUNT):
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


def step_with_imu(kernel: Any, places: LanePlaces) -> Any:
    """Make a step with an IMU sample at its end, or at its start."""

    def imu_step(
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

    return imu_step


def step_without_imu(kernel: Any, places: LanePlaces, *, arrives: bool) -> Any:
    """Make a step without an IMU sample, or a part of one.

    Args:
        kernel: the kernel.
        places: places in the workspace.
        arrives: it goes to the end of the step.
    """

    def time_step(
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
        """Draw the fast slip and propagate, or one of these; arguments as in `imu_step`."""
        if inputs.shape != (ROWS, 1):
            raise ValueError(WRONG_SIZE)
        record = records[0]
        fill_state(lane, constants, x, memory, places)
        fill_covariance(lane, P, regressors, places)
        fill_constants(record, lane, constants, stamp, is_first, places)
        lane[places.stood, 0] = 0.0
        kernel(lane, inputs, constants)
        empty_lane(lane, x, P, regressors, memory, places)
        if arrives:
            record.stamp = stamp

    return time_step


def position_update(kernel: Any, places: LanePlaces) -> Any:
    """Make an update with a position fix."""

    def update_position(
        records: Any,
        x: Floats,
        P: Floats,
        regressors: Floats,
        memory: Floats,
        lane: Floats,
        inputs: Floats,
        constants: Floats,
        stamp: int,
        rejected_for: float,
    ) -> Any:
        """Gate and update; return the flags of the kernel, see `fixes.position_kernel`.

        Arguments are as in `imu_step`, and the time of rejected fixes so far [s].
        """
        if inputs.shape != (ROWS, 1):
            raise ValueError(WRONG_SIZE)
        record = records[0]
        fill_state(lane, constants, x, memory, places)
        fill_covariance(lane, P, regressors, places)
        fill_constants(record, lane, constants, stamp, False, places)
        lane[places.position_rejected_for, 0] = rejected_for
        lane[places.position_admitted, 0] = 0.0
        rows = places.of_record
        lane[rows[0], 0], lane[rows[1], 0] = record.slip_factor, record.present_factor
        lane[rows[2], 0], lane[rows[3], 0] = record.trend_forward, record.trend_left
        lane[rows[4], 0], lane[rows[5], 0] = record.trend_size, record.departed_for
        lane[rows[6], 0], lane[rows[7], 0] = record.departed_from_x, record.departed_from_y
        lane[rows[8], 0], lane[rows[9], 0] = record.departed_by_x, record.departed_by_y
        flags = kernel(lane, inputs, constants)
        empty_lane(lane, x, P, regressors, memory, places)
        record.slip_factor, record.present_factor = lane[rows[0], 0], lane[rows[1], 0]
        record.trend_forward, record.trend_left = lane[rows[2], 0], lane[rows[3], 0]
        record.trend_size, record.departed_for = lane[rows[4], 0], lane[rows[5], 0]
        record.departed_from_x, record.departed_from_y = lane[rows[6], 0], lane[rows[7], 0]
        record.departed_by_x, record.departed_by_y = lane[rows[8], 0], lane[rows[9], 0]
        return flags

    return update_position


def twist_function(kernel: Any, places: LanePlaces) -> Any:
    """Make the body velocity with its derivatives."""

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
        """Evaluate the body velocity, see `Ekf.twist_model`.

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

    return evaluate_twist
