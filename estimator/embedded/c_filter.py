"""Filter of one robot and variant as C sources.

Its steps and its inputs are those of the Python filter: kernels of traced numbers (`tracing.c_kernel`) and
functions over the record (`tracing.c_functions`). `icreckon_filter.c.in` puts them together, as
`streaming.reckoning` does.
"""

from __future__ import annotations

import ctypes
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from icreckon import __version__
from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.records import CLOCK, _hints, shared_record
from icreckon.estimator.engine import model
from icreckon.estimator.engine.constants import shared_constants
from icreckon.estimator.engine.filters import BatchFilter, work_places
from icreckon.estimator.engine.fixes import FixKind, heading_kernel, position_kernel
from icreckon.estimator.engine.lane import FilterShape, Lane
from icreckon.estimator.engine.lane_functions import move_inputs, sample_inputs
from icreckon.estimator.engine.layout import INPUTS, covariance_name
from icreckon.estimator.engine.model import SlipConstants
from icreckon.estimator.engine.one_lane import OF_SAMPLE, OF_TIME
from icreckon.estimator.engine.step import step_kernel
from icreckon.estimator.engine.work import Places, follow_in_lane, let_wander, relocate_lane
from icreckon.estimator.faults.odd_wheels import WheelsRecord
from icreckon.estimator.faults.repeating_fixes import repeats
from icreckon.estimator.faults.scattering_fixes import TakenFix, wanders
from icreckon.estimator.faults.sliding_robot import slides
from icreckon.estimator.faults.spinning_tracks import certain_side
from icreckon.estimator.faults.stuck_tracks import frozen_from, stuck_from
from icreckon.estimator.filter.filter_record import FilterRecord, ends_step, take_track_speeds
from icreckon.estimator.filter.initial_state import assumptions
from icreckon.estimator.filter.reacquisition import add_rejected
from icreckon.estimator.log import input_checks
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings, wander_of
from icreckon.estimator.robot.variants import Variant, state_names
from icreckon.estimator.sensors import imu_clock
from icreckon.estimator.sensors.held_tracks import is_hole, smoothing_share, speeds_at
from icreckon.estimator.sensors.imu_tilt import TiltRecord
from icreckon.estimator.sensors.input_settings import InputSettings, input_settings
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.sensors.standstill import StandstillRecord, is_carried
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.c_functions import (
    BOOL,
    COMPLEX_C,
    INT,
    INTEGERS,
    REAL,
    Code,
    Functions,
    Type,
)
from icreckon.estimator.tracing.c_kernel import kernel_in_c, literal
from icreckon.estimator.tracing.kernel import Kernel

FOLDER = Path(__file__).parent
# Fields that the filter in C does not use: rates for the watch of the latency, gates of fixes, and what
# position fixes change, which its workspace holds.
WITHOUT = {
    "settings",
    "poses",
    "gyro",
    "accelerometer_x",
    "accelerometer_y",
    "turning",
    "yaw_rates",
    *("slip_factor", "present_factor", "trend_forward", "trend_left", "trend_size"),
    *("departed_for", "departed_from_x", "departed_from_y", "departed_by_x", "departed_by_y"),
}
# Constants of a kernel that differ from step to step.
VARYING = ("dt", "smoothing", "interval")
# Rows that are set at the start.
ONES = ("slip_factor", "present_factor", "trend_size")


