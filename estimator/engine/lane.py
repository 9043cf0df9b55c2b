"""One filter in traced numbers: state, covariance, updates, and values to store."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.engine import model
from icreckon.estimator.engine.covariance import Covariance, Vector, dot
from icreckon.estimator.engine.layout import INPUTS, MOTION, TWIST, Layout, covariance_name
from icreckon.estimator.engine.model import ModelInputs, TracedModel, TracedTwist
from icreckon.estimator.filter.ekf import ROUNDING_SHARE, SHARP, WHOLE
from icreckon.estimator.filter.gate import LARGEST_INFLATION
from icreckon.estimator.motion import linear_model
from icreckon.estimator.motion.bounds import BOUND_ROUNDS, ROUNDING
from icreckon.estimator.motion.motion_model import VehicleConstants
from icreckon.estimator.sensors.measurement_models import POSE_FIXED, gyro_fixed, imu_fixed
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.emit import Kernel, Store
from icreckon.estimator.tracing.trace import Traced, minimum, select

FAST = tuple(range(s.FAST_SLIP.start, s.FAST_SLIP.stop))
# A value that violates a bound by less is inside: that is rounding. By bits of a number.
OUTSIDE = {64: ROUNDING, 32: 1e-6}
# A factor and a vector.
Part = tuple[Any, Vector]


class FilterShape(NamedTuple):
    """Shape of a filter: all properties that its compiled code depends on.

    Attributes:
        states: indices of the uncertain states, without the fast slip, ascending; the wander of the
            fixes with them, if the filter estimates it.
        absent: indices of parameters that are zero and stay so.
        model: the motion model.
        considered: consider states, which no measurement moves.
        bits: number of bits of each number, 64 or 32.
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
    """One filter of many: state and covariance, and the rows that it reads and writes.

    Args:
        shape: shape of the filter.
        with_fast_slip: the fast slip of the step that has just ended is still a state.
        innovations: store innovations and their covariances, too.
    """

    def __init__(
        self, shape: FilterShape, *, with_fast_slip: bool = False, innovations: bool = False
    ) -> None:
        trace.start(shape.bits)
        self.shape, self._innovations = shape, innovations
        self.layout = shape.layout
        self.rows, self._places = self.layout.rows, self.layout.constants
        self._states = states = (*shape.states, *FAST) if with_fast_slip else shape.states
        names: Any = VehicleConstants._fields
        vehicle = VehicleConstants(*(cast(Any, self.constant(name)) for name in names))
        memory = [self.row(f"memory{k}") for k in range(shape.model.memory)]
        self.model_inputs = ModelInputs(shape.model, vehicle, memory)
        wander = tuple(i for i in states if i >= s.SIZE)
        self.fixed_for_imu = (*imu_fixed(shape.model.taught), *shape.considered, *wander)
        self.fixed_for_gyro = (*gyro_fixed(shape.model.taught), *shape.considered, *wander)
        size = s.SIZE + len(wander)
        self.x = np.array([self._start(i) for i in range(size)], dtype=object)
        pairs = [(min(i, j), max(i, j)) for n, i in enumerate(states) for j in states[n:]]
        self.P = Covariance({(i, j): self.row(covariance_name(i, j)) for i, j in pairs})
        self.stores: dict[str, Any] = {}
        # Number of sharp updates.
        self._sharp: Any = trace.lift(0.0)

    def _start(self, index: int) -> Any:
        if index in self._states:
            return self.row(f"x{index}")
        is_parameter = s.PARAMETERS.start <= index < s.PARAMETERS.stop
        if is_parameter and index not in self.shape.absent:
            return self.constant(f"fixed{index}")
        return trace.lift(0.0)

    def row(self, name: str) -> Traced:
        """Number in a row of the workspace."""
        return trace.lane_input("lanes", self.rows[name])

    def input(self, name: str) -> Traced:
        """Input of the step, see `icreckon.estimator.engine.layout.INPUTS`."""
        return trace.lane_input("inputs", INPUTS[name])

    def constant(self, name: str) -> Traced:
        """Constant that all lanes share."""
        return trace.uniform_input("constants", self._places[name])

    @property
    def eta(self) -> Any:
        """Typical steering efficiency index, see `MotionModel.steering_efficiency`."""
        if self.shape.model.kind == "linear":
            vehicle = self.model_inputs.vehicle
            return linear_model.steering_efficiency(tuple(self.x[s.PARAMETERS]), vehicle)
        return self.x[s.ETA0]

    def advance_model(self, dt: Any, left: Any, right: Any) -> None:
        """Advance the memory of an index model by a step, at mean track speeds [m/s]."""
        after = model.advanced_memory(self.x, self.model_inputs, left, right, dt)
        self.stores.update({f"memory{k}": value for k, value in enumerate(after)})
        self.model_inputs = self.model_inputs._replace(memory=after)

    def twist_model(self, left: Any, right: Any, slip_shares: Any = WHOLE) -> TracedTwist:
        """Evaluate the body velocity at track speeds [m/s], see `model.twist_model`."""
        states = self.shape.states
        return model.twist_model(self.x, self.model_inputs, left, right, slip_shares, states)

    def store_twist(self, now: TracedTwist) -> None:
        """Store a body velocity and its covariance."""
        with_rows = [self.P.times(row) for row in now.rows]
        pairs = [(i, j) for i in range(3) for j in range(i, 3)]
        found = {(i, j): dot(with_rows[i], now.rows[j]) for i, j in pairs}
        fastest = self.constant("fastest")
        kept = [model.share_of_sigma(found[axis, axis], fastest) for axis in (0, 1)] + [1.0]
        values = [*now.twist, *(kept[i] * kept[j] * found[i, j] for i, j in pairs)]
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

    def with_smoothed_derivatives(self, now: TracedTwist) -> TracedTwist:
        """Replace derivatives by the parameters with the regressors of the newest step."""
        for axis, row in enumerate(now.rows):
            row.update({i: self.row(f"r{axis}_{i}") for i in self.layout.parameters if i in row})
        return now

    def kernel(
        self, name: str, flags: Sequence[Traced] = (), *, with_fast_slip: bool = False
    ) -> Kernel:
        """Make a kernel that stores state, covariance and all other changed values.

        Args:
            name: name of the kernel.
            flags: flags that it returns, see `Kernel`.
            with_fast_slip: store the fast slip, too.
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
        z: Any,
        H: Vector,
        R: Any,
        *parts: Part,
        fixed: Iterable[int] = (),
        only: Any = True,
    ) -> None:
        """Update with a scalar measurement, without a gate; for the arguments see `gated`."""
        cross = self.P.times(_rest(H, parts), *parts)
        inverse_S = 1.0 / (dot(cross, H) + R)
        self._apply(z, cross, R, select(only, inverse_S, 0.0), fixed)

    def _apply(
        self,
        z: Any,
        cross: Vector,
        R: Any,
        inverse_S: Any,
        fixed: Iterable[int],
        stand_in: tuple[int, Vector] | None = None,
    ) -> None:
        is_sharp = (R * inverse_S < SHARP) & (inverse_S > 0.0)
        self._sharp = self._sharp + select(is_sharp, 1.0, 0.0)
        for i, gain in self.P.update(cross, inverse_S, fixed, stand_in).items():
            self.x[i] = self.x[i] + gain * z

    def gated(
        self,
        sensor: str,
        z: Any,
        H: Vector,
        R: Any,
        *parts: Part,
        inflated: int,
        fixed: Iterable[int] = (),
        stand_in: int | None = None,
        only: Any = True,
        patience: Any = None,
        interval: Any = None,
    ) -> None:
        """Gate, update and count a scalar, see `icreckon.estimator.filter.update`.

        Args:
            sensor: name of the sensor.
            z: innovation.
            H: derivative of the predicted measurement by the states.
            R: variance of the measurement noise.
            parts: parts of H that other measurements have, too: factors and vectors, of states with no
                other part in H.
            inflated: state whose variance is inflated in re-acquisition.
            fixed: states that the update does not move.
            stand_in: state that it moves in their place, see `IcrEkf.update_scalar`.
            only: lanes that have the measurement.
            patience: time of rejections after which it is re-acquired [s]; None for that of the IMU.
            interval: time that it counts if it is rejected [s]; None for that of the IMU.
        """
        patience = self.constant("imu_patience") if patience is None else patience
        interval = self.constant("interval") if interval is None else interval
        cross = self.P.times(_rest(H, parts), *parts)
        S = dot(cross, H) + R
        inverse_S = 1.0 / S
        square = z * z
        nis = square * inverse_S
        if self._innovations:
            tested = trace.truth_as_number(trace.lift_truth(only))
            self.stores[f"{sensor}_z"], self.stores[f"{sensor}_S"] = z, tested * S
        admitted = nis <= self.constant("threshold")
        patience_ends = self.row(f"{sensor}_rejected_for") >= patience
        reacquired = trace.lift_truth(only) & ~admitted & patience_ends
        more = minimum(square, LARGEST_INFLATION * S)
        along = H.get(inflated, 0.0)

        added, inverse_S = trace.where_needed(
            reacquired,
            [0.0, inverse_S],
            lambda: [more, 1.0 / (S + more * along * along)],
        )
        if inflated not in self.shape.considered:
            # A considered state cannot be moved: R is inflated instead.
            self.P.add(inflated, inflated, added)
            cross[inflated] = cross[inflated] + added * along
        used = admitted | reacquired
        inverse_S = select(trace.lift_truth(only) & used, inverse_S, 0.0)
        self._apply(z, cross, R, inverse_S, fixed, None if stand_in is None else (stand_in, H))
        self.count(sensor, nis, admitted, used, only, interval)

    def count(
        self, sensor: str, nis: Any, admitted: Any, used: Any, only: Any, interval: Any
    ) -> None:
        """Count verdicts of a gate, in the lanes that have the measurement."""
        tested = trace.lift_truth(only)
        one = trace.truth_as_number
        before = self.row(f"{sensor}_rejected_for")
        after = select(used, 0.0, before + interval)
        self.stores[f"{sensor}_rejected_for"] = select(tested, after, before)
        for name, more in (
            ("used", one(tested & used)),
            ("rejected", one(tested & ~used)),
            ("admitted", one(tested & admitted)),
            ("nis", select(tested & admitted, nis, 0.0)),
        ):
            self.stores[f"{sensor}_{name}"] = self.row(f"{sensor}_{name}") + more

    def add_doubt(self, bias: Any, shared: Any, yaw: Any) -> None:
        """Inflate the gyro's bias and the yaw, see `filter.slip_factor.doubt`."""
        if s.GYRO_BIAS in self.P.states and s.GYRO_BIAS not in self.shape.considered:
            self.P.add(s.GYRO_BIAS, s.GYRO_BIAS, bias)
            self.P.add(s.YAW, s.GYRO_BIAS, shared)
        self.P.add(s.YAW, s.YAW, yaw)

    def cover_rounding(self) -> None:
        """Inflate the states after sharp updates, as `IcrEkf.update_scalar` after each.

        Single precision is for studies, whose sensors are not sharp.
        """
        if self.shape.bits == 64:
            self.P.inflate(ROUNDING_SHARE * self._sharp)

    def keep_inside_bounds(self, *, by_imu: bool = False) -> None:
        """Project onto the bounds as `IcrEkf.keep_inside_bounds`, if a lane is outside."""
        states, least_short = self.P.states, OUTSIDE[self.shape.bits]
        fixed = self.fixed_for_gyro if by_imu else (*POSE_FIXED, *self.shape.considered)
        bounds = [bound for bound in self._bounds() if not bound[0].keys() <= {*fixed}]
        if not bounds:
            return
        x, moving = self.x, [i for i in states if i not in fixed]
        outside = trace.lift_truth(False)
        for direction, rest, least in bounds:
            outside = outside | (least - rest - dot(x_of(x, direction), direction) > least_short)

        def a_round(*values: Any) -> Any:
            now, moved = dict(zip(states, values, strict=True)), trace.lift_truth(False)
            for direction, rest, least in bounds:
                free = {i: by for i, by in direction.items() if i not in fixed}
                cross = self.P.times(free)
                variance = dot(cross, free)
                short = least - rest - dot(now, direction)
                moves = (short > least_short) & (variance > 0.0)
                per_cross = select(moves, short / variance, 0.0)
                now |= {i: now[i] + cross[i] * per_cross for i in moving}
                moved = moved | moves
            return [now[i] for i in states], moved

        inside = trace.repeat(outside, [x[i] for i in states], a_round, BOUND_ROUNDS)
        for i, value in zip(states, inside, strict=False):
            x[i] = value

    def _bounds(self) -> Iterable[tuple[Vector, Any, Any]]:
        """Bounds: rows by uncertain states, sums over all other states, lower limits."""
        for number, places in enumerate(self.shape.model.bounds):
            of = {s.PARAMETERS.start + k: self.constant(f"bound{number}_{k}") for k in places}
            certain = {i: self.x[i] for i in of if i not in self.shape.states}
            uncertain = {i: by for i, by in of.items() if i in self.shape.states}
            least = self.constant(f"bound{number}_{s.PARAMETER_COUNT}")
            yield uncertain, dot(certain, {i: of[i] for i in certain}), least


def array_rows(layout: Layout) -> tuple[int, int, int]:
    """Number of rows of each of `ARRAYS`; number of constants, which all lanes share."""
    return len(layout.rows), len(INPUTS), len(layout.constants)


def idle_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make a kernel that computes nothing."""
    return Kernel(name, array_rows(shape.layout), ())


def _rest(row: Vector, parts: Iterable[Part]) -> Vector:
    """Entries of a row that are in none of its parts."""
    shared = {i for _, part in parts for i in part}
    return {i: value for i, value in row.items() if i not in shared}


def x_of(x: Any, row: Vector) -> Vector:
    """Values of the states that a row has."""
    return {i: x[i] for i in row}
