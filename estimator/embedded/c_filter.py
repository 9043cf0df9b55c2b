"""Filter of one robot and variant as C sources.

Its steps and its inputs are those of the Python filter: kernels of traced numbers (`tracing.c_kernel`)
and functions over the record (`tracing.c_functions`). A template puts them together, as
`streaming.reckoning` does.
"""

import zlib
from collections.abc import Callable, Iterable
from functools import partial
from importlib.metadata import metadata
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import BatchError, EstimatorError
from icreckon.estimator.base.records import shared_record
from icreckon.estimator.embedded.c_records import Records
from icreckon.estimator.engine import model
from icreckon.estimator.engine.constants import REGRESSOR_SMOOTHING
from icreckon.estimator.engine.filters import BatchFilter, work_places
from icreckon.estimator.engine.fixes import FixKind, heading_kernel, position_kernel
from icreckon.estimator.engine.lane import FAST, FilterShape, Lane, array_rows
from icreckon.estimator.engine.lane_filter import LONG_STEP
from icreckon.estimator.engine.lane_functions import move_inputs, sample_inputs
from icreckon.estimator.engine.layout import INPUTS, MOTION, covariance_name
from icreckon.estimator.engine.one_lane import OF_RECORD, OF_TIME
from icreckon.estimator.engine.step import Step, StepKind, step_kernel
from icreckon.estimator.engine.work import Places, follow_in_lane, let_wander, relocate_lane
from icreckon.estimator.faults.repeating_fixes import repeats
from icreckon.estimator.faults.scattering_fixes import ScatterRecord, wanders
from icreckon.estimator.faults.sliding_robot import slides
from icreckon.estimator.faults.spinning_tracks import is_found
from icreckon.estimator.faults.stuck_tracks import frozen_from, stuck_from
from icreckon.estimator.filter import ekf
from icreckon.estimator.filter.filter_record import (
    FilterRecord,
    FixesRecord,
    ends_step,
    take_track_speeds,
)
from icreckon.estimator.filter.gate import CHI_SQUARE_1E4, LARGEST_INFLATION, LONGEST_COUNTED
from icreckon.estimator.filter.initial_state import assumptions
from icreckon.estimator.filter.reacquisition import RejectedRecord, add_rejected
from icreckon.estimator.log import input_checks
from icreckon.estimator.log.measurements import STANDSTILL_SIGMA
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings, wander_of
from icreckon.estimator.robot.variants import Variant, state_names
from icreckon.estimator.sensors import imu_clock
from icreckon.estimator.sensors.held_tracks import TrackRecord, is_hole, smoothing_share, speeds_at
from icreckon.estimator.sensors.imu_clock import ClockRecord
from icreckon.estimator.sensors.input_settings import InputSettings, input_settings
from icreckon.estimator.sensors.measurement_models import IMU_SENSORS, POSE_FIXED, STANDING_FIXED
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.sensors.standstill import is_carried
from icreckon.estimator.streaming.latencies import Latencies
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.c_functions import Functions
from icreckon.estimator.tracing.c_kernel import function_name, kernel_in_c, literal
from icreckon.estimator.tracing.c_writer import INT, REAL, Code, Type
from icreckon.estimator.tracing.kernel import Kernel, Store

