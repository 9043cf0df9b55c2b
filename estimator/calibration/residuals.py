"""Residuals of all segments and their derivatives by all calibrated parameters.

Rows of a segment, in this order: displacement by the truth less that by model and gyro, along and across
its middle heading [m]; rotation by the gyro less that by the model [rad]; rotation by the truth less that
by the gyro [rad]; mean specific force less that of the model's motion, forward and left [m/s²], in each
of `BINS` equal parts.

The heading within a segment is the gyro's, aligned with the truth's at both ends. So neither the tracks'
errors in turning nor noise of the truth's heading affect the displacement.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Flags, Floats, Indexes
from icreckon.estimator.base.frames import rotate, wrap_angle
from icreckon.estimator.calibration.models import THRESHOLD, Model, Parameter
from icreckon.estimator.calibration.segments import Recording
from icreckon.estimator.robot.robot_file import Robot

ALONG, ACROSS, SLIP, YAW, FORCE = range(5)
BINS = 6  # number of parts of a segment with mean specific forces; forward ones first
ROWS = FORCE + 2 * BINS
PLACING_PARAMETERS = ("zeta0", "epsilon0")
"""Parameters of models that place base_link in the robot. If neither the truth's lever arm nor the IMU's
position does so, they are unobservable next to the lever arm, and are held."""
TRACK_PARAMETERS = ("scale", "difference", "track_latency")
"""Parameters of the track speeds: scale, difference of the radii (right less left), latency."""
SIDES = np.array([-0.5, 0.5])  # shares of the left and the right track in the difference [-]
LIMITS = {
    "scale": (0.2, 5.0),
    "gyro_scale": (0.2, 5.0),
    "track_latency": (-0.5, 0.5),
    "difference": (-0.4, 0.4),
}
"""Least and largest value of a parameter in the search, in its unit."""
STEP = 1e-4  # steps of the finite differences by lag, bias and gyro scale, in s, rad/s and 1


@dataclass(frozen=True)
class Problem:
    """Calibration problem: segments, model, and parameters."""

    recording: Recording  # the segments
    model: Model  # the motion model
    # all that may be free: of all logs, of each log (named "name[log]"), and of the model
    parameters: tuple[Parameter, ...]
    imu_position: tuple[float, float]  # position of the IMU in base_link, forward and left [m]
    force: bool  # True if the specific force is used

    @cached_property
    def forces(self) -> Floats:
        """Forces (n, m, 2) that the ground balances, see `Recording.ground_forces`."""
        return self.recording.ground_forces()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def start(self) -> Floats:
        """Initial values (p,)."""
        return np.array([parameter.start for parameter in self.parameters])

    def place(self, name: str) -> int:
        """Index of a parameter."""
        return self.names.index(name)

    def inside(self, values: Floats) -> Floats:
        """Nearest valid values (p,)."""
        result = values.copy()
        self.own(result)[:] = self.model.inside(self.own(values))
        for name, (least, largest) in LIMITS.items():
            place = self.place(name)
            result[place] = np.clip(result[place], least, largest)
        return result

    def rows(self, values: Floats) -> Floats:
        """Residuals (n, ROWS)."""
        return self._assemble(values, self.twist(values)[..., None])[0]

    def twist(self, values: Floats) -> Floats:
        """Twists (n, m, 3) of the model."""
        scale, difference, latency = (values[self.place(name)] for name in TRACK_PARAMETERS)
        speeds = scale * (1.0 + SIDES * difference) * self.recording.speeds(latency)
        return self.model.linearise(speeds, self.own(values), self.forces).twist

    def linearised(self, values: Floats) -> tuple[Floats, Floats]:
        """Residuals (n, ROWS) and their derivatives (n, ROWS, p)."""
        recording, common = self.recording, len(values) - len(self.model.parameters)
        scale, difference, latency = (values[self.place(name)] for name in TRACK_PARAMETERS)
        sides = 1.0 + SIDES * difference
        speeds = recording.speeds(latency)
        by_latency = (recording.speeds(latency + 0.01) - recording.speeds(latency - 0.01)) / 0.02
        at = self.model.linearise(scale * sides * speeds, self.own(values), self.forces)
        # Derivatives of the track speeds by `TRACK_PARAMETERS`.
        by_tracks = [sides * speeds, scale * SIDES * speeds, scale * sides * by_latency]
        twist_by_tracks = at.by_speeds @ np.stack(by_tracks, axis=-1)
        stacked = np.concatenate([at.twist[..., None], twist_by_tracks, at.by_parameters], -1)
        rows, linear = self._assemble(values, stacked)
        jacobian = np.zeros((*rows.shape, len(values)))
        for column, name in enumerate(TRACK_PARAMETERS):
            jacobian[..., self.place(name)] = linear[..., column]
        # Only the path determines the latency: the body accelerates with a lag of its own.
        jacobian[:, FORCE:, self.place("track_latency")] = 0.0
        jacobian[..., common:] = linear[..., len(TRACK_PARAMETERS) :]
        twist = at.twist[..., None]

        def by_finite_difference(places: list[int]) -> Floats:
            """Derivative (n, ROWS) by parameters that all change alike, at the same twists."""
            changed = values.copy()
            changed[places] += STEP
            changed_rows, _ = self._assemble(changed, twist)
            return (changed_rows - rows) / STEP

        for place, name in enumerate(self.names[:common]):
            # Other parameters of all logs.
            if name not in TRACK_PARAMETERS and "[" not in name:
                jacobian[..., place] = by_finite_difference([place])
        for name in ("gyro_bias", "lag", "offset_forward", "offset_left"):
            # Parameters of one log affect only that log's rows.
            places = [self.place(f"{name}[{log}]") for log in range(len(recording.motions))]
            derivative = by_finite_difference(places)
            for log, place in enumerate(places):
                of_log = recording.log == log
                jacobian[of_log, :, place] = derivative[of_log]
        return rows, jacobian

    def heading(self, values: Floats) -> tuple[Floats, Floats]:
        """Heading (n, m + 1) by the gyro at ends of cells, and its error (n,) [rad]."""
        recording = self.recording
        bias = self._by_segment(values, "gyro_bias")
        scale = values[self.place("gyro_scale")]
        turned = (recording.turned - bias[:, None] * recording.edges) / scale
        _, _, yaw = recording.knots(self._by_log(values, "lag"))
        at_start, at_end = yaw[recording.starts], yaw[recording.ends]
        # Rotation by the truth less that by the gyro.
        apart = wrap_angle(at_end - at_start - (turned[:, -1] - turned[:, 0]))
        offset = at_start - turned[:, 0] + 0.5 * apart
        return turned + offset[:, None], np.asarray(apart)

    def body_places(self, values: Floats) -> Floats:
        """Position (k, 2) of base_link at knots: the truth's point less the lever arm [m]."""
        place, rotation, _ = self.recording.knots(self._by_log(values, "lag"))
        lever = values[[self.place("lever_arm_forward"), self.place("lever_arm_left")]]
        return np.asarray(place - np.einsum("kij,j->ki", rotation, lever))

    def _assemble(self, values: Floats, twists: Floats) -> tuple[Floats, Floats]:
        """Residuals (n, ROWS), measured less predicted, and changes of them (n, ROWS, c).

        Of the twists (n, m, 3, 1 + c) the first is the model's, the others are changes of it: predicted
        rows are linear in the twists.
        """
        heading, apart = self.heading(values)
        predicted = self._predicted(values, heading, twists)
        return self._measured(values, heading, apart) - predicted[..., 0], -predicted[..., 1:]

    def _predicted(self, values: Floats, heading: Floats, twists: Floats) -> Floats:
        """Rows (n, ROWS, c) by twists (n, m, 3, c) and headings at ends of cells."""
        cell = self.recording.cell
        off_middle = 0.5 * (heading[:, 1:] + heading[:, :-1]) - middle_of(heading)[:, None]
        change = np.diff(heading, axis=1)
        # The chord of the arc of a cell is shorter than the arc.
        chord_time = np.sinc(change / (2.0 * np.pi)) * cell
        cos, sin = np.cos(off_middle) * chord_time, np.sin(off_middle) * chord_time
        forward, left, yaw = twists[:, :, 0], twists[:, :, 1], twists[:, :, 2]
        along = np.einsum("nm,nmc->nc", cos, forward) - np.einsum("nm,nmc->nc", sin, left)
        across = np.einsum("nm,nmc->nc", sin, forward) + np.einsum("nm,nmc->nc", cos, left)
        # The body turns later than its tracks: its lag adds to the latency of the path.
        turning_lag = values[self.place("turning_lag")]
        turned = cell * yaw.sum(axis=1) - turning_lag * (yaw[:, -1] - yaw[:, 0])
        forces = _mean_accelerations(change / cell, forward, left, self._marks, cell)
        motion = np.stack([along, across, turned, np.zeros_like(along)], axis=1)
        return np.concatenate([motion, *forces], axis=1)

    def _measured(self, values: Floats, heading: Floats, apart: Floats) -> Floats:
        """Rows (n, ROWS) by truth and IMU; headings and their error as from `heading`."""
        recording, rows = self.recording, np.zeros((len(heading), ROWS))
        body = self.body_places(values)
        steps = body[recording.ends] - body[recording.starts]
        rows[:, [ALONG, ACROSS]] = rotate(steps, -middle_of(heading))
        rows[:, SLIP], rows[:, YAW] = heading[:, -1] - heading[:, 0], apart
        if self.force:
            rates = np.diff(heading, axis=1) / recording.cell
            rows[:, FORCE:] = self._measured_forces(values, rates)
        return rows

    def _measured_forces(self, values: Floats, rate: Floats) -> Floats:
        """Forces (n, 2 BINS) on base_link, by the IMU and yaw rates (n, m) [m/s²]."""
        imu_x, imu_y = self.imu_position
        if "imu_forward" in self.names:
            imu_x += float(values[self.place("imu_forward")])
            imu_y += float(values[self.place("imu_left")])
        # Accelerations of the IMU's place about the origin: w x r is its velocity.
        forward, left, cell = -imu_y * rate[..., None], imu_x * rate[..., None], self.recording.cell
        about_x, about_y = _mean_accelerations(rate, forward, left, self._marks, cell)
        offset_x = self._by_segment(values, "offset_forward")[:, None]
        offset_y = self._by_segment(values, "offset_left")[:, None]
        x, y = np.moveaxis(rotate(self._imu_forces, values[self.place("mounting_yaw")]), -1, 0)
        force_x, force_y = x - about_x[..., 0] - offset_x, y - about_y[..., 0] - offset_y
        return np.concatenate([force_x, force_y], axis=1)

    @cached_property
    def _imu_forces(self) -> Floats:
        """Mean specific forces (n, BINS, 2) of the IMU, in its axes [m/s²]."""
        return self.recording.mean_force(self._marks)

    @property
    def _marks(self) -> Indexes:
        """Indices (BINS + 1,) of the cells in whose middles the parts of a segment end."""
        cells = self.recording.edges.shape[1] - 1
        return np.round(np.linspace(0, cells - 1, BINS + 1)).astype(np.int64)

    def own(self, values: NDArray[Any]) -> NDArray[Any]:
        """Part of values (p,) for the model's own parameters, which are last; a view."""
        return values[len(values) - len(self.model.parameters) :]

    def _by_log(self, values: Floats, name: str) -> Floats:
        """Values (logs,) of a parameter of each log."""
        logs = range(len(self.recording.motions))
        return np.array([values[self.place(f"{name}[{log}]")] for log in logs])

    def _by_segment(self, values: Floats, name: str) -> Floats:
        """Values (n,) of a parameter of each log, for each segment."""
        return np.asarray(self._by_log(values, name)[self.recording.log])

    def counted_rows(self) -> Flags:
        """Mask (n, ROWS) of rows that count: at standstill only turns, for the bias."""
        recording = self.recording
        result = np.repeat(recording.moving[:, None], ROWS, axis=1)
        result[:, SLIP] = True
        has_headings = np.array([motion.own_headings for motion in recording.motions])
        result[:, YAW] &= has_headings[recording.log]
        has_force = np.array([motion.force_integral is not None for motion in recording.motions])
        result[:, FORCE:] &= has_force[recording.log][:, None] & self.force
        return result


