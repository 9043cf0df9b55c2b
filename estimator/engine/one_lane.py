"""Steps of one filter, on its state and covariance.

The kernels are those of many filters side by side, at one lane; they report all changes. State and
covariance are copied to the workspace of a kernel before each call, and back afterwards. The functions
are compiled, or executed in Python (`Settings.engine`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.records import record_array
from icreckon.estimator.engine.fixes import FixKind, position_kernel
from icreckon.estimator.engine.lane import FAST, FilterShape, plain_kernel
from icreckon.estimator.engine.lane_functions import (
    BEGIN,
    EVALUATION,
    IMU_STEP,
    IMU_UPDATE,
    MOST_STATES,
    POSITION,
    POSITION_AHEAD,
    PROPAGATE,
    SILENT_IMU_STEP,
    SILENT_TIME_STEP,
    TIME_STEP,
    LanePlaces,
    evaluate_twist,
    feed_samples,
    move_of,
    sample_of,
    scatter_of,
    take_step,
    take_tracks_of,
)
from icreckon.estimator.engine.layout import (
    FACTORS,
    MOTION,
    PLACES,
    SLIP_SHARES,
    TREND,
    TWIST,
    covariance_name,
)
from icreckon.estimator.engine.model import TracedModel, described
from icreckon.estimator.engine.step import StepKind, step_kernel, twist_kernel
from icreckon.estimator.filter.filter_record import DEPARTURE
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.sensors.measurement_models import IMU_SENSORS
from icreckon.estimator.tracing.kernel import Kernel

PARAMETERS, FAST_SLIP = s.PARAMETERS.start, s.FAST_SLIP.start
# Steps of a filter that reports its changes: with an IMU sample at its end, and at its start; without
# one; its two halves; and position fixes, at its end and ahead of it.
OF_SAMPLE = StepKind(stands=True, may_lack_force=True, innovations=True, fast_slip=True)
OF_TIME = StepKind(imu=False, accelerometer=False, fast_slip=True)
STEPS = {
    IMU_STEP: ("imu_step", OF_SAMPLE),
    IMU_UPDATE: ("imu_update", OF_SAMPLE._replace(draws=False, moves=False, resumes=True)),
    SILENT_IMU_STEP: ("silent_imu_step", OF_SAMPLE),
    TIME_STEP: ("time_step", OF_TIME),
    BEGIN: ("begin", OF_TIME._replace(moves=False)),
    PROPAGATE: ("propagate", OF_TIME._replace(draws=False, resumes=True)),
    SILENT_TIME_STEP: ("silent_time_step", OF_TIME),
}
FIXES = {
    POSITION: ("position", FixKind(fast_slip=True)),
    POSITION_AHEAD: ("position_ahead", FixKind(fast_slip=True, ahead=True)),
}
SILENT = (SILENT_IMU_STEP, SILENT_TIME_STEP)
# Rows that the record of a filter holds.
OF_RECORD = (*FACTORS, *TREND, *DEPARTURE)


class OneLane(NamedTuple):
    """Functions of one filter shape at one lane, see `lane_functions`.

    Attributes:
        shape: shape of the filter.
        is_plain: the functions are executed in Python.
        places: (1,) `LanePlaces`.
        prepare_loop: compiles the kernels of `feed_samples`, to be called before it.
        take_step: see above, as the others.
        feed_samples: see above.
        evaluate_twist: see above.
        take_tracks: see above.
        fill_sample: see above.
        fill_move: see above.
        follow_scatter: see above.
        first_report: first of the rows with the changes that a kernel reports.
        position: rows of the innovation of a position fix and its covariance, of the number admitted,
            and of place and yaw before and after it.
    """

    shape: FilterShape
    is_plain: bool
    places: Any
    prepare_loop: Callable[[], None]
    take_step: Any
    feed_samples: Any
    evaluate_twist: Any
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

    Every parameter, bias and scale is a state, so that all variants of a model share the kernels. A model
    that has no traced form is computed in Python.

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


def kernel_of(which: int, shape: FilterShape) -> tuple[Callable[..., Kernel], tuple[Any, ...]]:
    """Function that makes a kernel of `lane_functions`, and its arguments."""
    if which == EVALUATION:
        return twist_kernel, ("twist", shape)
    if which in FIXES:
        name, kind = FIXES[which]
        return position_kernel, (name, shape, kind)
    named, step = STEPS[which]
    return step_kernel, (named, shape._replace(reports=which not in SILENT), step)


@cache
def _compiled(model: TracedModel, considered: tuple[int, ...], wanders: bool) -> OneLane:
    from icreckon.estimator.tracing.jit_kernel import entry
    from icreckon.estimator.tracing.machine_code import address_of

    shape = shape_of(model, considered, wanders)
    usual = [which for which in (*STEPS, *FIXES, EVALUATION) if which not in SILENT]
    kernels = np.zeros(EVALUATION + 1, np.uint64)
    kernels[usual] = [address_of(*kernel_of(which, shape), 1) for which in usual]
    places = record_array(places_of(shape, kernels), 1)

    def prepare_loop() -> None:
        for which in SILENT:
            places["kernels"][0, which] = address_of(*kernel_of(which, shape), 1)

    return _functions(shape, places, entry)._replace(prepare_loop=prepare_loop)


def _plain(
    model: TracedModel,
    considered: tuple[int, ...],
    wanders: bool,
    of_user: MotionModel | None,
) -> OneLane:
    shape = shape_of(model, considered, wanders)

    def plain(which: int) -> Any:
        make, arguments = kernel_of(which, shape)
        return plain_kernel(lambda numbers: make(*arguments, numbers=numbers), of_user)

    places = [places_of(shape, [plain(which) for which in range(EVALUATION + 1)])]
    return _functions(shape, places, lambda function: function)._replace(is_plain=True)


def _functions(shape: FilterShape, places: Any, compiled: Callable[[Any], Any]) -> OneLane:
    """Make the functions of one lane.

    Args:
        shape: shape of the filter.
        places: (1,) `LanePlaces`.
        compiled: compiles a function, or returns it as it is.
    """
    rows = shape.layout.rows
    innovation = [f"position_{part}" for part in ("z_x", "z_y", "S_xx", "S_xy", "S_yy", "admitted")]
    return OneLane(
        shape,
        False,
        places,
        lambda: None,
        compiled(take_step),
        compiled(feed_samples),
        compiled(evaluate_twist),
        compiled(take_tracks_of),
        compiled(sample_of),
        compiled(move_of),
        compiled(scatter_of),
        rows["report0"],
        np.array([rows[name] for name in (*innovation, *PLACES)]),
    )


def places_of(shape: FilterShape, kernels: Any) -> LanePlaces:
    """Places in the workspace of a filter shape, with its kernels."""
    layout, rows, constants = shape.layout, shape.layout.rows, shape.layout.constants
    states, parameters = (*shape.states, *FAST), layout.parameters

    def padded(values: Any) -> Any:
        found = np.array(values, np.uint64)
        return np.pad(found, [(0, MOST_STATES - count) for count in found.shape])

    by_state = [padded([rows[f"{axis}_by_{i}"] for i in states]) for axis in TWIST[:3]]
    gate = ("rejected_for", "admitted", "z", "S")
    memory = shape.model.memory
    return LanePlaces(
        kernels,
        max(states) + 1,
        len(states),
        len(parameters),
        padded(states),
        padded(parameters),
        padded([rows[f"x{i}"] for i in states]),
        padded([[rows[covariance_name(i, j)] for j in states] for i in states]),
        np.array(by_state),
        rows[f"r0_{parameters[0]}"],
        rows["memory0"] if memory else 0,
        memory,
        rows["stood"],
        rows["slip_factor"],
        np.array([rows[name] for name in OF_RECORD], np.uint64),
        np.array([[rows[f"{name}_{part}"] for part in gate] for name in IMU_SENSORS], np.uint64),
        rows["position_rejected_for"],
        rows["position_admitted"],
        rows[TWIST[0]],
        rows[MOTION[0]],
        constants[f"fixed{PARAMETERS}"],
        constants["interval"],
        constants[SLIP_SHARES[0]],
        len(rows),
        len(constants),
    )