TEMPLATES = Path(__file__).parent / "templates"
SOURCE = TEMPLATES / "icreckon_filter.c.in"
# Standard deviations within which the self-test holds a filter to that in Python, by bits of a number.
TOLERANCE = {64: 1e-6, 32: 0.02}
# Fields that the filter in C does not need: settings are constants, the workspace has the gates and what
# position fixes change, and nobody watches latencies.
WITHOUT = frozenset({"settings", "poses", *IMU_SENSORS, "turning", "yaw_rates", *OF_RECORD})
RECORD = f"icr_{FilterRecord.__name__}"
SETTINGS, PLACES = Type("record", "icr_InputSettings"), Type("record", "Places")
LEARNT = range(s.LEARNT.start, s.LEARNT.stop)
SLIP_STATES = s.SLIP_X, s.SLIP_Y, s.SLIP_W
FASTEST_IMU = 10_000.0  # highest rate of an IMU [Hz]
VARYING = ("dt", "smoothing", "interval")  # constants of a kernel that differ from step to step
GATES = ("gyro", "heading")  # gates whose number of used measurements the filter reads
# Constants of `ekf`, and limits of `input_checks`.
OF_UPDATES = ("SHARP", "ROUNDING_SHARE", "LEAST_VARIANCE")
ABSURD = ("RATE", "FORCE", "DISTANCE", "LEVER")
LATE_STREAMS = ("tracks", "imu", "position", "heading")  # streams with a latency in the robot file
# Rows that the filter reads, by their names in C.
ROWS = {
    "STOOD": "stood",
    "PREDICTED": "predicted_x",
    "INNOVATION": "position_z_x",
    **{f"USED_{gate}".upper(): f"{gate}_used" for gate in GATES},
}
# A step is taken in parts, so that an IMU sample at the stamp of the estimate and a step without one need
# no kernels of their own, and standstills cost nothing while driving.
BEGIN = OF_TIME._replace(moves=False)
PART = StepKind(draws=False, moves=False, resumes=True, fast_slip=True, in_step=True)
AHEAD = FixKind(fast_slip=True, ahead=True, updated=False)
# Places of the indices and of the derivatives in what `_motion_kernel` stores.
INDICES, DERIVATIVES = 9, 12


def _first_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of the first track speeds: a moving robot may slip already."""
    lane = Lane(shape)
    smooth = lane.input("smooth_left"), lane.input("smooth_right")
    gauge, factor = lane.constant("gauge"), lane.row("slip_factor")
    sigmas = model.slip_at(*smooth, lane.slip, gauge, lane.eta, False, factor)
    for state, sigma in zip((s.SLIP_X, s.SLIP_Y, s.SLIP_W), sigmas, strict=True):
        lane.P.add(state, state, sigma * sigma)
    return lane.kernel(name)


def _motion_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of a body velocity.

    It stores into an array: the twist (3,), the density of the fast slip (3, 3) above its diagonal, the
    indices (3,), and the derivatives (3, n) of the twist by all states, which are not smoothed.
    """
    lane = Lane(shape, with_fast_slip=True)
    now = lane.twist_model(lane.input("left"), lane.input("right"))
    density = Step(lane, StepKind(draws=False, moves=False, imu=False)).density(now)
    values = [*now.twist, *(density[i][j] for i in range(3) for j in range(i, 3))]
    values += now.motion.indices
    values += [row.get(i, 0.0) for row in now.rows for i in (*shape.states, *FAST)]
    stores = [Store("found", place, trace.lift(value)) for place, value in enumerate(values)]
    return Kernel(name, array_rows(shape.layout), stores, (), [])