def middle_of(heading: Floats) -> Floats:
    """Middle heading (n,) of each segment, by those at ends of cells (n, m + 1) [rad]."""
    return np.asarray(0.5 * (heading[:, 0] + heading[:, -1]))


def _mean_accelerations(
    rate: Floats, forward: Floats, left: Floats, marks: Indexes, cell: float
) -> tuple[Floats, Floats]:
    """Mean accelerations (n, b, c) forward, left between marked cells (b + 1,) [m/s²].

    Velocities are (n, m, c) [m/s], yaw rates (n, m) [rad/s]; `cell` is the length of a cell [s].
    """
    turn = rate[..., None]
    spans = (np.diff(marks) * cell)[None, :, None]

    def integrals(values: Floats) -> Floats:
        """Integrals (n, b, c) from one marked cell to the next."""
        steps = 0.5 * cell * (values[:, 1:] + values[:, :-1])
        whole = np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)
        return np.asarray(np.diff(whole[:, marks], axis=1))

    x = np.diff(forward[:, marks], axis=1) - integrals(turn * left)
    y = np.diff(left[:, marks], axis=1) + integrals(turn * forward)
    return x / spans, y / spans


def problem_of(
    recording: Recording,
    model: Model,
    robot: Robot,
    *,
    lever_arm: tuple[float, float] | None,
    imu_place_known: bool,
) -> Problem:
    """Make the calibration problem of a model, for a robot as described by its file.

    A known lever arm of the truth in base_link [m] is not free. If neither it nor the place of the IMU is
    known, `PLACING_PARAMETERS` are held.
    """
    length = THRESHOLD * robot.vehicle.track_gauge
    force = any(motion.force_integral is not None for motion in recording.motions)
    # A threshold of zero holds a parameter.
    forward, left = lever_arm or (0.0, 0.0)
    lever_threshold = length if lever_arm is None else 0.0
    common = [
        Parameter("scale", "-", 1.0, 0.05, 1),
        Parameter("difference", "-", robot.tracks.difference, 0.05, 15),
        Parameter("track_latency", "s", 0.0, 0.1, 90),
        Parameter("turning_lag", "s", 0.0, 0.1, 91),
        Parameter("gyro_scale", "-", robot.imu.gyro_scale, 0.05, 2),
        Parameter("lever_arm_forward", "m", forward, lever_threshold, 10),
        Parameter("lever_arm_left", "m", left, lever_threshold, 11),
        Parameter("mounting_yaw", "rad", 0.0, np.radians(5.0), 85),
    ]
    if force and not imu_place_known:
        common += [
            Parameter("imu_forward", "m", 0.0, length, 95),
            Parameter("imu_left", "m", 0.0, length, 96),
        ]
    for log, motion in enumerate(recording.motions):
        common += [
            Parameter(f"gyro_bias[{log}]", "rad/s", motion.bias, 0.01, 3),
            Parameter(f"lag[{log}]", "s", motion.lag, 0.1, 4),
            Parameter(f"offset_forward[{log}]", "m/s²", 0.0, 0.5, 86),
            Parameter(f"offset_left[{log}]", "m/s²", 0.0, 0.5, 87),
        ]
    if lever_arm is None and not (force and imu_place_known):
        held = {p for p in model.parameters if p.name in PLACING_PARAMETERS}
        own = (p._replace(threshold=0.0) if p in held else p for p in model.parameters)
        model = replace(model, parameters=tuple(own))
    x, y, _ = robot.imu.position
    return Problem(recording, model, (*common, *model.parameters), (x, y), force)