class Exported(NamedTuple):
    """Filter in C.

    Attributes:
        files: text of each file, by name.
        names: names of the states, in their order.
    """

    files: dict[str, str]
    names: tuple[str, ...]


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
        EstimatorError: the variant has no form in C, or see `PoseEstimator`.
    """
    return _Export(robot, variant, settings or Settings(), bits, imu_rate).exported()


class _Export:
    """Export of one filter."""

    def __init__(
        self, robot: Robot, variant: Variant, settings: Settings, bits: int, imu_rate: float
    ) -> None:
        if not imu_rate > 0.0:
            raise EstimatorError(f"imu_rate must be above 0 Hz, found {imu_rate!r}")
        self.robot, self.variant, self.settings, self.bits = robot, variant, settings, bits
        self.filter = batch = BatchFilter(robot, variant, settings, bits, width=1)
        self.shape: FilterShape = batch.shape
        self.rows, self.layout = batch.rows, batch.layout
        self.readings = int(settings.standstill.duration * imu_rate) + 4
        record = shared_record(FilterRecord(input_settings(robot, settings)))
        self.record: Any = record
        self.lanes = batch.begin(np.zeros((1, 2)), np.zeros(3), np.zeros(3))
        for axis in range(3):
            # The first track speeds add it.
            self.lanes.workspace[self.rows[covariance_name(s.SLIP_X + axis, s.SLIP_X + axis)]] = 0.0
        self.constants = self.lanes.constants
        self.assumed = assumptions(robot, variant, settings)

    @property
    def states(self) -> list[int]:
        """Indices of the uncertain states, without the wander of fixes."""
        return [i for i in self.shape.states if i < s.SIZE]

    def number(self, value: float) -> str:
        """Number in C."""
        return literal(float(value), self.bits)

    def exported(self) -> Exported:
        """Make all files."""
        self.types: dict[type, Type] = {InputSettings: Type("record", "icr_InputSettings")}
        self.structs: list[str] = []
        self._type_of(type(self.record))
        tables, constants = self._places()
        functions = Functions(self.bits, self.types, constants)
        self._translate(functions)
        called = [*functions.text, (FOLDER / "icreckon_filter.c.in").read_text(encoding="utf-8")]
        kernels = [kernel_in_c(kernel, kernel.name, self.bits) for kernel in self._kernels()]
        values = self._values()
        parts = {
            "COMPLEX": COMPLEX_C,
            "TUPLES": "\n".join(functions.tuples.values()),
            "PLACES": "\n".join(
                table for name, table in tables.items() if any(name in text for text in called)
            ),
            "FUNCTIONS": "\n".join(functions.text),
            "KERNELS": "\n".join(kernels),
            "STRUCTS": "\n".join(self.structs),
            **values,
        }
        digest = zlib.crc32(repr(sorted(parts.items())).encode())
        parts["DIGEST"] = f"0x{digest:08X}u"
        files = {
            f"icreckon_filter.{kind}": _filled(FOLDER / f"icreckon_filter.{kind}.in", parts)
            for kind in "hc"
        }
        names = state_names(self.variant)
        return Exported(files, tuple(names[i] for i in self.states))

    # --- records ---------------------------------------------------------------------------------

    def _type_of(self, memory: Any) -> Type:
        """C type of a record, by its memory that Python and numba share."""
        kind = memory.kind
        if kind in self.types:
            return self.types[kind]
        name, hints = f"icr_{kind.__name__}", _hints(kind)
        fields, lines = [], []
        for field, of in memory._fields_:
            if kind is FilterRecord and field in WITHOUT:
                continue
            if hasattr(of, "kind"):
                found = self._type_of(of)
                lines.append(f"    {found.name} {field};")
            elif issubclass(of, ctypes.Array):
                found = Type("array", "real", shape=(of._length_,))
                lines.append(f"    icr_real {field}[{of._length_}];")
            elif of is ctypes.c_double:
                found = REAL
                lines.append(f"    icr_real {field};")
            else:
                found, size = INT, "int64_t"
                if CLOCK not in getattr(hints[field], "__metadata__", ()):
                    size = INTEGERS[name, field] = "int32_t"
                lines.append(f"    {size} {field};")
            fields.append((field, found))
        self.types[kind] = Type("record", name, tuple(fields))
        self.structs.append("typedef struct {\n" + "\n".join(lines) + f"\n}} {name};\n")
        return self.types[kind]

    def _initial(self, record: Any, path: str) -> list[str]:
        """Assignments of the initial values of a record that are not zero."""
        found: list[str] = []
        for field, of in record._fields_:
            value, place = getattr(record, field), f"{path}.{field}"
            if record.kind is FilterRecord and field in WITHOUT:
                continue
            if hasattr(of, "kind"):
                found += self._initial(value, place)
            elif not issubclass(of, ctypes.Array) and value:
                is_real = of is ctypes.c_double
                text = self.number(value) if is_real else f"INT64_C({value})"
                cast = INTEGERS.get((f"icr_{record.kind.__name__}", field))
                found.append(f"    {place} = {f'({cast})' if cast else ''}{text};")
        return found

    # --- functions -------------------------------------------------------------------------------

    def _places(self) -> tuple[dict[str, str], dict[tuple[str, str], Code]]:
        """Tables of places in the workspace, and constants in place of fields."""
        self.types[Places] = Type("record", "Places")
        found = work_places(self.layout, wander_of(self.robot, self.settings))
        tables, constants = {}, {}
        for name, value in zip(Places._fields, found, strict=True):
            if isinstance(value, np.ndarray):
                table = f"places_{name}"
                numbers = ", ".join(map(str, value.ravel().tolist()))
                tables[table] = f"static const uint16_t {table}[{value.size}] = {{{numbers}}};"
                of = Type("array", "place", shape=value.shape)
                constants["Places", name] = Code(table, of)
            else:
                is_real = isinstance(value, float)
                text = self.number(value) if is_real else str(value)
                constants["Places", name] = Code(text, REAL if is_real else INT, value)
        for name, value in input_settings(self.robot, self.settings)._asdict().items():
            is_real = isinstance(value, float)
            text = self.number(value) if is_real else f"INT64_C({value})"
            constants["icr_InputSettings", name] = Code(text, REAL if is_real else INT, value)
        of = self.types[InputSettings]
        constants["icr_FilterRecord", "settings"] = Code("SETTINGS", of)
        return tables, constants

    def _translate(self, functions: Functions) -> None:
        """Translate what the template calls."""
        of = self.types
        record, fixes = of[FilterRecord], of[type(self.record.fixes).kind]
        lanes = Type("array", "real", shape=(len(self.rows), 1))
        inputs = Type("array", "real", shape=(len(INPUTS), 1))
        stamps = Type("array", "int", shape=(self.readings,))
        rates = Type("array", "real", shape=(self.readings,))
        four = functions.tuple_type([(f"_{k}", REAL) for k in range(4)])
        three = functions.tuple_type([(f"_{k}", REAL) for k in range(3)])
        before = Type("array", "real", shape=(len(self.states),))
        taken = functions.of_annotation(TakenFix)
        assert taken is not None  # noqa: S101 - a named tuple has a type
        tracks, clock, still = of[type(self.record.tracks).kind], of[type(self.record.imu).kind], of[
            StandstillRecord
        ]
        spin, slide = of[type(self.record.tracks.spin).kind], of[type(self.record.tracks.forward).kind]
        repeating = of[type(self.record.tracks.repeating_left).kind]
        sample = record, stamps, rates, inputs, INT, INT, four, REAL, REAL, BOOL
        calls: list[tuple[Callable[..., Any], tuple[Type, ...]]] = [
            (sample_inputs, sample),
            (move_inputs, (record, inputs, INT, INT)),
            (take_track_speeds, (record, INT, REAL, REAL)),
            (ends_step, (record,)),
            (imu_clock.is_due_after, (clock, INT)),
            (imu_clock.is_alive, (clock, INT, REAL)),
            (imu_clock.take_stamp, (clock, INT, REAL)),
            (imu_clock.interval_start, (clock, INT)),
            (imu_clock.interval_start, (tracks, INT)),
            (is_hole, (tracks, INT, REAL)),
            (speeds_at, (tracks, INT, INT)),
            (smoothing_share, (REAL, REAL)),
            (repeats, (of[type(self.record.positions).kind], INT, REAL, REAL, REAL)),
            (add_rejected, (of[type(self.record.fixes.rejected).kind], three, three, REAL)),
            (let_wander, (lanes, INT, fixes, INT, of[Places])),
            (relocate_lane, (lanes, INT, of[type(self.record.fixes.rejected).kind], of[Places])),
            (
                follow_in_lane,
                (lanes, INT, of[type(self.record.fixes.scatter).kind], taken, before, of[Places]),
            ),
            (stuck_from, (repeating, REAL)),
            (frozen_from, (repeating, repeating, REAL)),
            (certain_side, (spin,)),
            (slides, (slide,)),
            (is_carried, (still,)),
            (wanders, (of[type(self.record.fixes.scatter).kind],)),
        ]
        for function, types in calls:
            functions.translate(function, *types)

    # --- kernels ---------------------------------------------------------------------------------

    def _kernels(self) -> list[Kernel]:
        """Kernels in traced numbers, each of a graph of its own, one at a time."""
        places = self.layout.constants
        varying = {places[name] for name in VARYING}
        known = {
            ("constants", k): float(value)
            for k, value in enumerate(self.constants)
            if k not in varying
        }
        shape = self.shape
        update = OF_SAMPLE._replace(draws=False, moves=False, resumes=True)
        fix, ahead = FixKind(fast_slip=True), FixKind(fast_slip=True, ahead=True)
        makers: list[Callable[[], Kernel]] = [
            lambda: step_kernel("imu_step", shape, OF_SAMPLE),
            lambda: step_kernel("imu_update", shape, update),
            lambda: step_kernel("time_step", shape, OF_TIME),
            lambda: position_kernel("position", shape, fix),
            lambda: position_kernel("position_ahead", shape, ahead),
            lambda: heading_kernel("heading", shape, fix),
            lambda: heading_kernel("heading_ahead", shape, ahead),
            lambda: start_kernel("start", shape),
            lambda: motion_kernel("motion", shape),
        ]
        for make in makers:
            with trace.with_known(known):
                yield_of = make()
            yield yield_of  # type: ignore[misc]

    # --- values ----------------------------------------------------------------------------------

    def _values(self) -> dict[str, str]:
        """Numbers, names and tables of the template."""
        rows, places, shape = self.rows, self.layout.constants, self.shape
        names = state_names(self.variant)
        states = self.states
        workspace, number = self.lanes.workspace[:, 0], self.number
        start = [
            f"    lanes[{k}] = {number(value)};" for k, value in enumerate(workspace.tolist()) if value
        ]
        uses_force = self.settings.use_accelerometer and self.variant.accelerometers
        mounting = SensorModels(self.robot).mounting
        defines = {
            "ROWS": len(rows),
            "INPUTS": len(INPUTS),
            "CONSTANTS": places["interval"] + 1,
            "READINGS": self.readings,
            "STATES": len(states),
            "DT": places["dt"],
            "SMOOTHING": places["smoothing"],
            "INTERVAL": places["interval"],
            "ROW_STOOD": rows["stood"],
            "ROW_TWIST": rows["v_x"],
            "ROW_MOTION": rows["zeta"],
            "ROW_PREDICTED": rows["predicted_x"],
            "ROW_UPDATED": rows["updated_x"],
            "ROW_INNOVATION": rows["position_z_x"],
            **{f"ROW_{gate}".upper(): rows[f"{gate}_rejected_for"] for gate in GATES},
            **{f"IN_{name}".upper(): INPUTS[name] for name in INPUTS.names},
        }
        parameters = [k for k, i in enumerate(states) if s.PARAMETERS.start <= i < s.PARAMETERS.stop]
        return {
            "VERSION": __version__,
            "ROBOT": self.robot.name,
            "VARIANT": self.variant.name,
            "REAL": "double" if self.bits == 64 else "float",
            "DEFINES": "\n".join(f"#define {name} {value}" for name, value in defines.items()),
            "STATE_COUNT": str(len(states)),
            "ROW_COUNT": str(len(rows)),
            "READING_COUNT": str(self.readings),
            "STATE_ENUM": "\n".join(f"    ICR_{names[i].upper()}," for i in states),
            "STATE_NAMES": ", ".join(f'"{names[i]}"' for i in states),
            "PARAMETERS": ", ".join(map(str, parameters)) or "0",
            "PARAMETER_COUNT": str(len(parameters)),
            "LEARNT": ", ".join(
                str(k) for k, i in enumerate(states) if s.LEARNT.start <= i < s.LEARNT.stop
            ),
            "WALKS": ", ".join(
                number(self.assumed.disturbances.bias_walk[i] ** 2)
                for i in states
                if s.LEARNT.start <= i < s.LEARNT.stop
            ),
            "LEARNT_COUNT": str(sum(s.LEARNT.start <= i < s.LEARNT.stop for i in states)),
            "COVARIANCES": ", ".join(
                str(rows[covariance_name(i, j)]) for i in states for j in states
            ),
            "REGRESSORS": self._regressors(),
            "START": "\n".join([*start, *self._initial(self.record, "filter->record")]),
            "MOUNTING": ", ".join(number(value) for value in mounting.ravel()),
            "USES_FORCE": "true" if uses_force else "false",
            "WANDERS": "1" if s.WANDER_X in shape.states else "0",
            "HOLD": number(self.settings.hold),
            "HOLD_NS": f"INT64_C({int(self.settings.hold / 1e-9)})",
            "SLOW": number(self.settings.standstill.track_speed),
            "GAUGE": number(self.robot.vehicle.track_gauge),
            "ABSURD_SPEED": number(input_checks.ABSURD_SPEED * self.robot.vehicle.max_track_speed),
            "LONGEST_GAP": f"INT64_C({int(self.settings.longest_gap / 1e-9)})",
            "NANOSECOND": number(1e-9),
            "SMOOTHING_TIME": number(0.05),
        }

    def _regressors(self) -> str:
        """Copies of the derivatives by the parameters, for a first update without a step."""
        return "\n".join(
            f"    lanes[{self.rows[f'r{axis}_{i}']}] = lanes[{self.rows[f'{name}_by_{i}']}];"
            for axis, name in enumerate(("v_x", "v_y", "w"))
            for i in self.layout.parameters
        )


GATES = ("gyro", "position", "heading")
# Types that only records of these modules have.
_ = WheelsRecord, TiltRecord, msgspec


def start_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of the first track speeds: the robot may be moving already, with a slip."""
    lane = Lane(shape)
    slip = SlipConstants(*(lane.constant(field) for field in SlipConstants._fields))
    smooth = lane.input("smooth_left"), lane.input("smooth_right")
    gauge, factor = lane.constant("gauge"), lane.row("slip_factor")
    sigmas = model.slip_at(*smooth, slip, gauge, lane.eta, False, factor)
    for axis, sigma in enumerate(sigmas):
        lane.P.add(s.SLIP_X + axis, s.SLIP_X + axis, sigma * sigma)
    return lane.kernel(name)


def motion_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of the outputs: body velocity with covariance, derivatives and indices."""
    lane = Lane(shape, with_fast_slip=True)
    now = lane.twist_model(lane.input("left"), lane.input("right"))
    lane.store_motion(now)
    lane.store_twist(lane.with_smoothed_derivatives(now))
    return lane.kernel(name, with_fast_slip=True)


def _filled(template: Path, parts: dict[str, str]) -> str:
    text = template.read_text(encoding="utf-8")
    for name, value in parts.items():
        text = text.replace(f"@{name}@", value)
    return text