def _inside_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel that projects the parameters onto their bounds."""
    lane = Lane(shape, with_fast_slip=True)
    lane.keep_inside_bounds()
    return lane.kernel(name, with_fast_slip=True)


# Kernels by their names in C.
KERNELS: dict[str, Callable[[str, FilterShape], Kernel]] = {
    "inside": _inside_kernel,
    "begin": partial(step_kernel, kind=BEGIN),
    "stand": partial(step_kernel, kind=PART._replace(imu=False, may_stand=True)),
    "update": partial(step_kernel, kind=PART),
    "propagate": partial(step_kernel, kind=PART._replace(imu=False, moves=True)),
    "position": partial(position_kernel, kind=AHEAD),
    "heading": partial(heading_kernel, kind=AHEAD),
    "start": _first_kernel,
    "motion": _motion_kernel,
}


class Exported(NamedTuple):
    """Filter in C."""

    files: dict[str, str]  # text of each file, by its path in the folder
    states: list[int]  # indices of its states, in their order

    def write(self, folder: Path) -> None:
        """Write the files into a folder, which is made."""
        for name, text in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")


def filter_in_c(
    robot: Robot, variant: Variant, settings: Settings | None = None, *, bits: int, imu_rate: float
) -> Exported:
    """Write the filter of a robot and variant in C99.

    Args:
        robot: the robot.
        variant: the filter variant.
        settings: settings of the filter; None for the usual ones.
        bits: number of bits of each number, 64 or 32.
        imu_rate: highest rate of the IMU, for the size of a buffer [Hz].

    Raises:
        EstimatorError: the rate is not above zero, or the variant has no form in C.
    """
    if not 0.0 < imu_rate <= FASTEST_IMU:
        raise EstimatorError(
            f"the rate of the IMU must be above 0 and at most {FASTEST_IMU:g} Hz, found {imu_rate!r}"
        )
    return _Export(robot, variant, settings or Settings(), bits, imu_rate).exported()


class _Export:
    """Export of one filter."""

    def __init__(
        self, robot: Robot, variant: Variant, settings: Settings, bits: int, imu_rate: float
    ) -> None:
        self._robot, self._variant, self._settings, self._bits = robot, variant, settings, bits
        self._imu_rate, self._readings = imu_rate, int(settings.standstill.duration * imu_rate) + 4
        try:
            filter_ = BatchFilter(robot, variant, settings, bits, width=1)
        except BatchError as problem:
            raise EstimatorError(f"{variant.name!r} has no form in C: {problem}") from None
        self._shape = filter_.shape
        self._layout, self._rows = filter_.layout, filter_.rows
        self._states = [i for i in self._shape.states if i < s.SIZE]
        self._all_states = *self._shape.states, *FAST
        self._inputs = input_settings(robot, settings)
        self._record: Any = shared_record(FilterRecord(self._inputs))
        lanes = filter_.begin(np.zeros((1, 2)), np.zeros(3), np.zeros(3))
        for slip in range(s.SLIP.start, s.SLIP.stop):
            # The first track speeds add it.
            lanes.workspace[self._rows[covariance_name(slip, slip)]] = 0.0
        self._workspace, self._constants = lanes.workspace[:, 0].tolist(), lanes.constants.tolist()
        self._records = Records(bits, {FilterRecord: WITHOUT})

    def exported(self) -> Exported:
        """Make all files."""
        self._records.add(type(self._record))
        tables, constants = self._places()
        types = {**self._records.types, Places: PLACES, InputSettings: SETTINGS}
        functions = Functions(self._bits, types, constants, self._records.integers)
        self._translate(functions)
        called = "\n".join([*functions.text, SOURCE.read_text(encoding="utf-8")])
        parts = {
            "TUPLES": "\n".join(functions.tuples.values()),
            "PLACES": "\n".join(text for name, text in tables.items() if name in called),
            "FUNCTIONS": "\n".join(functions.text),
            "KERNELS": "\n".join(self._kernel(name) for name in KERNELS),
            "STRUCTS": "\n".join(self._records.text),
            **self._names(),
            **self._tables(),
            **self._numbers(),
        }
        parts["DIGEST"] = f"0x{zlib.crc32(repr(parts).encode()):08X}u"
        paths = [path.relative_to(TEMPLATES) for path in sorted(TEMPLATES.rglob("*.in"))]
        files = {
            path.with_suffix("").as_posix(): _filled(TEMPLATES / path, parts) for path in paths
        }
        return Exported(files, self._states)

    def _places(self) -> tuple[dict[str, str], dict[tuple[str, str], Code]]:
        """Tables of places in the workspace, and constants in place of fields."""
        tables, constants = {}, {(RECORD, "settings"): Code("SETTINGS", SETTINGS)}
        places = work_places(self._layout, wander_of(self._robot, self._settings))._asdict()
        for name, value in places.items():
            if isinstance(value, np.ndarray):
                table = f"places_{name}"
                tables[table] = self._array(f"uint16_t {table}[{value.size}]", value.ravel())
                constants[PLACES.name, name] = Code(table, Type("array", "place", (), value.shape))
            else:
                constants[PLACES.name, name] = self._constant(value)
        for name, value in self._inputs._asdict().items():
            constants[SETTINGS.name, name] = self._constant(value)
        return tables, constants

    def _constant(self, value: float | int) -> Code:
        if isinstance(value, float):
            return Code(self._number(value), REAL, value)
        return Code(f"INT64_C({value})", INT, value)

    def _translate(self, functions: Functions) -> None:
        """Translate the functions that the template calls, for types in the C filter."""
        lanes = Type("array", "real", shape=(len(self._rows), 1))
        inputs = Type("array", "real", shape=(len(INPUTS), 1))
        before = Type("array", "real", shape=(len(self._states),))
        stamps, rates = (Type("array", of, shape=(self._readings,)) for of in ("int", "real"))
        types = functions.records
        record, fixes = types[FilterRecord], types[FixesRecord]
        gyro = functions.tuple_type([(f"_{k}", REAL) for k in range(4)])
        readings = {"stamps": stamps, "rates": rates}
        functions.translate(sample_inputs, record=record, inputs=inputs, gyro=gyro, **readings)
        functions.translate(move_inputs, record=record, inputs=inputs)
        clocks = imu_clock.is_due_after, imu_clock.is_alive, imu_clock.take_stamp
        for of_clock in (imu_clock.interval_start, *clocks):
            functions.translate(of_clock, clock=types[ClockRecord])
        functions.translate(imu_clock.interval_start, clock=types[TrackRecord])
        functions.translate(is_hole, held=types[TrackRecord])
        functions.translate(let_wander, workspace=lanes, fixes=fixes)
        functions.translate(relocate_lane, workspace=lanes, rejected=types[RejectedRecord])
        scatter = types[ScatterRecord]
        functions.translate(follow_in_lane, workspace=lanes, scatter=scatter, before=before)
        of_records = take_track_speeds, ends_step, speeds_at, smoothing_share, repeats, add_rejected
        findings = stuck_from, frozen_from, is_found, slides, is_carried, wanders
        for function in (*of_records, *findings):
            functions.translate(function)

    def _kernel(self, name: str) -> str:
        """Kernel in C; its constants are literals."""
        places = self._layout.constants
        varying = {places[constant] for constant in VARYING}
        values = enumerate(self._constants)
        known = {("constants", k): value for k, value in values if k not in varying}
        with trace.for_c(known):
            return kernel_in_c(KERNELS[name](name, self._shape), self._bits)

    def _names(self) -> dict[str, str]:
        """Names and sizes."""
        rows, places = self._rows, self._layout.constants
        names = state_names(self._variant)
        learnt = [i for i in self._states if i in LEARNT]
        parameters, latencies = self._layout.parameters, Latencies.of(self._robot)
        latency_ns = {name: round(getattr(latencies, name) / NANOSECOND) for name in LATE_STREAMS}
        defines = {
            "INPUTS": len(INPUTS),
            "CONSTANTS": 1 + max(places[constant] for constant in VARYING),
            "READINGS": self._readings,
            "STATES": len(self._states),
            "STATES_AND_WANDER": len(self._shape.states),
            "ALL": len(self._all_states),
            "INDICES": INDICES,
            "DERIVATIVES": DERIVATIVES,
            "MOTION_COUNT": DERIVATIVES + 3 * len(self._all_states),
            "PARAMETERS": len(parameters),
            "FIRST_PARAMETER": self._states.index(parameters[0]) if parameters else 0,
            "ROW_REGRESSORS": self._layout.regressors,
            "LONG_STEP": LONG_STEP,
            "WANDERS": int(s.WANDER_X in self._shape.states),
            **{constant.upper(): places[constant] for constant in VARYING},
            **{f"ROW_{name}": rows[row] for name, row in ROWS.items()},
            **{f"IN_{name}".upper(): INPUTS[name] for name in INPUTS.names},
        }
        return {
            "VERSION": metadata("icreckon")["Version"],
            "LICENSE": metadata("icreckon")["License-Expression"],
            "ROBOT": self._robot.name,
            "VARIANT": self._variant.name,
            "REAL": "double" if self._bits == 64 else "float",
            "SQRT": function_name("sqrt", self._bits),
            "TOLERANCE": f"{TOLERANCE[self._bits]:g}",
            "IMU_RATE": f"{self._imu_rate:g}",
            "DEFINES": "\n".join(f"#define {name} {value}" for name, value in defines.items()),
            "LATENCIES": "\n".join(
                f"#define ICR_{name.upper()}_LATENCY INT64_C({value})"
                for name, value in latency_ns.items()
            ),
            # Rows behind these are outputs of other kernels.
            "ROW_COUNT": str(rows[MOTION[0]]),
            "READING_COUNT": str(self._readings),
            "LEARNT_COUNT": str(len(learnt)),
            "STATE_ENUM": "\n".join(f"    ICR_{names[i].upper()}," for i in self._states),
            "STATE_NAMES": ", ".join(f'"{names[i]}"' for i in self._states),
        }

    def _tables(self) -> dict[str, str]:
        """Arrays in C, by their names in the template, and the start of the filter."""
        array, rows, states = self._array, self._rows, self._all_states
        mounting = SensorModels(self._robot).mounting.ravel()
        # Bit masks of the states that a velocity, and a standing robot, do not move.
        never_moved = {*self._shape.considered, s.WANDER_X, s.WANDER_Y}
        fixed_states = [never_moved.union(fixed) for fixed in (POSE_FIXED, STANDING_FIXED)]
        masks = [sum(1 << k for k, i in enumerate(states) if i in fixed) for fixed in fixed_states]
        slips = [states.index(i) for i in SLIP_STATES]
        covariances = [rows[covariance_name(i, j)] for i, j in product(states, states)]
        learnt = [k for k, i in enumerate(self._states) if i in LEARNT]
        assumed = assumptions(self._robot, self._variant, self._settings)
        walks = (assumed.disturbances.bias_walk**2)[[self._states[k] for k in learnt]]
        values = enumerate(self._workspace)
        start = [f"    lanes[{row}] = {self._number(value)};" for row, value in values if value]
        return {
            "MOUNTING": array("real MOUNTING[18]", mounting),
            "VALUES": array("uint16_t VALUES[ALL]", [rows[f"x{i}"] for i in states]),
            "FIXED": array("uint32_t FIXED[2]", masks) + array("uint8_t SLIP_PLACE[3]", slips),
            "COVARIANCES": array("uint16_t COVARIANCES[ALL * ALL]", covariances),
            "LEARNT": array("uint16_t LEARNT[]", learnt),
            "WALKS": array("real WALKS[]", walks),
            "START": "\n".join([*start, *self._records.initial(self._record, "filter->record")]),
        }

    def _numbers(self) -> dict[str, str]:
        """Settings and limits, as numbers in C, by their names in the template."""
        settings, number = self._settings, self._number
        uses_force = settings.use_accelerometer and self._variant.accelerometers
        fastest = self._robot.vehicle.max_track_speed
        return {
            "USES_FORCE": "true" if uses_force else "false",
            "FASTEST": number(fastest),
            "HOLD": number(self._inputs.hold),
            "HOLD_NS": f"INT64_C({self._inputs.hold_ns})",
            "SLOW": number(self._inputs.track_speed),
            "GAUGE": number(self._robot.vehicle.track_gauge),
            "NANOSECOND": number(NANOSECOND),
            "SMOOTHING_TIME": number(REGRESSOR_SMOOTHING),
            **{name: number(getattr(ekf, name)) for name in OF_UPDATES},
            **{f"THRESHOLD_{degrees}": number(CHI_SQUARE_1E4[degrees]) for degrees in (2, 3)},
            "PATIENCE": number(settings.gates.patience),
            "LARGEST_INFLATION": number(LARGEST_INFLATION),
            "STANDSTILL_SIGMA": ", ".join(map(number, STANDSTILL_SIGMA)),
            "LONGEST_COUNTED": number(LONGEST_COUNTED),
            "GAP": f"{settings.longest_gap:g}",
            "LONGEST_GAP": f"INT64_C({int(settings.longest_gap / NANOSECOND)})",
            "WITNESSES": str(input_checks.CLOCK_WITNESSES),
            "EARLIEST": f"INT64_C({input_checks.EARLIEST})",
            "LATEST": f"INT64_C({input_checks.LATEST})",
            "ABSURD_SPEED": number(input_checks.ABSURD_SPEED * fastest),
            **{f"ABSURD_{of}": number(getattr(input_checks, f"ABSURD_{of}")) for of in ABSURD},
        }

    def _number(self, value: float) -> str:
        return literal(float(value), self._bits)

    def _array(self, declared: str, values: Iterable[Any]) -> str:
        """Constant array in C."""
        is_real = declared.startswith("real")
        texts = (self._number(value) if is_real else str(int(value)) for value in values)
        return f"static const {declared} = {{{', '.join(texts)}}};"


def _filled(template: Path, parts: dict[str, str]) -> str:
    """Text of a template with parts in place of their names, as @NAME@."""
    text = template.read_text(encoding="utf-8")
    for name, value in parts.items():
        text = text.replace(f"@{name}@", value)
    return text
