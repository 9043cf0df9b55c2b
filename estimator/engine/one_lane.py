"""Steps of one filter, on its state and covariance.

The kernels are those of many filters side by side, at one lane; they report all changes. State and
covariance are copied to the workspace of a kernel before each call, and back afterwards. The functions
are compiled, or executed in Python (`Settings.engine`).
"""

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
    DRIVING_STEP,
    EVALUATION,
    IMU_STEP,
    IMU_UPDATE,
    MOST_STATES,
    POSITION,
    POSITION_AHEAD,
    PROPAGATE,
    TIME_STEP,
)
from icreckon.estimator.engine.layout import (
    FACTORS,
    MOTION,
    SLIP_SHARES,
    TREND,
    TWIST,
    covariance_name,
)
from icreckon.estimator.engine.model import described
from icreckon.estimator.engine.step import StepKind, step_kernel, twist_kernel
from icreckon.estimator.filter.filter_record import ALIKE_FIXES, DEPARTURE
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.sensors.measurement_models import IMU_SENSORS
from icreckon.estimator.tracing.kernel import Kernel

PARAMETERS, FAST_SLIP = s.PARAMETERS.start, s.FAST_SLIP.start
# Steps of a filter that reports its changes, in the order of `lane_functions`; and position fixes.
OF_SAMPLE = StepKind(may_stand=True, innovations=True, fast_slip=True)
OF_TIME = StepKind(imu=False, accelerometer=False, fast_slip=True)
STEPS = {
    DRIVING_STEP: ("driving_step", OF_SAMPLE._replace(may_stand=False)),
    IMU_STEP: ("imu_step", OF_SAMPLE),
    IMU_UPDATE: ("imu_update", OF_SAMPLE._replace(draws=False, moves=False, resumes=True)),
    TIME_STEP: ("time_step", OF_TIME),
    BEGIN: ("begin", OF_TIME._replace(moves=False)),
    PROPAGATE: ("propagate", OF_TIME._replace(draws=False, resumes=True)),
}
FIXES = {
    POSITION: ("position", FixKind(fast_slip=True)),
    POSITION_AHEAD: ("position_ahead", FixKind(fast_slip=True, ahead=True)),
}
OF_RECORD = (*FACTORS, *TREND, *DEPARTURE, *ALIKE_FIXES)  # rows that the record of a filter holds


class LanePlaces(NamedTuple):
    """Places in the workspace of one lane, and its kernels.

    Arrays by states have zeros behind the last one.
    """

    kernels: Any  # (9,) kernels, or addresses of their machine code
    size: int  # number of states of the filter
    state_count: int  # number of uncertain states
    parameter_count: int  # number of uncertain parameters
    states: Any  # (`MOST_STATES`,) indices of the uncertain states, the fast slip last
    parameters: Any  # (`MOST_STATES`,) indices of the uncertain parameters
    x: Any  # (`MOST_STATES`,) rows of the states
    P: Any  # (`MOST_STATES`, `MOST_STATES`) rows of the covariance
    by_state: Any  # (3, `MOST_STATES`) rows of the twist's derivatives by the states
    regressors: int  # row of the first regressor; the row of the turn is behind them
    memory: int  # row of the first number of the model's memory
    memory_size: int  # number of numbers of the memory
    stood: int  # row that is 1 if the robot was found standing
    slip_factor: int  # row of the factor on the slip
    of_record: Any  # (13,) rows of `OF_RECORD`
    # (3, 4) rows of gyro and accelerometers, forward and left: time of rejections, number admitted,
    # innovation, its variance
    imu_gates: Any
    position_rejected_for: int  # row of the time of rejected position fixes
    position_admitted: int  # row of the number of admitted ones
    twist: int  # row of the twist's first component
    motion: int  # row of the first value of `MOTION`
    fixed: int  # place of the first parameter among the constants
    interval: int  # place of the interval of the IMU among them
    slip_shares: int  # place of the first factor on the slip of an evaluated twist among them
    row_count: int  # number of rows
    constant_count: int  # number of constants


class OneLane(NamedTuple):
    """Filter shape at one lane."""

    shape: FilterShape  # shape of the filter
    places: Any  # (1,) `LanePlaces`
    # compiles a function of `lane_functions`; None if they are executed in Python
    compiled: Callable[[Any], Any] | None

    def direct(self, function: Callable[..., Any]) -> Any:
        """Return a function of `lane_functions` to call often, compiled if the others are."""
        if self.compiled is None:
            return function
        from icreckon.estimator.tracing.jit_kernel import direct_entry

        return direct_entry(function)


