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
from icreckon.estimator.engine.fixes import FixKind, position_kernel
from icreckon.estimator.engine.lane import FAST, FilterShape, plain_kernel
from icreckon.estimator.engine.lane_functions import (
    LanePlaces,
    begin_position,
    begin_sample,
    begin_time,
    end_nothing,
    end_position,
    end_sample,
    end_time,
    filter_step,
    move_of,
    sample_loop,
    sample_of,
    scatter_of,
    take_tracks_of,
    twist_function,
)
from icreckon.estimator.engine.layout import (
    FACTORS,
    MOTION,
    PLACES,
    SLIP_SHARES,
    TREND,
    TWIST,
)
from icreckon.estimator.engine.model import TracedModel, described
from icreckon.estimator.engine.step import StepKind, step_kernel, twist_kernel
from icreckon.estimator.filter.filter_record import DEPARTURE
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.sensors.measurement_models import ACCELEROMETERS
from icreckon.estimator.tracing.kernel import Kernel

PARAMETERS, FAST_SLIP = s.PARAMETERS.start, s.FAST_SLIP.start
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
        loop: function that makes the loop over samples, see `lane_functions.sample_loop`.
        twist: body velocity with its derivatives.
        take_tracks: see `lane_functions`, as the others.
        fill_sample: see `lane_functions`.
        fill_move: see `lane_functions`.
        follow_scatter: see `lane_functions`.
        first_report: first of the rows with the changes that a kernel reports.
        position: rows of the innovation of a position fix and its covariance, of the number admitted,
            and of place and yaw before and after it.
    """

    shape: FilterShape
    is_plain: bool
    steps: dict[str, Any]
    loop: Callable[[], Any]
    twist: Any
    take_tracks: Any
    fill_sample: Any
    fill_move: Any
    follow_scatter: Any
    first_report: int
    position: Any


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
    from icreckon.estimator.tracing.jit_kernel import entry, inner, jit

    shape = shape_of(model, considered, wanders)
    digest = hashlib.sha256(repr(shape).encode()).hexdigest()[:12]
    kernels, silent = (
        {name: kernel_on_demand(name, make, 1) for name, make in kernel_makers(one).items()}
        for one in (shape, shape._replace(reports=False))
    )

    def of_shape(function: Any, name: str) -> Any:
        # Functions of one name would share their machine code.
        return entry(function, f"{digest}_{name}")

    def called(function: Any, name: str) -> Any:
        return inner(f"{digest}_{name}")(function)

    found = _functions(shape, kernels, of_shape, _entry, jit)

    @cache
    def loop() -> Any:
        places = places_of(shape)
        imu_step, time_step = (
            called(step_of(name, silent[name], places, jit), name)
            for name in ("imu_step", "time_step")
        )
        return of_shape(sample_loop(imu_step, time_step), "loop")

    return found._replace(loop=loop)


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
    return _functions(shape, kernels, _as_it_is, _as_it_is, _as_it_is)._replace(is_plain=True)


def _as_it_is(function: Any, _name: str = "") -> Any:
    return function


def _functions(
    shape: FilterShape,
    kernels: dict[str, Any],
    of_shape: Callable[[Any, str], Any],
    of_all: Callable[[Any], Any],
    of_callee: Callable[[Any], Any],
) -> OneLane:
    """Make the functions of one lane.

    Args:
        shape: shape of the filter.
        kernels: kernels by name.
        of_shape: compiles a function that depends on the shape, under a name, or returns it as it is.
        of_all: the same of one that does not depend on it.
        of_callee: the same of one that the others call.
    """
    places, rows = places_of(shape), shape.layout.rows
    made = {name: step_of(name, kernels[name], places, of_callee) for name in (*STEPS, *FIXES)}
    steps = {name: of_shape(function, name) for name, function in made.items()}

    def loop() -> Any:
        return sample_loop(made["imu_step"], made["time_step"])

    innovation = [f"position_{part}" for part in ("z_x", "z_y", "S_xx", "S_xy", "S_yy", "admitted")]
    return OneLane(
        shape,
        False,
        steps,
        loop,
        of_shape(twist_function(kernels["twist"], places), "twist"),
        of_all(take_tracks_of),
        of_all(sample_of),
        of_all(move_of),
        of_all(scatter_of),
        rows["report0"],
        np.array([rows[name] for name in (*innovation, *PLACES)]),
    )


def step_of(name: str, kernel: Any, places: LanePlaces, of_callee: Callable[[Any], Any]) -> Any:
    """Make the step or update of a name of `STEPS` or `FIXES`."""
    parts: Any = begin_position, end_position
    if name in STEPS:
        parts = begin_time, end_time if STEPS[name].moves else end_nothing
        parts = (begin_sample, end_sample) if STEPS[name].imu else parts
    return filter_step(kernel, places, *map(of_callee, parts))


def places_of(shape: FilterShape) -> LanePlaces:
    """Places in the workspace of a filter shape."""
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
