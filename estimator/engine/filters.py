"""Many filters of one robot and variant, side by side in the lanes of vector registers."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.errors import BatchError
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.fixes import FixKind, heading_kernel, position_kernel
from icreckon.estimator.engine.lane import FilterShape, idle_kernel
from icreckon.estimator.engine.layout import (
    COUNTS,
    GATES,
    STEP_CONSTANTS,
    TWIST,
    Layout,
    covariance_name,
)
from icreckon.estimator.engine.model import SlipConstants, traced_model
from icreckon.estimator.engine.schedule import (
    AHEAD,
    HEADING,
    MOVE,
    MOVE_AND_UPDATE,
    POSITION,
    LogSteps,
    Steps,
)
from icreckon.estimator.engine.step import StepKind, step_kernel
from icreckon.estimator.engine.work import (
    ESTIMATE,
    LaneKernels,
    Places,
    advance_memory,
    keep_memory,
    lane_worker,
)
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.ekf import REGRESSOR_SMOOTHING
from icreckon.estimator.filter.gate import CHI_SQUARE_1E4
from icreckon.estimator.filter.initial_state import assumptions, considered_states
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.motion.friction_model import FrictionMotion
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.motion.propagation import fading, gauss_markov_noise
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.sensors.held_tracks import smoothing_share
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.tracing.emit import Kernel, kernel_on_demand, lanes_of_machine
from icreckon.estimator.tracing.jit_kernel import jit

# Numbers of so many bits, and what NumPy calls them.
PRECISIONS: dict[int, Any] = {64: np.float64, 32: np.float32}
# Registers are as long as lines of the cache on all machines that have such wide ones [bytes].
LINE = 64


class Lanes(NamedTuple):
    """Filters on their way.

    Attributes:
        workspace: (rows, width) see `BatchFilter.layout`.
        refused: (width, n, 5) position fixes that were refused since one was used.
        refused_count: (width,) how many those are.
        constants: what all of them share, and room for what belongs to a step.
    """

    workspace: Floats
    refused: Floats
    refused_count: Any
    constants: Floats


class BatchFilter:
    """The filters of one robot, variant and settings.

    Args:
        robot: as the filters know it.
        variant: filter variant.
        settings: of the filters.
        bits: of each number: 64, or 32 for twice as many lanes and seven digits.
        width: number of filters side by side; None for as many as the machine's registers hold.

    Attributes:
        robot: the robot.
        settings: the settings.
        width: how many filters run side by side.
        number: the type of their numbers.
        layout: what stands where in the workspace.

    Raises:
        BatchError: the variant's motion model has no traced form.
        EstimatorError: see `PoseEstimator`.
    """

    def __init__(
        self,
        robot: Robot,
        variant: Variant,
        settings: Settings,
        bits: int = 64,
        width: int | None = None,
    ) -> None:
        if bits not in PRECISIONS:
            raise BatchError(f"numbers have 64 or 32 bits, found bits = {bits!r}")
        taken = assumptions(robot, variant, settings)
        model = traced_model(taken.model)
        if model is None:
            raise BatchError(f"the motion model of {variant.name!r} cannot run side by side")
        motion = taken.model
        self._model_constants: Any = motion.constants if isinstance(motion, FrictionMotion) else ()
        self._model, self._state, self._sigmas = taken.model, taken.state, taken.sigmas
        self._disturbances = taken.disturbances
        self.robot, self.settings = robot, settings
        self.width, self.number = width or lanes_of_machine(bits), PRECISIONS[bits]
        self._walks = self._disturbances.bias_walk + self._disturbances.parameter_walk
        uncertain = (self._sigmas > 0.0) | (self._walks > 0.0)
        uncertain[s.POSE] = uncertain[s.SLIP] = True
        uncertain[s.FAST_SLIP] = False
        # Standstill asks for that of the gyro, and a gate that gives in makes the other uncertain.
        uncertain[[s.GYRO_BIAS, s.ACCELEROMETER_BIAS]] = True
        parameters = np.zeros(s.SIZE, dtype=bool)
        parameters[s.PARAMETERS] = True
        absent = parameters & ~uncertain & (self._state == 0.0)
        self.shape = FilterShape(
            tuple(np.flatnonzero(uncertain).tolist()),
            tuple(np.flatnonzero(absent).tolist()),
            model,
            considered_states(variant, settings),
            bits,
        )
        self.layout = self.shape.layout
        self.rows = self.layout.rows
        self._prepared: tuple[Steps, Floats] | None = None
        self._work: Any = None

    def begin(self, first_speeds: Floats, start: Floats, start_sigma: Floats) -> Lanes:
        """Filters that have seen nothing but their first track speeds.

        Args:
            first_speeds: (width, 2) of the left and the right track [m/s].
            start: (3,) x, y [m], yaw [rad].
            start_sigma: (3,) standard deviations.
        """
        lanes = aligned(len(self.rows) * self.width, self.number).reshape(-1, self.width)
        state, sigmas = self._state.copy(), self._sigmas.copy()
        state[s.POSE], sigmas[s.POSE] = start, start_sigma
        for i in self.shape.states:
            lanes[self.rows[f"x{i}"]] = state[i]
            lanes[self.rows[f"P{i}_{i}"]] = sigmas[i] ** 2
        eta = self._model.steering_efficiency(state[s.PARAMETERS])
        for lane, (left, right) in enumerate(first_speeds.tolist()):
            slip = self._disturbances.slip_of(left, right, eta)
            for axis in range(3):
                row = self.rows[f"P{s.SLIP_X + axis}_{s.SLIP_X + axis}"]
                lanes[row, lane] += slip[axis] ** 2
        most = self.settings.gates.patience + 2
        refused = np.zeros((self.width, most, 5))
        counts = np.zeros(self.width, dtype=np.int64)
        constants = shared_constants(
            self.shape, self._model, self._disturbances, self.robot, self.settings, self._state
        )
        memory = self._model.memory
        for k, value in enumerate(memory):
            lanes[self.rows[f"memory{k}"]] = value
        return Lanes(lanes, refused, counts, constants)

    def take_over(self, lanes: Lanes, memory: FilterCheckpoint, regressors: Floats) -> None:
        """Let all lanes go on from what the streaming filter knows at its first track speeds.

        Args:
            lanes: from `begin`.
            memory: of the filter.
            regressors: (3, 8) the derivatives by the parameters that it goes by.

        Raises:
            BatchError: more fixes were refused than there is room for.
        """
        refused, rows, workspace = memory.rejected_fixes, self.rows, lanes.workspace
        if len(refused) + 2 > lanes.refused.shape[1]:
            raise BatchError(f"{len(refused)} fixes before the first track speeds were refused")
        states = (*self.shape.states, *range(s.FAST_SLIP.start, s.FAST_SLIP.stop))
        for n, i in enumerate(states):
            workspace[rows[f"x{i}"]] = memory.state[i]
            for j in states[n:]:
                workspace[rows[covariance_name(i, j)]] = memory.covariance[i, j]
        for axis in range(3):
            for i in self.layout.parameters:
                workspace[rows[f"r{axis}_{i}"]] = regressors[axis, i - s.PARAMETERS.start]
        for k, value in enumerate(memory.model):
            workspace[rows[f"memory{k}"]] = value
        workspace[rows["stood"]] = memory.stands
        for gate in GATES:
            workspace[rows[f"{gate}_row"]] = memory.rejected_in_a_row[gate]
        lanes.refused[:, : len(refused)] = np.array(refused).reshape(-1, 5)
        lanes.refused_count[:] = len(refused)

    def work_through(
        self,
        lanes: Lanes,
        inputs: Floats,
        steps: Steps,
        table: Floats,
        estimates: Floats,
        *,
        all_told: bool = False,
    ) -> None:
        """Work through some steps; the lanes go on in place.

        Args:
            lanes: from `begin`.
            inputs: (n, rows, width) what each step is told, see `estimator.engine.layout`.
            steps: (n,) the steps, of a run that it is prepared for.
            table: (n, k) of `prepare`.
            estimates: (ticks, rows, width) written to: pose, twist and their covariances at the ticks; of
                the first lanes, where it is less wide.
            all_told: whether the estimates have more rows, those of `Layout.told`.

        Raises:
            ValueError: an array has the wrong size, or does not begin where a register's worth of memory
                does.
        """
        workspace, per_lane = lanes.workspace, (lanes.workspace, inputs)
        if workspace.shape[1] != self.width or any(a.ctypes.data % LINE for a in per_lane):
            raise ValueError(WRONG_SIZE)
        self._work(
            workspace,
            inputs,
            lanes.constants,
            table,
            steps.kinds,
            steps.extras,
            steps.ticks - (steps.ticks[0] if len(steps.ticks) else 0),
            estimates,
            lanes.refused,
            lanes.refused_count,
            self._model_constants,
            _places(self.layout, all_told),
        )

    def state(
        self, lanes: Lanes, lane: int, *, with_fast_slip: bool = False
    ) -> tuple[Floats, Floats]:
        """State (SIZE,) and covariance (SIZE, SIZE) of one filter.

        Args:
            lanes: from `begin`.
            lane: which filter.
            with_fast_slip: the last step has output its estimate, and with it the fast slip.
        """
        x, P = self._state.copy(), np.zeros((s.SIZE, s.SIZE))
        fast = range(s.FAST_SLIP.start, s.FAST_SLIP.stop) if with_fast_slip else ()
        states = (*self.shape.states, *fast)
        for n, i in enumerate(states):
            x[i] = lanes.workspace[self.rows[f"x{i}"], lane]
            for j in states[n:]:
                P[i, j] = P[j, i] = lanes.workspace[self.rows[covariance_name(i, j)], lane]
        return x, P

    def stood(self, lanes: Lanes, lane: int) -> bool:
        """Return True if a filter found its robot standing at the newest IMU sample."""
        return bool(lanes.workspace[self.rows["stood"], lane])

    def model_memory(self, lanes: Lanes, lane: int) -> Floats:
        """Memory (m,) of the motion model of a filter."""
        rows = [self.rows[f"memory{k}"] for k in range(self.shape.model.memory)]
        return np.asarray(lanes.workspace[np.array(rows, dtype=int), lane])

    def regressors(self, lanes: Lanes, lane: int, before: Floats) -> Floats:
        """Smoothed derivatives (3, 8) of a filter; those of other parameters as before."""
        found = before.copy()
        for axis in range(3):
            for i in self.layout.parameters:
                row = self.rows[f"r{axis}_{i}"]
                found[axis, i - s.PARAMETERS.start] = lanes.workspace[row, lane]
        return found

    def counts(self, lanes: Lanes) -> dict[str, Floats]:
        """Name from `estimator.engine.layout.COUNTS` -> (width,) what was counted."""
        return {name: lanes.workspace[self.rows[name]].copy() for name in COUNTS}

    def prepare(self, steps: Steps) -> Floats:
        """Get ready for a run: compile what its steps need, unless that is there already.

        Args:
            steps: all of the run.

        Returns:
            (n, k) what belongs to each step, for `work_through`.

        Raises:
            BatchError: there are fixes between IMU samples, and inertia is that with the slip; or the IMU
                is silent for longer than `Settings.hold`.
        """
        longest = float(steps.intervals.max(initial=0.0))
        if longest > self.settings.hold:
            raise BatchError(
                f"the IMU is silent for {longest:.2f} s, longer than Settings.hold, which filters side "
                "by side cannot bridge; use run"
            )
        if self._prepared is None or self._prepared[0] is not steps:
            self.compile_for(steps)
            self._prepared = steps, self._step_constants(steps)
        return self._prepared[1]

    def compile_for(self, steps: Steps | LogSteps) -> None:
        """Compile what the steps of a run need, unless that is there already.

        Args:
            steps: all of the run.

        Raises:
            BatchError: there are fixes between IMU samples, and inertia is that with the slip.
        """
        ahead, fixes = steps.kinds == AHEAD, (steps.extras & POSITION) > 0
        moves, at_steps, on_the_way = (
            bool(one.any()) for one in (steps.kinds == MOVE, fixes & ~ahead, ahead)
        )
        needs = Needs(
            accelerometer=self.settings.use_accelerometer,
            heading=bool((steps.extras & HEADING).any()),
            fixes=at_steps,
            ahead=on_the_way,
            moves=moves,
        )
        if isinstance(steps, LogSteps):
            # The next log may have its stamps elsewhere; what it needs is there then.
            needs = needs._replace(moves=True, ahead=False, fixes=False)
            needs = needs._replace(told=True, fixes_told=at_steps or on_the_way)
        if self.shape.model.slip_in_inertia and on_the_way:
            raise BatchError(
                "with inertia = 'imu', filters side by side take fixes at the stamps of IMU samples only"
            )
        self._work = _worker(self.shape, self.width, needs)

    @property
    def time_constant(self) -> float:
        """Of the slip [s]."""
        return self._disturbances.slip.time_constant

    @property
    def start(self) -> Floats:
        """(SIZE,) the state before anything is known; what is not uncertain stays so."""
        return self._state.copy()

    def _step_constants(self, steps: Steps) -> Floats:
        """What belongs to each step, the interval of the IMU last."""
        tau = self._disturbances.slip.time_constant
        table = np.zeros((len(steps.starts), len(STEP_CONSTANTS) + 1))
        elapsed = steps.ends - steps.starts
        for each in np.unique(elapsed).tolist():
            dt = each * NANOSECOND
            decay, mean = fading(dt, tau)
            share = smoothing_share(dt, REGRESSOR_SMOOTHING)
            row = (dt, share, decay, mean, *gauss_markov_noise(dt, tau))
            table[elapsed == each, :-1] = row
        moving = np.flatnonzero((steps.kinds == MOVE_AND_UPDATE) | (steps.kinds == MOVE))
        if len(moving) and steps.starts[0] == 0:
            # There is nothing to smooth yet.
            table[moving[0], STEP_CONSTANTS.index("share")] = 1.0
        table[:, -1] = steps.intervals
        return table


def shared_constants(
    shape: FilterShape,
    model: MotionModel,
    disturbances: Disturbances,
    robot: Robot,
    settings: Settings,
    state: Floats,
) -> Floats:
    """Constants that all lanes share, with room for those of a step.

    Args:
        shape: shape of the filter.
        model: its motion model.
        disturbances: its process noise.
        robot: its robot.
        settings: its settings.
        state: (SIZE,) values of the states that are not uncertain.
    """
    names = shape.layout.constants
    values: Floats = aligned(len(names), PRECISIONS[shape.bits])
    slip, sensors = disturbances.slip, SensorModels(robot).constants
    walks = disturbances.bias_walk + disturbances.parameter_walk
    known = {
        **model.vehicle._asdict(),
        "eta": model.eta if isinstance(model, FrictionMotion) else 0.0,
        **{name: getattr(slip, name) for name in SlipConstants._fields},
        "gyro_density": sensors.gyro_density,
        "accelerometer_density": sensors.accelerometer_density,
        "imu_x": sensors.x,
        "imu_y": sensors.y,
        "threshold": CHI_SQUARE_1E4[1],
        "position_threshold": CHI_SQUARE_1E4[2],
        "patience": settings.gates.patience,
        "bias_margin": settings.standstill.bias_margin,
        **{f"fixed{i}": value for i, value in enumerate(state)},
        **{f"walk{i}": value for i, value in enumerate(walks)},
    }
    for row, bound in enumerate(model.bounds):
        known |= {f"bound{row}_{k}": value for k, value in enumerate(bound)}
    for name, value in known.items():
        values[names[name]] = value
    return values


def aligned(count: int, number: Any = np.float64) -> Any:
    """Zeros (count,) of a type that begin where a register's worth of memory does."""
    size = np.dtype(number).itemsize
    room = np.zeros(count + LINE // size, dtype=number)
    skip = (-room.ctypes.data % LINE) // size
    return room[skip : skip + count]


@cache
def _places(layout: Layout, all_told: bool) -> Places:
    rows, more = layout.rows, layout.told if all_told else ()
    pose = [rows[f"x{i}"] for i in range(3)]
    spread = [rows[covariance_name(i, j)] for i in range(3) for j in range(i, 3)]
    fast = range(s.FAST_SLIP.start, s.FAST_SLIP.stop)
    states = (*layout.states, *fast)

    def place(state: int) -> int:
        return rows[f"x{state}"] if state in layout.states else -1

    with_pose = [[rows[covariance_name(i, j)] for j in states] for i in range(3)]
    return Places(
        np.array([*pose, *spread, *(rows[name] for name in (*TWIST, *more))]),
        np.array(with_pose),
        rows["position_row"],
        rows["position_used"],
        rows["believed_x"],
        rows["believed_y"],
        layout.constants["interval"],
        np.array([rows[f"memory{k}"] for k in range(layout.model.memory)], dtype=np.int64),
        np.array([place(i) for i in range(s.PARAMETERS.start, s.PARAMETERS.stop)]),
        layout.constants[f"fixed{s.PARAMETERS.start}"],
        place(s.TRACK_SCALE),
        len(rows),
        len(layout.constants),
    )


class Needs(NamedTuple):
    """What the steps of a run need besides the usual.

    Attributes:
        accelerometer: whether specific forces are used.
        heading: whether fixes have headings.
        fixes: whether there are fixes at the end of steps.
        ahead: whether there are fixes between IMU samples.
        moves: whether steps end without an IMU sample.
        told: whether estimates are wanted there.
        fixes_told: whether estimates are wanted after fixes, wherever they are.
    """

    accelerometer: bool
    heading: bool
    fixes: bool
    ahead: bool
    moves: bool
    told: bool = False
    fixes_told: bool = False


@cache
def _worker(shape: FilterShape, width: int, needs: Needs) -> Any:
    """The compiled function that works through steps; what is not needed does nothing in it."""
    force = needs.accelerometer
    move = StepKind(imu=False, accelerometer=False)
    steps = {
        "usual": StepKind(accelerometer=force),
        "full": StepKind(stands=True, accelerometer=force).reporting(),
        "update": StepKind(moves=False, stands=True, accelerometer=force).reporting(),
        "move": move if needs.moves else None,
        "move_told": move.reporting() if needs.told else None,
    }
    fixes = {
        "": FixKind() if needs.fixes else None,
        "_told": FixKind(tells=True) if needs.fixes or needs.fixes_told else None,
        "_ahead": FixKind(ahead=True) if needs.ahead else None,
        "_ahead_told": FixKind(tells=True, ahead=True) if needs.fixes_told else None,
    }
    makers: dict[str, Callable[[], Kernel]] = {}
    for name, step in steps.items():
        makers[name] = partial(_step_or_nothing, name, shape, step)
    for name, fix in fixes.items():
        position, heading = f"position{name}", f"heading{name}"
        makers[position] = partial(_fix_or_nothing, position_kernel, position, shape, fix)
        headed = fix if needs.heading else None
        makers[heading] = partial(_fix_or_nothing, heading_kernel, heading, shape, headed)
    compiled = {
        name: kernel_on_demand(name, make, width, shape.bits) for name, make in makers.items()
    }
    made = hashlib.sha256(repr((shape, width, needs)).encode()).hexdigest()[:12]
    advance = jit(advance_memory if shape.model.memory else keep_memory)
    return lane_worker(LaneKernels(**compiled), advance, made)


def _step_or_nothing(name: str, shape: FilterShape, kind: StepKind | None) -> Kernel:
    return idle_kernel(name, shape) if kind is None else step_kernel(name, shape, kind)


def _fix_or_nothing(
    make: Callable[[str, FilterShape, FixKind], Kernel],
    name: str,
    shape: FilterShape,
    kind: FixKind | None,
) -> Kernel:
    return idle_kernel(name, shape) if kind is None else make(name, shape, kind)


assert len(ESTIMATE) == 3 + 6 + len(TWIST)  # noqa: S101 - one is written as the other
