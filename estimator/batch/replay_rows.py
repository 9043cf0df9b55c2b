"""Rows and counts of a replay, from the outputs of filters side by side."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.batch.front_end import Measured
from icreckon.estimator.engine.filters import BatchFilter, Lanes
from icreckon.estimator.engine.layout import GATES, IMU_GATES, INPUTS
from icreckon.estimator.engine.schedule import (
    HEADING,
    POSITION,
    TICK,
    UPDATE,
    Bytes,
    LogSteps,
    Steps,
)
from icreckon.estimator.engine.work import ESTIMATE
from icreckon.estimator.filter.gate import CHI_SQUARE_1E4, RECENT, SKIPPED
from icreckon.estimator.filter.health import ADMITTED, REACQUIRED, REJECTED, Health
from icreckon.estimator.motion import lagged_index_model, linear_model
from icreckon.estimator.motion.motion_model import NO_SLIP, gravity_in, track_factors
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.variants import state_names
from icreckon.estimator.sensors.measurement_models import innovation_components
from icreckon.estimator.streaming.outputs import Run, Snapshot
from icreckon.estimator.streaming.run import Rows

# Number of steps at the end whose innovations are output, rows or not. The mean NIS over recent ones
# fades by a hundredth with each, so less than 1e-13 of it is older.
OUTPUT_AT_END = 3000
# Degrees of freedom of each gate.
DEGREES = {gate: 2 if gate == "position" else 1 for gate in GATES}
FIRST_OF_TWIST = ESTIMATE.index("v_x")
# Entries (i, j) on the diagonal and above it, row by row, in their places in a matrix.
SYMMETRIC = [0, 1, 2, 1, 3, 4, 2, 4, 5]


Indices = NDArray[np.intp]
Truths = NDArray[np.bool_]


class Gated(NamedTuple):
    """Newest innovation of a sensor: stamp [ns], innovation, its covariance, NIS."""

    stamp: int
    residual: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    nis: float


class ReplayRows:
    """Rows of one filter's run.

    Args:
        one: the filter.
        robot: the robot.
        steps: steps of the log.
        measured: measurements of the log.
        headings: 1 for each fix with a heading.
        stamps: (k,) of the rows [ns], which the runs share.
    """

    def __init__(
        self,
        one: BatchFilter,
        robot: Robot,
        steps: LogSteps,
        measured: Measured,
        headings: Bytes,
        stamps: Stamps,
    ) -> None:
        count = len(steps.row_stamps)
        self._steps, self._measured, self._headings = steps, measured, headings
        self._rows = Rows(count)
        self._rows.stamps[:], self._rows.states[:] = stamps, one.start
        self._robot = robot
        self._output_states = one.layout.output_states
        self._places = {
            name: len(ESTIMATE) + place for place, name in enumerate(one.layout.more_outputs)
        }
        self._kind = one.layout.model.kind
        self._output_memory = [self._places[f"memory{k}"] for k in range(one.shape.model.memory)]
        self._count = count
        # True for each fix that was used or rejected by the gate.
        self._is_judged = np.zeros(len(headings), dtype=bool)
        self._newest: dict[str, Gated] = {}
        self._nis: dict[str, deque[float]] = {}

    def put_first(self, estimate: Snapshot) -> None:
        """Fill the first row with the estimate before any step."""
        self._rows.put(0, estimate)

    def add(self, begin: int, end: int, part: Steps, inputs: Floats, room: Floats) -> None:
        """Fill the rows of some steps.

        Args:
            begin: the first of the steps.
            end: one after the last.
            part: the steps.
            inputs: (n, k) inputs of the steps.
            room: (n, k) estimates at their ticks.
        """
        at = np.flatnonzero(part.extras & TICK)
        if not len(at):
            return
        values, with_fix = room[: len(at)], (part.extras[at] & POSITION) > 0
        judged = inputs[at, INPUTS["fix_mode"]] != SKIPPED
        self._is_judged[part.fixes[at[with_fix]]] = judged[with_fix]
        self._add_innovations(part, at, values, with_fix & judged)
        rows = self._steps.rows[begin:end][at]
        is_row = rows >= 0
        # If an estimate is output again after a fix, the last counts.
        is_row[:-1] &= rows[:-1] != rows[1:]
        if not is_row.any():
            return
        values, rows = values[is_row], rows[is_row]
        row_range = slice(int(rows[0]), int(rows[-1]) + 1)
        speeds = inputs[at[is_row]][:, [INPUTS["now_left"], INPUTS["now_right"]]]
        states, sigmas = self._rows.states[row_range], self._rows.sigmas[row_range]
        states[:, s.POSE] = values[:, :3]
        covariances = self._rows.pose_covariances[row_range]
        covariances[:] = values[:, 3:9][:, SYMMETRIC].reshape(-1, 3, 3)
        sigmas[:, s.POSE] = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
        count, first = len(self._output_states), len(ESTIMATE)
        states[:, self._output_states] = values[:, first : first + count]
        sigmas[:, self._output_states] = np.sqrt(values[:, first + count : first + 2 * count])
        twist = FIRST_OF_TWIST
        self._rows.twists[row_range] = values[:, twist : twist + 3]
        covariance = values[:, twist + 3 : twist + 9]
        self._rows.twist_covariances[row_range] = covariance[:, SYMMETRIC].reshape(-1, 3, 3)
        memory = values[:, self._output_memory]
        self._rows.indices[row_range] = self._indices(row_range, speeds, memory)
        self._write_innovations(row_range, values)

    def _column(self, values: Floats, name: str) -> Floats:
        return values[:, self._places[name]]

    def _add_innovations(
        self, part: Steps, at: Indices, values: Floats, with_position: Truths
    ) -> None:
        """Record the newest innovations of the gates."""
        extras = part.extras[at]
        when = dict.fromkeys(IMU_GATES, part.kinds[at] <= UPDATE)
        when["heading"] = (extras & HEADING) > 0
        for gate, may_be in when.items():
            z, S = self._column(values, f"{gate}_z"), self._column(values, f"{gate}_S")
            gated = np.flatnonzero(may_be & (S > 0.0))[-OUTPUT_AT_END:]
            if len(gated):
                last, nis = gated[-1], z[gated] ** 2 / S[gated]
                innovation = (float(z[last]),), ((float(S[last]),),)
                self._record(gate, int(part.ends[at[last]]), *innovation, nis)
        gated = np.flatnonzero(with_position)[-OUTPUT_AT_END:]
        if len(gated):
            x, y, xx, xy, yy = (
                self._column(values, f"position_{name}")[gated]
                for name in ("z_x", "z_y", "S_xx", "S_xy", "S_yy")
            )
            nis = (x * (x * yy - y * xy) + y * (y * xx - x * xy)) / (xx * yy - xy * xy)
            across = float(xy[-1])
            covariance = (float(xx[-1]), across), (across, float(yy[-1]))
            stamp = int(part.ends[at[gated[-1]]])
            self._record("position", stamp, (float(x[-1]), float(y[-1])), covariance, nis)

    def _record(
        self,
        gate: str,
        stamp: int,
        residual: tuple[float, ...],
        covariance: tuple[tuple[float, ...], ...],
        nis: Floats,
    ) -> None:
        """Record the newest innovation of a gate, and the NIS of all new ones."""
        begin = int(self._measured.track_stamps[0])
        self._newest[gate] = Gated(begin + stamp, residual, covariance, float(nis[-1]))
        self._nis.setdefault(gate, deque(maxlen=OUTPUT_AT_END)).extend(nis.tolist())

    def _write_innovations(self, row_range: slice, values: Floats) -> None:
        with_sample = self._steps.row_samples[row_range] > 0
        fixes = self._steps.row_fixes[row_range]
        with_fix = fixes >= 0
        for gate in IMU_GATES:
            z, S = self._column(values, f"{gate}_z"), self._column(values, f"{gate}_S")
            self._write_normalised(gate, row_range, z, S, with_sample)
        if not with_fix.any():
            return
        with_position = with_fix & self._has_judged(row_range, fixes)
        for axis in "xy":
            z = self._column(values, f"position_z_{axis}")
            S = self._column(values, f"position_S_{axis * 2}")
            self._write_normalised(f"position_{axis}", row_range, z, S, with_position)
        headed = with_fix & (self._headings[fixes] > 0)
        z, S = self._column(values, "heading_z"), self._column(values, "heading_S")
        self._write_normalised("heading", row_range, z, S, headed)

    def _has_judged(self, row_range: slice, fixes: NDArray[np.int32]) -> Truths:
        """True for rows with a fix, used or rejected by the gate, since the row before."""
        counts = np.concatenate([[0], np.cumsum(self._is_judged)])
        before = self._steps.row_fixes[: row_range.start].max(initial=-1)
        newest = np.maximum.accumulate(np.concatenate([[before], fixes]))
        return np.asarray(counts[newest[1:] + 1] > counts[newest[:-1] + 1])

    def _write_normalised(
        self, name: str, row_range: slice, z: Floats, S: Floats, when: Truths
    ) -> None:
        when = when & (S > 0.0)
        if not when.any():
            return
        column = self._rows.innovations.column(name)[row_range]
        column[when] = z[when] / np.sqrt(S[when])

    def finish(self, variant: str, one: BatchFilter, lanes: Lanes, health: Health) -> Run:
        """Run of the filter.

        Args:
            variant: name of the variant.
            one: the filter.
            lanes: the filter's lanes at the end.
            health: counts of the measurements without gates; those of the gates are added.
        """
        self._write_first_innovations(health)
        self.count(one, lanes, health)
        return self._rows.finish(self._count, variant, state_names(variant), health)

    def _write_first_innovations(self, health: Health) -> None:
        """Fill the first row with the innovations before the first track speeds."""
        components = innovation_components()
        for sensor, counts in health.sensors.items():
            if counts.newest_judged is None or not self._count:
                continue
            _, _, residual, covariance = counts.newest_judged
            for axis, name in enumerate(components[sensor]):
                column = self._rows.innovations.column(name)
                if np.isnan(column[0]):
                    column[0] = residual[axis] / math.sqrt(covariance[axis][axis])

    def _indices(self, row_range: slice, speeds: Floats, memory: Floats) -> Floats:
        """Indices (n, 3) of rows, at their newest track speeds.

        Args:
            row_range: the rows; their states are filled.
            speeds: (n, 2) speeds of the left and the right track in these rows [m/s].
            memory: (n, k) output memory of the motion model in these rows.
        """
        kind, constants = self._kind, self._robot.constants
        x = self._rows.states[row_range].T
        left, right = speeds.T
        on_both = (left * track_factors(x)[0], right * track_factors(x)[1])
        parameters, on_ground = tuple(x[s.PARAMETERS]), gravity_in(x)
        if kind == "index":
            at = lagged_index_model.evaluate(*on_both, parameters, on_ground, constants, memory.T)
            return np.stack(np.broadcast_arrays(*at.indices), axis=-1)
        motion, _ = linear_model.linearise(*on_both, parameters, NO_SLIP, on_ground, constants)
        return np.stack(np.broadcast_arrays(*motion.indices), axis=-1)

    def count(self, one: BatchFilter, lanes: Lanes, health: Health) -> None:
        """Add the counts of the gates and the newest innovations to `health`."""
        counts = {name: float(values[0]) for name, values in one.counts(lanes).items()}
        health.standstill_updates += int(counts["standstill"])
        for gate, degrees in DEGREES.items():
            used, rejected = int(counts[f"{gate}_used"]), int(counts[f"{gate}_rejected"])
            if not used + rejected:
                continue
            sensor, admitted = health.sensor(gate), int(counts[f"{gate}_admitted"])
            sensor.used += used
            sensor.nis_sum += counts[f"{gate}_nis"]
            if rejected:
                sensor.rejected["gate"] = sensor.rejected.get("gate", 0) + rejected
            sensor.degrees += degrees * admitted
            sensor.judged_count += used + rejected
            sensor.reacquired += used - admitted
            newest = self._newest.get(gate)
            if newest is None:
                continue
            verdict = ADMITTED
            if newest.nis > CHI_SQUARE_1E4[degrees]:
                verdict = REJECTED if counts[f"{gate}_rejected_for"] > 0.0 else REACQUIRED
            sensor.newest_judged = newest.stamp, verdict, newest.residual, newest.covariance
            sensor.newest_nis = newest.nis
            sensor.recent_nis = _recent(
                self._nis[gate], sensor.judged_count, degrees, sensor.recent_nis or 0.0
            )


def _recent(nis: Iterable[float], count: int, degrees: int, before: float) -> float:
    """Mean NIS as in `GateRecord.recent_nis` after `count` innovations."""
    values, mean = list(nis), before
    for number, value in enumerate(values, count - len(values) + 1):
        mean += (value / degrees - mean) / min(number, RECENT)
    return mean
