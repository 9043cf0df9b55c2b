"""A filter in traced numbers: its state, how measurements change it, and what it writes down."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.engine import model
from icreckon.estimator.engine.covariance import Covariance, Vector, dot
from icreckon.estimator.engine.layout import INPUTS, MOTION, TWIST, Layout, covariance_name
from icreckon.estimator.engine.model import ModelInputs, TracedModel, TracedTwist
from icreckon.estimator.filter.ekf import IMU_KEPT
from icreckon.estimator.filter.gate import LARGEST_REOPENING
from icreckon.estimator.motion.bounds import BOUND_ROUNDS, ROUNDING
from icreckon.estimator.motion.motion_model import VehicleConstants
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.emit import Kernel, Store
from icreckon.estimator.tracing.trace import Traced, minimum, select

FAST = tuple(range(s.FAST_SLIP.start, s.FAST_SLIP.stop))
# What is short of a bound by less is inside: rounding.
OUTSIDE = {64: ROUNDING, 32: 1e-6}
# A factor and a vector.
Part = tuple[Any, Vector]


class FilterShape(NamedTuple):
    """What the code of a filter depends on; all else are numbers that it reads.

    Attributes:
        states: indices of the uncertain ones, without the fast slip, ascending.
        absent: indices of parameters that are zero and stay so.
        model: the motion model.
        considered: consider states, which no measurement moves.
        bits: of each number, 64 or 32.
    """

    states: tuple[int, ...]
    absent: tuple[int, ...]
    model: TracedModel
    considered: tuple[int, ...] = ()
    bits: int = 64

    @property
    def layout(self) -> Layout:
        """Rows of the workspace."""
        return Layout(self.states, self.model)


class Lane:
    """One filter of many: its state and covariance, and where it reads and writes.

    Args:
        shape: of the filter.
        with_fast_slip: whether the fast slip of the step that has just ended still counts.
        judged: whether innovations and their covariances are stored, too.
    """

    def __init__(
        self, shape: FilterShape, *, with_fast_slip: bool = False, judged: bool = False
    ) -> None:
        trace.start(shape.bits)
        self.shape, self._judged = shape, judged
        self.layout = shape.layout
        self.rows, self._places = self.layout.rows, self.layout.constants
        self._states = states = (*shape.states, *FAST) if with_fast_slip else shape.states
        names: Any = VehicleConstants._fields
        vehicle = VehicleConstants(*(cast(Any, self.constant(name)) for name in names))
        memory = [self.row(f"memory{k}") for k in range(shape.model.memory)]
        self.model_inputs = ModelInputs(shape.model, vehicle, memory)
        self.fixed_for_imu = (*IMU_KEPT, *shape.considered)
        self.x = np.array([self._start(i) for i in range(s.SIZE)], dtype=object)
        pairs = [(i, j) for n, i in enumerate(states) for j in states[n:]]
        self.P = Covariance({(i, j): self.row(covariance_name(i, j)) for i, j in pairs})
        self.stores: dict[str, Any] = {}

    def _start(self, index: int) -> Any:
        if index in self._states:
            return self.row(f"x{index}")
        is_parameter = s.PARAMETERS.start <= index < s.PARAMETERS.stop
        if is_parameter and index not in self.shape.absent:
            return self.constant(f"fixed{index}")
        return trace.lift(0.0)

    def row(self, name: str) -> Traced:
        """A number of the lane."""
        return trace.lane_input("lanes", self.rows[name])

    def told(self, name: str) -> Traced:
        """A number that the lane is told."""
        return trace.lane_input("inputs", INPUTS[name])

    def constant(self, name: str) -> Traced:
        """A number that all lanes share."""
        return trace.uniform_input("constants", self._places[name])

    @property
    def eta(self) -> Any:
        """Typical steering efficiency index, see `MotionModel.steering_efficiency`."""
        return self.constant("eta") if self.shape.model.kind == "friction" else self.x[s.ETA0]

    def twist_model(self, slip_share: Any, left: Any, right: Any, guess: Any) -> TracedTwist:
        """Evaluate the body velocity at track speeds [m/s], see `model.twist_model`."""
        states = self.shape.states
        return model.twist_model(self.x, self.model_inputs, left, right, slip_share, states, guess)

    def store_twist(self, now: TracedTwist) -> None:
        """Store a body velocity and its covariance."""
        with_rows = [self.P.times(row) for row in now.rows]
        pairs = [(i, j) for i in range(3) for j in range(i, 3)]
        values = [*now.twist, *(dot(with_rows[i], now.rows[j]) for i, j in pairs)]
        self.stores.update(zip(TWIST, values, strict=True))

    def store_motion(self, now: TracedTwist) -> None:
        """Store a twist with all its derivatives, and the motion in the paper's axes."""
        motion = now.motion
        by_speeds = [by for row in now.by_speeds for by in row]
        values = [*motion.indices, motion.u, motion.force, *by_speeds]
        self.stores.update(zip(TWIST[:3], now.twist, strict=True))
        self.stores.update(zip(MOTION, values, strict=True))
        for axis, row in zip(TWIST[:3], now.rows, strict=True):
            for i in (*self.shape.states, *FAST):
                self.stores[f"{axis}_by_{i}"] = row.get(i, 0.0)

    def with_kept_derivatives(self, now: TracedTwist) -> TracedTwist:
        """Replace derivatives by the parameters with the smoothed ones of the newest step."""
        for axis, row in enumerate(now.rows):
            row.update({i: self.row(f"r{axis}_{i}") for i in self.layout.parameters if i in row})
        return now

    def kernel(
        self, name: str, flags: Sequence[Traced] = (), *, with_fast_slip: bool = False
    ) -> Kernel:
        """A kernel that writes down what has changed, state and covariance with it.

        Args:
            name: of the kernel.
            flags: what it returns, see `Kernel`.
            with_fast_slip: whether the fast slip is to be written down, too.
        """
        stores = dict(self.stores)
        states = (*self.shape.states, *FAST) if with_fast_slip else self.shape.states
        for n, i in enumerate(states):
            stores[f"x{i}"] = self.x[i]
            for j in states[n:]:
                stores[covariance_name(i, j)] = self.P.entry(i, j)
        changed = [
            Store("lanes", self.rows[row], trace.lift(value))
            for row, value in stores.items()
            if value is not self.row(row)
        ]
        return Kernel(name, array_rows(self.layout), changed, flags)

    # --- updates ---------------------------------------------------------------------------------

    def update(
        self,
        residual: Any,
        row: Vector,
        variance: Any,
        *parts: Part,
        kept: Iterable[int] = (),
        only: Any = True,
    ) -> None:
        """A scalar update, in the lanes where `only` holds; for `parts` see `gated`."""
        cross = self.P.times(_rest(row, parts), *parts)
        per_expected = 1.0 / (dot(cross, row) + variance)
        self._apply(residual, cross, select(only, per_expected, 0.0), kept)

    def _apply(self, residual: Any, cross: Vector, per_expected: Any, kept: Iterable[int]) -> None:
        for i, share in self.P.take(cross, per_expected, kept).items():
            self.x[i] = self.x[i] + share * residual

    def gated(
        self,
        sensor: str,
        residual: Any,
        row: Vector,
        variance: Any,
        *parts: Part,
        reopen: int,
        kept: Iterable[int] = (),
        only: Any = True,
    ) -> None:
        """A gated scalar update, see `Reckoning`; it is counted.

        Args:
            sensor: by what name.
            residual: measured less predicted.
            row: derivative of the prediction by the states.
            variance: of the measurement.
            parts: of the row, that it shares with others: factors and vectors, of states that have no
                other part in it.
            reopen: the state that is made uncertain when re-acquiring.
            kept: states that are not to be moved.
            only: in which lanes.
        """
        cross = self.P.times(_rest(row, parts), *parts)
        expected = dot(cross, row) + variance
        per_expected = 1.0 / expected
        square = residual * residual
        nis = square * per_expected
        if self._judged:
            asked = trace.truth_as_number(trace.lift_truth(only))
            self.stores[f"{sensor}_r"], self.stores[f"{sensor}_rr"] = residual, asked * expected
        in_a_row = self.row(f"{sensor}_row")
        admitted = nis <= self.constant("threshold")
        reacquired = trace.lift_truth(only) & ~admitted & (in_a_row >= self.constant("patience"))
        more = minimum(square, LARGEST_REOPENING * expected)
        along = row.get(reopen, 0.0)

        added, per_expected = trace.where_needed(
            reacquired,
            [0.0, per_expected],
            lambda: [more, 1.0 / (expected + more * along * along)],
        )
        if reopen not in self.shape.considered:
            # The variance of a consider state stays; the measurement is less certain instead.
            self.P.add(reopen, reopen, added)
            cross[reopen] = cross[reopen] + added * along
        used = admitted | reacquired
        self._apply(residual, cross, select(trace.lift_truth(only) & used, per_expected, 0.0), kept)
        self.count(sensor, nis, admitted, used, only)

    def count(self, sensor: str, nis: Any, admitted: Any, used: Any, only: Any) -> None:
        """Count what a gate has said, where it was asked."""
        asked = trace.lift_truth(only)
        one = trace.truth_as_number
        in_a_row = self.row(f"{sensor}_row")
        self.stores[f"{sensor}_row"] = select(asked, select(used, 0.0, in_a_row + 1.0), in_a_row)
        for name, more in (
            ("used", one(asked & used)),
            ("rejected", one(asked & ~used)),
            ("judged", one(asked & admitted)),
            ("nis", select(asked & admitted, nis, 0.0)),
        ):
            self.stores[f"{sensor}_{name}"] = self.row(f"{sensor}_{name}") + more

    def keep_inside_bounds(self) -> None:
        """See `IcrEkf.keep_inside_bounds`; what it costs is paid only where a lane is outside."""
        states, least_short = self.P.states, OUTSIDE[self.shape.bits]
        considered = self.shape.considered
        bounds = [bound for bound in self._bounds() if not bound[0].keys() <= {*considered}]
        if not bounds:
            return
        x, moving = self.x, [i for i in states if i not in self.fixed_for_imu]
        outside = trace.lift_truth(False)
        for direction, rest, least in bounds:
            outside = outside | (least - rest - dot(x_of(x, direction), direction) > least_short)

        def a_round(*values: Any) -> Any:
            now, moved = dict(zip(states, values, strict=True)), trace.lift_truth(False)
            for direction, rest, least in bounds:
                free = {i: by for i, by in direction.items() if i not in considered}
                cross = self.P.times(free)
                spread = dot(cross, free)
                short = least - rest - dot(now, direction)
                moves = (short > least_short) & (spread > 0.0)
                share = select(moves, short / spread, 0.0)
                now |= {i: now[i] + cross[i] * share for i in moving}
                moved = moved | moves
            return [now[i] for i in states], moved

        inside = trace.repeat(outside, [x[i] for i in states], a_round, BOUND_ROUNDS)
        for i, value in zip(states, inside, strict=False):
            x[i] = value

    def _bounds(self) -> Iterable[tuple[Vector, Any, Any]]:
        """Each bound by the uncertain states, what the others come to, and what it must reach."""
        for number, places in enumerate(self.shape.model.bounds):
            of = {s.PARAMETERS.start + k: self.constant(f"bound{number}_{k}") for k in places}
            known = {i: self.x[i] for i in of if i not in self.shape.states}
            mine = {i: share for i, share in of.items() if i in self.shape.states}
            least = self.constant(f"bound{number}_8")
            yield mine, dot(known, {i: of[i] for i in known}), least


def array_rows(layout: Layout) -> tuple[int, int, int]:
    """Number of rows of each of `ARRAYS`; of the constants, which all lanes share, of numbers."""
    return len(layout.rows), len(INPUTS), len(layout.constants)


def idle_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make a kernel that does nothing."""
    return Kernel(name, array_rows(shape.layout), ())


def _rest(row: Vector, parts: Iterable[Part]) -> Vector:
    """What of a row is in none of its parts."""
    shared = {i for _, part in parts for i in part}
    return {i: value for i, value in row.items() if i not in shared}


def x_of(x: Any, row: Vector) -> Vector:
    """The states that a row has."""
    return {i: x[i] for i in row}
