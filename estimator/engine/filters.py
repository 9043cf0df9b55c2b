"""Filters of one robot and variant, side by side in lanes of vector registers."""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import WRONG_SIZE, BatchError
from icreckon.estimator.base.records import record_array
from icreckon.estimator.engine.constants import (
    LINE,
    PRECISIONS,
    aligned,
    all_walks,
    shared_constants,
)
from icreckon.estimator.engine.fixes import FixKind, heading_kernel, position_kernel
from icreckon.estimator.engine.lane import FilterShape
from icreckon.estimator.engine.layout import COUNTS, INPUTS, PLACES, TWIST, Layout, covariance_name
from icreckon.estimator.engine.model import traced_model
from icreckon.estimator.engine.schedule import (
    HEADING,
    MOVE,
    POSITION,
    STEP_COLUMNS,
    TICK,
    Steps,
    fill_step_constants,
)
from icreckon.estimator.engine.step import StepKind, step_kernel
from icreckon.estimator.engine.work import ESTIMATE, LaneKernels, Places, time_of_fix, work_through
from icreckon.estimator.filter.fault_table import OWN_FAULTS
from icreckon.estimator.filter.filter_record import FixesRecord
from icreckon.estimator.filter.initial_state import assumptions, considered_states
from icreckon.estimator.filter.process_noise import slip_at
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import FixWander, Settings, wander_of
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.tracing.emit import lanes_of_machine
from icreckon.estimator.tracing.jit_kernel import entry
from icreckon.estimator.tracing.machine_code import address_of


class Lanes(NamedTuple):
    """Filters side by side in the course of their runs."""

    workspace: Floats  # (rows, width) see `BatchFilter.layout`
    fixes: Any  # (width,) `FixesRecord` of each
    constants: Floats  # constants that all lanes share, with room for those of a step


