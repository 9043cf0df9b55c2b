"""Many filters of one robot and variant, side by side in the lanes of vector registers."""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from estimator import state as s
from estimator.assumptions import assumptions
from estimator.batch.emit import Kernel, compiled_kernel, lanes_of_machine
from estimator.batch.errors import BatchError
from estimator.batch.fixes import FixKind, heading_kernel, position_kernel
from estimator.batch.lane import ARRAYS, FilterShape
from estimator.batch.layout import COUNTS, STEP_CONSTANTS, TWIST, Layout, covariance_name
from estimator.batch.schedule import AHEAD, HEADING, MOVE, MOVE_AND_UPDATE, Steps
from estimator.batch.step import StepKind, step_kernel
from estimator.batch.trace import TRACING
from estimator.batch.work import ESTIMATE, Places, work_through
from estimator.ekf import REGRESSOR_SMOOTHING
from estimator.frames import Floats
from estimator.gating import CHI_SQUARE_1E4
from estimator.imu_kernel import SlipNumbers
from estimator.jit_kernel import entry
from estimator.log import NANOSECOND
from estimator.motion import InertiaMotion
from estimator.propagation import fading, gauss_markov_noise
from estimator.robot import Robot
from estimator.sensor_models import SensorModels
from estimator.settings import Settings
from estimator.track_speeds import smoothing_share
from estimator.variants import Variant

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
        variant: of one of the index models.
        settings: of the filters.
        bits: of each number: 64, or 32 for twice as many lanes and seven digits.

    Attributes:
        robot: the robot.
        settings: the settings.
        width: how many filters run side by side.
        number: the type of their numbers.
        layout: what stands where in the workspace.

    Raises:
        BatchError: the variant is none of an index model.
        EstimatorError: see `PoseEstimator`.
    """

    def __init__(self, robot: Robot, variant: Variant, settings: Settings, bits: int = 64) -> None:
        if bits not in PRECISIONS:
            raise BatchError(f"numbers have 64 or 32 bits, found bits = {bits!r}")
        if settings.considered:
            raise BatchError(
                f"filters side by side cannot take states as uncertain that they do not correct, found "
                f"considered = {settings.considered!r}"
            )
        taken = assumptions(robot, variant, settings)
        if not isinstance(taken.model, InertiaMotion):
            raise BatchError(
                f"the variant {variant.name!r} cannot run side by side with others of its kind; "
                "those of the index models can"
            )
        self._model, self._state, self._sigmas = taken.model, taken.state, taken.sigmas
        self._disturbances = taken.disturbances
        self.robot, self.settings = robot, settings
        self.width, self.number = lanes_of_machine(bits), PRECISIONS[bits]
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
            self._model.form == "literal",
            self._model.slip_in_inertia,
            bits,
        )
        self.layout = Layout(self.shape.states)
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
        return Lanes(lanes, refused, counts, self._constants())

    def work_through(
        self, lanes: Lanes, inputs: Floats, steps: Steps, table: Floats, estimates: Floats
    ) -> None:
        """Work through some steps; the lanes go on in place.

        Args:
            lanes: from `begin`.
            inputs: (n, rows, width) what each step is told, see `estimator.batch.layout`.
            steps: (n,) the steps, of a run that it is prepared for.
            table: (n, k) of `prepare`.
            estimates: (ticks, rows, width) written to: pose, twist and their covariances at the ticks.
        """
        self._work(
            lanes.workspace,
            inputs,
            lanes.constants,
            table,
            steps.kinds,
            steps.extras,
            steps.ticks - (steps.ticks[0] if len(steps.ticks) else 0),
            estimates,
            lanes.refused,
            lanes.refused_count,
            _places(self.layout),
        )

    def state(self, lanes: Lanes, lane: int) -> tuple[Floats, Floats]:
        """State (SIZE,) and covariance (SIZE, SIZE) of one filter, without the fast slip."""
        x, P = self._state.copy(), np.zeros((s.SIZE, s.SIZE))
        for n, i in enumerate(self.shape.states):
            x[i] = lanes.workspace[self.rows[f"x{i}"], lane]
            for j in self.shape.states[n:]:
                P[i, j] = P[j, i] = lanes.workspace[self.rows[f"P{i}_{j}"], lane]
        return x, P

    def counts(self, lanes: Lanes) -> dict[str, Floats]:
        """Name from `estimator.batch.layout.COUNTS` -> (width,) what was counted."""
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
            needs = Needs(
                accelerometer=self.settings.use_accelerometer,
                heading=bool((steps.extras & HEADING).any()),
                ahead=bool((steps.kinds == AHEAD).any()),
                moves_alone=bool((steps.kinds == MOVE).any()),
            )
            if self.shape.slip_in_inertia and needs.ahead:
                raise BatchError(
                    "with inertia = 'imu', filters side by side take fixes at the stamps of IMU samples "
                    "only"
                )
            with TRACING:
                self._work = _worker(self.shape, self.width, needs)
            self._prepared = steps, self._step_constants(steps)
        return self._prepared[1]

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

    def _constants(self) -> Floats:
        """What all lanes share, with room for what belongs to a step."""
        names = self.layout.constants
        values: Floats = aligned(len(names), self.number)
        slip, sensors = self._disturbances.slip, SensorModels(self.robot).constants
        known = {
            **self._model.vehicle._asdict(),
            **{name: getattr(slip, name) for name in SlipNumbers._fields},
            "gyro_density": sensors.gyro_density,
            "accelerometer_density": sensors.accelerometer_density,
            "imu_x": sensors.x,
            "imu_y": sensors.y,
            "threshold": CHI_SQUARE_1E4[1],
            "position_threshold": CHI_SQUARE_1E4[2],
            "patience": self.settings.gates.patience,
            "bias_margin": self.settings.standstill.bias_margin,
            **{f"fixed{i}": value for i, value in enumerate(self._state)},
            **{f"walk{i}": value for i, value in enumerate(self._walks)},
        }
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
def _places(layout: Layout) -> Places:
    rows = layout.rows
    pose = [rows[f"x{i}"] for i in range(3)]
    spread = [rows[covariance_name(i, j)] for i in range(3) for j in range(i, 3)]
    with_pose = [[rows[covariance_name(i, j)] for j in layout.states] for i in range(3)]
    return Places(
        np.array([*pose, *spread, *(rows[name] for name in TWIST)]),
        np.array(with_pose),
        rows["position_row"],
        rows["position_used"],
        rows["believed_x"],
        rows["believed_y"],
        layout.constants["interval"],
    )


class Needs(NamedTuple):
    """What the steps of a run need besides the usual.

    Attributes:
        accelerometer: whether specific forces are used.
        heading: whether fixes have headings.
        ahead: whether there are fixes between IMU samples.
        moves_alone: whether steps end without an IMU sample.
    """

    accelerometer: bool
    heading: bool
    ahead: bool
    moves_alone: bool


@cache
def _worker(shape: FilterShape, width: int, needs: Needs) -> Any:
    """The compiled function that works through steps; what is not needed does nothing in it."""
    nothing = Kernel("nothing", ARRAYS, ())
    force = needs.accelerometer
    kernels = {
        "usual": step_kernel("usual", shape, StepKind(accelerometer=force)),
        "full": step_kernel("full", shape, StepKind(stands=True, accelerometer=force, tells=True)),
        "update": step_kernel(
            "update", shape, StepKind(moves=False, stands=True, accelerometer=force, tells=True)
        ),
        "move": nothing,
    }
    if needs.moves_alone:
        kernels["move"] = step_kernel("move", shape, StepKind(imu=False, accelerometer=False))
    fixes = {"": FixKind(), "_told": FixKind(tells=True), "_ahead": FixKind(ahead=True)}
    for name, kind in fixes.items():
        position, heading = f"position{name}", f"heading{name}"
        kernels[position] = kernels[heading] = nothing
        if needs.ahead or not kind.ahead:
            kernels[position] = position_kernel(position, shape, kind)
            if needs.heading:
                kernels[heading] = heading_kernel(heading, shape, kind)
    compiled = {
        name: compiled_kernel(kernel, width, shape.bits) for name, kernel in kernels.items()
    }
    made = hashlib.sha256(repr((shape, width, needs)).encode()).hexdigest()[:12]
    return entry(work_through, f".{made}", compiled)


assert len(ESTIMATE) == 3 + 6 + len(TWIST)  # noqa: S101 - one is written as the other