def one_lane(
    model: MotionModel, considered: tuple[int, ...], *, wanders: bool, compiles: bool
) -> OneLane:
    """Make the kernels of a motion model for one lane.

    Every parameter, bias and scale is a state, so that all variants of a model share the kernels. The
    wander of position fixes is one, too, if the filter `wanders`. Kernels are compiled if it `compiles`
    and the model has a traced form; otherwise Python executes them.
    """
    traced = described(model)
    parameters = (PARAMETERS + k for k in traced.parameters)
    others = (i for i in range(FAST_SLIP) if not PARAMETERS <= i < s.PARAMETERS.stop)
    wander = (s.WANDER_X, s.WANDER_Y) if wanders else ()
    states = tuple(sorted((*others, *parameters, *wander)))
    shape = FilterShape(states, (), traced, considered, reports=True)
    if traced.kind == "plain":
        return _plain(shape, of_user=model)
    return _compiled(shape) if compiles else _plain(shape)


def kernel_maker(number: int, shape: FilterShape) -> tuple[Callable[..., Kernel], tuple[Any, ...]]:
    """Function that makes kernel `number` of `lane_functions`, and its arguments."""
    if number == EVALUATION:
        return twist_kernel, ("twist", shape)
    if number in FIXES:
        name, kind = FIXES[number]
        return position_kernel, (name, shape, kind)
    named, step = STEPS[number]
    return step_kernel, (named, shape, step)


@cache
def _compiled(shape: FilterShape) -> OneLane:
    """Compile the kernels of a shape, or load them, with their places."""
    from icreckon.estimator.tracing.jit_kernel import entry
    from icreckon.estimator.tracing.machine_code import address_of

    kernels = [address_of(*kernel_maker(number, shape), 1) for number in range(EVALUATION + 1)]
    return OneLane(shape, record_array(lane_places(shape, np.array(kernels)), 1), entry)


def _plain(shape: FilterShape, of_user: MotionModel | None = None) -> OneLane:
    """Make kernels that Python executes; for `of_user` see `PlainNumbers`."""

    def plain(number: int) -> Any:
        make, arguments = kernel_maker(number, shape)
        return plain_kernel(lambda numbers: make(*arguments, numbers=numbers), of_user)

    kernels = [plain(number) for number in range(EVALUATION + 1)]
    return OneLane(shape, [lane_places(shape, kernels)], None)


def lane_places(shape: FilterShape, kernels: Any) -> LanePlaces:
    """Places in the workspace of a filter shape, with its kernels."""
    layout, rows, constants = shape.layout, shape.layout.rows, shape.layout.constants
    states, parameters = (*shape.states, *FAST), layout.parameters

    def padded(values: Any) -> Any:
        indices = np.array(values, np.uint64)  # unsigned: compiled code tests no sign
        return np.pad(indices, [(0, MOST_STATES - count) for count in indices.shape])

    by_state = [padded([rows[f"{axis}_by_{i}"] for i in states]) for axis in TWIST[:3]]
    gate = ("rejected_for", "admitted", "z", "S")
    memory = shape.model.memory
    gate_rows = [[rows[f"{name}_{part}"] for part in gate] for name in IMU_SENSORS]
    return LanePlaces(
        kernels=kernels,
        size=max(states) + 1,
        state_count=len(states),
        parameter_count=len(parameters),
        states=padded(states),
        parameters=padded(parameters),
        x=padded([rows[f"x{i}"] for i in states]),
        P=padded([[rows[covariance_name(i, j)] for j in states] for i in states]),
        by_state=np.array(by_state),
        regressors=layout.regressors,
        memory=rows["memory0"] if memory else 0,
        memory_size=memory,
        stood=rows["stood"],
        slip_factor=rows["slip_factor"],
        of_record=np.array([rows[name] for name in OF_RECORD], np.uint64),
        imu_gates=np.array(gate_rows, np.uint64),
        position_rejected_for=rows["position_rejected_for"],
        position_admitted=rows["position_admitted"],
        twist=rows[TWIST[0]],
        motion=rows[MOTION[0]],
        fixed=constants[f"fixed{PARAMETERS}"],
        interval=constants["interval"],
        slip_shares=constants[SLIP_SHARES[0]],
        row_count=len(rows),
        constant_count=len(constants),
    )