class BatchFilter:
    """Filters of one robot, variant and settings, side by side.

    Args:
        robot: the robot.
        variant: filter variant.
        settings: settings of the filters.
        bits: number of bits of each number: 64, or 32 for twice as many lanes and seven digits.
        width: number of filters side by side; None for as many as the machine's registers hold.

    Attributes:
        number: type of their numbers.
        layout: layout of the workspace.

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
        if OWN_FAULTS:
            raise BatchError(
                "filters side by side do not watch for faults of your own; call remove_fault"
            )
        if bits not in PRECISIONS:
            raise BatchError(f"numbers have 64 or 32 bits, found bits = {bits!r}")
        self._wander = wander_of(robot, settings)
        assumed = assumptions(robot, variant, settings)
        self._model, self._prior, self._sigmas, self._disturbances = assumed
        model = traced_model(self._model)
        if model is None:
            raise BatchError(f"the motion model of {variant.name!r} cannot run side by side")
        self.robot, self.variant, self.settings = robot, variant, settings
        self._uses_force = settings.use_accelerometer and variant.accelerometers
        self.width, self.number = width or lanes_of_machine(bits), PRECISIONS[bits]
        self._walks = all_walks(self._disturbances)
        wanders = self._wander.sigma > 0.0
        uncertain = (self._sigmas > 0.0) | (self._walks > 0.0)
        uncertain[s.POSE] = uncertain[s.SLIP] = True
        uncertain[s.FAST_SLIP] = False
        # Standstill uses the variance of the gyro's bias, re-acquisition inflates the accelerometers'.
        uncertain[[s.GYRO_BIAS, s.ACCELEROMETER_BIAS_X, s.ACCELEROMETER_BIAS_Y]] = True
        uncertain[s.GRAVITY], uncertain[s.Z] = True, False
        parameters = np.zeros(s.SIZE, dtype=bool)
        parameters[s.PARAMETERS] = True
        absent = parameters & ~uncertain & (self._prior == 0.0)
        self.shape = FilterShape(
            (*np.flatnonzero(uncertain).tolist(), *([s.WANDER_X, s.WANDER_Y] * wanders)),
            tuple(np.flatnonzero(absent).tolist()),
            model,
            considered_states(variant, settings),
            bits,
        )
        self.layout = self.shape.layout
        self.rows = self.layout.rows
        self._prepared: tuple[Steps, Floats] | None = None
        self._kernels = LaneKernels()

    def __reduce__(self) -> Any:
        # Addresses of machine code are those of one process.
        arguments = self.robot, self.variant, self.settings, self.shape.bits, self.width
        return BatchFilter, arguments

    def begin(self, first_speeds: Floats, start: Floats, start_sigma: Floats) -> Lanes:
        """Start all lanes at their first track speeds (width, 2): left, right [m/s].

        `start` (3,) is the pose x, y [m], yaw [rad], `start_sigma` (3,) its standard deviations.
        """
        rows = self.rows
        workspace = aligned(len(rows) * self.width, self.number).reshape(-1, self.width)
        self._write_start(workspace, start, start_sigma)
        self._add_first_slip(workspace, first_speeds)
        for name in ("slip_factor", "present_factor", "trend_size"):
            workspace[rows[name]] = 1.0
        for k, value in enumerate(self._model.memory):
            workspace[rows[f"memory{k}"]] = value
        constants = shared_constants(
            self.shape, self._model, self._disturbances, self.robot, self.settings, self._prior
        )
        return Lanes(workspace, record_array(FixesRecord(), self.width), constants)

    def _write_start(self, workspace: Floats, start: Floats, start_sigma: Floats) -> None:
        """Write the initial states and variances: prior, start pose and wander of fixes."""
        state = np.append(self._prior, [0.0] * 2)
        state[s.POSE] = start
        sigmas = np.append(self._sigmas, [self._wander.sigma] * 2)
        sigmas[s.POSE] = start_sigma
        for i in self.shape.states:
            workspace[self.rows[f"x{i}"]] = state[i]
            workspace[self.rows[f"P{i}_{i}"]] = sigmas[i] ** 2

    def _add_first_slip(self, workspace: Floats, first_speeds: Floats) -> None:
        """Add the variance of the slip to each lane: the robot may be moving already."""
        slip, gauge = self._disturbances.slip, self.robot.vehicle.track_gauge
        eta = self._model.steering_efficiency(self._prior[s.PARAMETERS])
        rows = [self.rows[f"P{i}_{i}"] for i in range(s.SLIP.start, s.SLIP.stop)]
        for lane, (left, right) in enumerate(first_speeds.tolist()):
            sigmas = slip_at(left, right, slip, gauge, eta, pushed=False, factor=1.0)
            for row, sigma in zip(rows, sigmas, strict=True):
                workspace[row, lane] += sigma**2

    def work_through(
        self, lanes: Lanes, inputs: Floats, steps: Steps, table: Floats, estimates: Floats
    ) -> None:
        """Run all lanes through some steps, in place.

        Args:
            lanes: lanes from `begin`.
            inputs: (n, rows, width) inputs of each step, see `icreckon.estimator.engine.layout`.
            steps: n steps of a run that `prepare` was called with.
            table: (n, k) constants of each step, from `prepare`.
            estimates: (ticks, rows, width) written to: pose, twist and their covariances at the ticks; of
                the first lanes, if it is less wide.

        Raises:
            ValueError: an array has the wrong size or type of numbers, or is not aligned with the
                machine's registers; or the kernel of a step was not compiled.
        """
        workspace, per_lane = lanes.workspace, (lanes.workspace, inputs)
        since_first = steps.ticks - (steps.ticks[0] if len(steps.ticks) else 0)
        used_ticks = since_first[(steps.extras & TICK) > 0]
        places, count = work_places(self.layout, self._wander), len(steps.kinds)
        # Compiled code checks neither types nor indices.
        fits = all(array.dtype == self.number for array in (*per_lane, lanes.constants))
        fits &= not any(array.ctypes.data % LINE for array in per_lane)  # aligned
        fits &= workspace.shape == (places.row_count, self.width) and len(lanes.fixes) == self.width
        fits &= len(lanes.constants) >= places.constant_count and len(inputs) >= count
        fits &= inputs.shape[1:] == (len(INPUTS), self.width)
        fits &= len(table) >= count and table.shape[1] == STEP_COLUMNS
        fits &= estimates.shape[1] >= len(places.estimate) and estimates.shape[2] <= self.width
        fits &= bool(((used_ticks >= 0) & (used_ticks < len(estimates))).all())
        if not fits:
            raise ValueError(WRONG_SIZE)
        arrays = self._kernels, workspace, inputs, lanes.constants, table
        steps = steps._replace(ticks=since_first)
        entry(work_through)(*arrays, steps, estimates, lanes.fixes, places)

    def counts(self, lanes: Lanes) -> dict[str, Floats]:
        """Counts (width,) by their names in `icreckon.estimator.engine.layout.COUNTS`."""
        return {name: lanes.workspace[self.rows[name]].copy() for name in COUNTS}

    def prepare(self, steps: Steps) -> Floats:
        """Compile or load the kernels of a run, and compute the constants of its steps.

        Returns:
            (n, k) constants of each step, the interval of the IMU last, for `work_through`.

        Raises:
            BatchError: the IMU has a gap longer than `Settings.hold`.
        """
        longest = float(steps.intervals.max(initial=0.0))
        if longest > self.settings.hold:
            raise BatchError(
                f"the IMU is silent for {longest:.2f} s, longer than Settings.hold, which filters side "
                "by side cannot bridge; use run"
            )
        fix_times = time_of_fix(steps.kinds, steps.extras)
        moves_to_tick = (steps.extras[steps.kinds == MOVE] & TICK) > 0
        by_kind = [fix_times[(steps.extras & bit) > 0] for bit in (POSITION, HEADING)]
        used = (frozenset(one.tolist()) for one in (moves_to_tick, *by_kind))
        self._kernels = _kernels(self.shape, self.width, self._uses_force, *used)
        if self._prepared is None or self._prepared[0] is not steps:
            table = np.zeros((len(steps.starts), STEP_COLUMNS))
            fill_step_constants(table, steps.starts, steps.ends, steps.intervals)
            self._prepared = steps, table
        return self._prepared[1]


@cache
def work_places(layout: Layout, wander: FixWander) -> Places:
    """Places of a layout that `work_through` needs."""
    rows = layout.rows
    pose = [rows[f"x{i}"] for i in range(3)]
    covariance = [rows[covariance_name(i, j)] for i in range(3) for j in range(i, 3)]
    innovation = [f"position_{part}" for part in ("z_x", "z_y", "S_xx", "S_xy", "S_yy")]
    uncertain = [i for i in layout.states if i < s.SIZE]
    replaced = (*range(3), *(i for i in layout.states if i >= s.SIZE))
    states = (*layout.states, *range(s.FAST_SLIP.start, s.FAST_SLIP.stop))

    def covariance_rows(some: Sequence[int], others: Sequence[int]) -> Any:
        return np.array([[rows[covariance_name(i, j)] for j in others] for i in some])

    def named_rows(names: Sequence[str]) -> Any:
        return np.array([rows[name] for name in names])

    return Places(
        estimate=np.array([*pose, *covariance, *(rows[name] for name in TWIST)]),
        states=np.array(uncertain),
        x=named_rows([f"x{i}" for i in uncertain]),
        variances=named_rows([f"P{i}_{i}" for i in uncertain]),
        replaced=named_rows([f"x{i}" for i in replaced]),
        with_replaced=covariance_rows(replaced, states),
        of_replaced=covariance_rows(replaced, replaced),
        rejected=rows["position_rejected_for"],
        used=rows["position_used"],
        predicted=named_rows(PLACES[:3]),
        updated=named_rows(PLACES[3:]),
        innovation=named_rows(innovation),
        interval=layout.constants["interval"],
        row_count=len(rows),
        constant_count=len(layout.constants),
        wander_sigma=wander.sigma,
        wander_time=wander.time,
    )


@cache
def _kernels(
    shape: FilterShape,
    width: int,
    uses_force: bool,
    moves: frozenset[int],
    positions: frozenset[int],
    headings: frozenset[int],
) -> LaneKernels:
    """Compile the kernels of a run, or load them.

    `moves` are 1 for steps without an IMU sample that are ticks, 0 for others; `positions` and `headings`
    are each `time_of_fix`.
    """
    usual, move = StepKind(accelerometer=uses_force), StepKind(imu=False, accelerometer=False)
    steps = move, move.reporting()
    full = usual._replace(may_stand=True).reporting()
    update = full._replace(draws=False, moves=False, fast_slip=False)
    ticks = FixKind(fast_slip=True, twist=True)
    fixes = FixKind(), ticks, FixKind(ahead=True), ticks._replace(ahead=True)

    def kernel(make: Any, name: str, kind: StepKind | FixKind) -> int:
        return address_of(make, (name, shape, kind), width, shape.bits)

    def needed(make: Any, name: str, kinds: Sequence[Any], used: frozenset[int]) -> Any:
        named = enumerate(kinds)
        return tuple(kernel(make, f"{name}{k}", kind) if k in used else 0 for k, kind in named)

    return LaneKernels(
        kernel(step_kernel, "usual", usual),
        kernel(step_kernel, "full", full),
        kernel(step_kernel, "update", update),
        needed(step_kernel, "move", steps, moves),
        needed(position_kernel, "position", fixes, positions),
        needed(heading_kernel, "heading", fixes, headings),
    )


assert len(ESTIMATE) == 3 + 6 + len(TWIST)  # noqa: S101 - one is written as the other
