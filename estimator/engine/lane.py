"""One filter in numbers: state, covariance, updates, and values to store.

The numbers are traced ones, of which a compiler makes machine code, or plain ones (`plain_kernel`).
"""

from collections.abc import Iterable, Sequence
from functools import cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.engine import model
from icreckon.estimator.engine.covariance import Covariance, States, Vector, dot
from icreckon.estimator.engine.layout import INPUTS, MOTION, TWIST, Layout, covariance_name
from icreckon.estimator.engine.model import ModelInputs, TracedModel, TracedTwist
from icreckon.estimator.filter.changes import Event
from icreckon.estimator.filter.ekf import ROUNDING_SHARE, SHARP, WHOLE
from icreckon.estimator.filter.gate import LARGEST_INFLATION
from icreckon.estimator.motion import linear_model
from icreckon.estimator.motion.bounds import BOUND_ROUNDS, ROUNDING
from icreckon.estimator.motion.motion_model import MotionModel, VehicleConstants
from icreckon.estimator.robot.robot_file import Slip
from icreckon.estimator.sensors.measurement_models import POSE_FIXED, gyro_fixed, imu_fixed
from icreckon.estimator.sensors.sensor_models import STANDSTILL_VARIANCE
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.kernel import FLAG_BITS, Kernel, Store
from icreckon.estimator.tracing.trace import Real, Truth, minimum, select

FAST = tuple(range(s.FAST_SLIP.start, s.FAST_SLIP.stop))
# A value that violates a bound by less is inside: that is rounding. By bits of a number.
OUTSIDE = {64: ROUNDING, 32: 1e-6}
# As `ekf.SHARP` and `ekf.ROUNDING_SHARE`, by bits of a number; of 32 by `test_c_day.py`.
SHARP_UPDATES = {64: (SHARP, ROUNDING_SHARE), 32: (1e-3, 2.0**-18)}
Part = tuple[Real, Vector]  # a factor and a vector


class FilterShape(NamedTuple):
    """Shape of a filter: all properties that its compiled code depends on."""

    # indices of the uncertain states, without the fast slip, ascending; the wander of the fixes with
    # them, if the filter estimates it
    states: tuple[int, ...]
    absent: tuple[int, ...]  # indices of parameters that are zero and stay so
    model: TracedModel  # the motion model
    considered: tuple[int, ...] = ()  # consider states, which no measurement moves
    bits: int = 64  # number of bits of each number, 64 or 32
    # kernels report all changes of the filter, see `icreckon.estimator.filter.changes`
    reports: bool = False

    @property
    def layout(self) -> Layout:
        """Rows of the workspace."""
        return _layout(self.states, self.model, self.reports)


@cache
def _layout(states: tuple[int, ...], model: TracedModel, reports: bool) -> Layout:
    return Layout(states, model, reports)


class PlainNumbers(NamedTuple):
    """Plain numbers of one lane."""

    lanes: Any  # (n,) its rows of the workspace
    inputs: Any  # (m,) its inputs
    constants: Any  # constants of all lanes
    of_user: MotionModel | None = None  # motion model that has no traced form; None if it has one


class Bound(NamedTuple):
    """Lower limit of a weighted sum of parameters."""

    weights: Vector  # weights of the uncertain ones
    certain: Real  # part of the sum by the others
    least: Real  # the limit

    def shortfall(self, values: Vector) -> Real:
        """Distance of the sum below the limit, for values of the uncertain parameters."""
        return self.least - self.certain - dot(values, self.weights)


class Lane:
    """One filter of many: state and covariance, and the rows that it reads and writes.

    `row`, `input` and `constant` return traced numbers or, with `numbers`, plain ones; all others follow
    from these.

    Args:
        shape: shape of the filter.
        numbers: plain numbers to compute with; None for traced ones.
        with_fast_slip: the fast slip of the step that has just ended is still a state.
        innovations: store innovations and their covariances, too.
    """

    def __init__(
        self,
        shape: FilterShape,
        numbers: PlainNumbers | None = None,
        *,
        with_fast_slip: bool = False,
        innovations: bool = False,
    ) -> None:
        if numbers is None:
            trace.start(shape.bits)
        self.shape, self.layout = shape, shape.layout
        self._numbers, self._innovations = numbers, innovations
        self.rows, self._places = self.layout.rows, self.layout.constants
        self._states = states = (*shape.states, *FAST) if with_fast_slip else shape.states
        vehicle = VehicleConstants(*map(self.constant, VehicleConstants._fields))
        memory = [self.row(f"memory{k}") for k in range(shape.model.memory)]
        of_user = None if numbers is None else numbers.of_user
        self.model_inputs = ModelInputs(shape.model, vehicle, memory, of_user)
        wander = tuple(i for i in states if i >= s.SIZE)
        fixed_for_all = (*shape.considered, *wander)
        self.fixed_for_imu = (*imu_fixed(shape.model.taught), *fixed_for_all)
        self.fixed_for_gyro = (*gyro_fixed(shape.model.taught), *fixed_for_all)
        all_states = range(s.SIZE + len(wander))
        self.x = np.array([self._initial_value(i) for i in all_states], dtype=object)
        pairs = [(min(i, j), max(i, j)) for n, i in enumerate(states) for j in states[n:]]
        self.P = Covariance({(i, j): self.row(covariance_name(i, j)) for i, j in pairs})
        self._sharp: Real = 0.0  # number of sharp updates
        self.stores: dict[str, Real] = {}  # results of the kernel, by row
        self.events: list[Event] = []  # changes that it reports

    def _initial_value(self, index: int) -> Real:
        """Value of a state before the kernel: of the workspace, a constant, or zero."""
        if index in self._states:
            return self.row(f"x{index}")
        is_parameter = s.PARAMETERS.start <= index < s.PARAMETERS.stop
        if is_parameter and index not in self.shape.absent:
            return self.constant(f"fixed{index}")
        return 0.0

    def row(self, name: str) -> Real:
        """Real in a row of the workspace."""
        if self._numbers is not None:
            return self._numbers.lanes[self.rows[name]]
        return trace.lane_input("lanes", self.rows[name])

    def input(self, name: str) -> Real:
        """Input of the step, see `icreckon.estimator.engine.layout.INPUTS`."""
        if self._numbers is not None:
            return self._numbers.inputs[INPUTS[name]]
        return trace.lane_input("inputs", INPUTS[name])

    def constant(self, name: str) -> Real:
        """Constant that all lanes share."""
        if self._numbers is not None:
            return self._numbers.constants[self._places[name]]
        return trace.uniform_input("constants", self._places[name])

    def report(
        self,
        kind: str,
        values: Iterable[Real],
        states: Sequence[int] = (),
        fixed: Sequence[int] = (),
    ) -> None:
        """Report a change, if the filter's shape asks for it; see `Event`."""
        if self.shape.reports:
            self.events.append(Event(kind, tuple(states), tuple(fixed), tuple(values)))

    @property
    def slip(self) -> Any:
        """Constants of the slip, as fields with the names of `Slip`."""
        return SimpleNamespace(**{name: self.constant(name) for name in Slip.__struct_fields__})

    @property
    def eta(self) -> Real:
        """Typical steering efficiency index, see `MotionModel.steering_efficiency`."""
        of_user = self.model_inputs.of_user
        if of_user is not None:
            return of_user.steering_efficiency(tuple(self.x[s.PARAMETERS]))
        if self.shape.model.kind == "linear":
            vehicle = self.model_inputs.vehicle
            return linear_model.steering_efficiency(tuple(self.x[s.PARAMETERS]), vehicle)
        return self.x[s.ETA0]

    def advance_model(self, dt: Real, left: Real, right: Real) -> None:
        """Advance the memory of an index model by a step, at mean track speeds [m/s]."""
        after = model.advanced_memory(self.x, self.model_inputs, left, right, dt)
        self.stores.update({f"memory{k}": value for k, value in enumerate(after)})
        self.model_inputs = self.model_inputs._replace(memory=after)

    def twist_model(self, left: Real, right: Real, slip_shares: Any = WHOLE) -> TracedTwist:
        """Evaluate the body velocity at track speeds [m/s], see `model.twist_model`."""
        states = self.shape.states
        return model.twist_model(self.x, self.model_inputs, left, right, slip_shares, states)

    def smoothed_twist(self, left: Real, right: Real, slip_shares: Any = WHOLE) -> TracedTwist:
        """Body velocity, with the regressors as its derivatives by the parameters."""
        now = self.twist_model(left, right, slip_shares)
        for axis, row in enumerate(now.rows):
            for i in row.keys() & self.layout.parameters:
                name = f"r{axis}_{i}"
                row[i] = self.stores[name] if name in self.stores else self.row(name)
        return now

    def store_twist(self) -> None:
        """Store present body velocity and covariance, limited by the fastest drive."""
        now = self.smoothed_twist(self.input("now_left"), self.input("now_right"))
        with_rows = [self.P.times(row) for row in now.rows]
        pairs = [(i, j) for i in range(3) for j in range(i, 3)]
        covariance = {(i, j): dot(with_rows[i], now.rows[j]) for i, j in pairs}
        for axis, variance in enumerate(STANDSTILL_VARIANCE):
            covariance[axis, axis] = covariance[axis, axis] + variance
        fastest = self.constant("fastest")
        shares = [model.share_of_sigma(covariance[axis, axis], fastest) for axis in (0, 1)]
        shares.append(1.0)
        values = [*now.twist, *(shares[i] * shares[j] * covariance[i, j] for i, j in pairs)]
        self.stores.update(zip(TWIST, values, strict=True))

    def store_motion(self, now: TracedTwist) -> None:
        """Store a twist with all its derivatives, and the motion in the paper's axes."""
        motion = now.motion
        by_speeds = [derivative for row in now.by_speeds for derivative in row]
        values = [*motion.indices, motion.u, motion.force, *by_speeds]
        self.stores.update(zip(TWIST[:3], now.twist, strict=True))
        self.stores.update(zip(MOTION, values, strict=True))
        for axis, row in zip(TWIST[:3], now.rows, strict=True):
            for i in (*self.shape.states, *FAST):
                self.stores[f"{axis}_by_{i}"] = row.get(i, 0.0)

    def kernel(
        self, name: str, flags: Sequence[Truth] = (), *, with_fast_slip: bool = False
    ) -> Kernel:
        """Make a kernel that stores all changed values, and returns `flags`, see `Kernel`."""
        stores = dict(self.stores)
        states = (*self.shape.states, *FAST) if with_fast_slip else self.shape.states
        for n, i in enumerate(states):
            stores[f"x{i}"] = self.x[i]
            for j in states[n:]:
                stores[covariance_name(i, j)] = self.P.entry(i, j)
        reported = [value for event in self.events for value in event.values]
        stores |= {f"report{k}": value for k, value in enumerate(reported)}
        changed = [
            Store("lanes", self.rows[row], value if self._numbers else trace.lift(value))
            for row, value in stores.items()
            if self._numbers or value is not self.row(row)
        ]
        return Kernel(name, array_rows(self.layout), changed, flags, self.events)

    # --- updates ---------------------------------------------------------------------------------

    def update(
        self, z: Real, H: Vector, R: Real, *parts: Part, fixed: States = (), only: Truth = True
    ) -> None:
        """Update with a scalar measurement, without a gate; for the arguments see `gated`."""
        cross = self.P.times(_without_parts(H, parts), *parts)
        inverse_S = 1.0 / (dot(cross, H) + R)
        self._apply(z, H, cross, R, select(only, inverse_S, 0.0), fixed)

    def _apply(
        self,
        z: Real,
        H: Vector,
        cross: Vector,
        R: Real,
        inverse_S: Real,
        fixed: States,
        stand_in: int | None = None,
    ) -> None:
        """Correct state and covariance, and count sharp updates; `cross` is P H'."""
        sharp_share, _ = SHARP_UPDATES[self.shape.bits]
        is_sharp = select((R * inverse_S < sharp_share) & (inverse_S > 0.0), 1.0, 0.0)
        self._sharp, fixed = self._sharp + is_sharp, tuple(fixed)
        stand_in_row = None if stand_in is None else (stand_in, H)
        gains = self.P.correct(self.x, z, cross, inverse_S, fixed, stand_in_row)
        states = self.P.states
        vectors = [vector.get(i, 0.0) for vector in (H, cross, gains) for i in states]
        self.report("updated", (z, R, inverse_S, is_sharp, *vectors), states, fixed)

    def gated(
        self,
        sensor: str,
        z: Real,
        H: Vector,
        R: Real,
        *parts: Part,
        inflated: int,
        fixed: States = (),
        stand_in: int | None = None,
        only: Truth | None = None,
        patience: Real | None = None,
        interval: Real | None = None,
    ) -> None:
        """Gate, update and count a scalar, see `icreckon.estimator.filter.ekf`.

        Args:
            sensor: name of the sensor.
            z: innovation.
            H: derivative of the predicted measurement by the states.
            R: variance of the measurement noise.
            parts: parts of H that other measurements have, too: factors and vectors, of states with no
                other part in H.
            inflated: state whose variance is inflated in re-acquisition.
            fixed: states that the update does not move.
            stand_in: state that it moves in their place, see `reference.ekf.IcrEkf.update_scalar`.
            only: lanes that have the measurement; None for all.
            patience: time of rejections after which it is re-acquired [s]; None for that of the IMU.
            interval: time that it counts if it is rejected [s]; None for that of the IMU.
        """
        patience = self.constant("imu_patience") if patience is None else patience
        interval = self.constant("interval") if interval is None else interval
        cross = self.P.times(_without_parts(H, parts), *parts)
        S = dot(cross, H) + R
        inverse_S = 1.0 / S
        square = z * z
        nis = square * inverse_S
        if self._innovations:
            tested = 1.0 if only is None else trace.truth_as_number(only)
            self.stores[f"{sensor}_z"], self.stores[f"{sensor}_S"] = z, tested * S
        admitted = nis <= self.constant("threshold")
        patience_ends = self.row(f"{sensor}_rejected_for") >= patience
        reacquired = trace.both(only, ~admitted & patience_ends)
        inflation = minimum(square, LARGEST_INFLATION * S)
        by_inflated = H.get(inflated, 0.0)
        added, inverse_S = trace.where_needed(
            reacquired,
            [0.0, inverse_S],
            lambda: [inflation, 1.0 / (S + inflation * by_inflated * by_inflated)],
        )
        if inflated not in self.shape.considered:
            # A considered state cannot be moved: R is inflated instead.
            self.P.add(inflated, inflated, added)
            cross[inflated] = cross[inflated] + added * by_inflated
            self.report("inflated", (added,), (inflated,))
        used = admitted | reacquired
        inverse_S = select(trace.both(only, used), inverse_S, 0.0)
        self._apply(z, H, cross, R, inverse_S, fixed, stand_in)
        self.count(sensor, nis, admitted, used, only, interval)

    def count(
        self, sensor: str, nis: Real, admitted: Truth, used: Truth, only: Truth, interval: Real
    ) -> None:
        """Add to the counts of a gate, in the lanes (`only`; None for all) that measure."""
        before = self.row(f"{sensor}_rejected_for")
        after = select(used, 0.0, before + interval)
        after = after if only is None else select(only, after, before)
        self.stores[f"{sensor}_rejected_for"] = after
        for count, increase in (
            ("used", trace.truth_as_number(trace.both(only, used))),
            ("rejected", trace.truth_as_number(trace.both(only, ~used))),
            ("admitted", trace.truth_as_number(trace.both(only, admitted))),
            ("nis", select(trace.both(only, admitted), nis, 0.0)),
        ):
            self.stores[f"{sensor}_{count}"] = self.row(f"{sensor}_{count}") + increase

    def add_doubt(self, bias: Real, shared: Real, yaw: Real) -> None:
        """Inflate the gyro's bias, and the yaw that has turned by it.

        Added are the variance `bias` [rad²/s²], the covariance `shared` [rad²/s] and the variance `yaw`
        [rad²].
        """
        self.P.add(s.YAW, s.YAW, yaw)
        if s.GYRO_BIAS in self.P.states and s.GYRO_BIAS not in self.shape.considered:
            self.P.add(s.GYRO_BIAS, s.GYRO_BIAS, bias)
            self.P.add(s.YAW, s.GYRO_BIAS, shared)
            self.report("motion", (yaw, shared, bias), (s.YAW, s.GYRO_BIAS))
        else:
            self.report("motion", (yaw,), (s.YAW,))

    def cover_rounding(self, *, after_fix: bool = False) -> None:
        """Inflate the states after sharp updates, as `Ekf.update_scalar` after each.

        In single precision only fixes are sharp, after hours without any: standstills, which come often,
        would inflate all states for no reason.
        """
        if self.shape.bits == 32 and not after_fix:
            return
        share = SHARP_UPDATES[self.shape.bits][1]
        for i, added in self.P.inflate(share * self._sharp).items():
            self.report("inflated", (added,), (i,))

    def keep_inside_bounds(self, *, by_imu: bool = False) -> None:
        """Project onto the bounds as `bounds.inside`, if a lane is outside."""
        states, x = self.P.states, self.x
        fixed = self.fixed_for_gyro if by_imu else (*POSE_FIXED, *self.shape.considered)
        bounds = [bound for bound in self._bounds() if not bound.weights.keys() <= {*fixed}]
        if not bounds:
            return
        is_outside: Truth = False
        for bound in bounds:
            short = bound.shortfall(values_for(x, bound.weights))
            is_outside = is_outside | (short > OUTSIDE[self.shape.bits])
        before = [x[i] for i in states]
        a_round = partial(self._projected, bounds, fixed)
        inside = trace.repeat(is_outside, before, a_round, BOUND_ROUNDS)[:-1]
        for i, value in zip(states, inside, strict=True):
            x[i] = value

    def _projected(
        self, bounds: Iterable[Bound], fixed: Sequence[int], *values: Real
    ) -> tuple[list[Real], Truth]:
        """Project values of the states onto each bound in turn; True if any has moved.

        Each state that is not `fixed` moves by its covariance with the sum that violates the bound.
        """
        states, has_moved = self.P.states, cast(Any, False)
        now = dict(zip(states, values, strict=True))
        for bound in bounds:
            free = {i: weight for i, weight in bound.weights.items() if i not in fixed}
            cross = self.P.times(free)
            variance, short = dot(cross, free), bound.shortfall(now)
            moves = (short > OUTSIDE[self.shape.bits]) & (variance > 0.0)
            per_cross = select(moves, short / select(moves, variance, 1.0), 0.0)
            now |= {i: now[i] + cross[i] * per_cross for i in states if i not in fixed}
            has_moved = has_moved | moves
        return [now[i] for i in states], has_moved

    def _bounds(self) -> Iterable[Bound]:
        """Bounds of the model's parameters."""
        for number, places in enumerate(self.shape.model.bounds):
            weights = {s.PARAMETERS.start + k: self.constant(f"bound{number}_{k}") for k in places}
            certain = {i: self.x[i] for i in weights if i not in self.shape.states}
            uncertain = {i: weight for i, weight in weights.items() if i in self.shape.states}
            least = self.constant(f"bound{number}_{s.PARAMETER_COUNT}")
            yield Bound(uncertain, dot(certain, {i: weights[i] for i in certain}), least)


def array_rows(layout: Layout) -> tuple[int, int, int]:
    """Real of rows of each of `ARRAYS`; number of constants, which all lanes share."""
    return len(layout.rows), len(INPUTS), len(layout.constants)


def plain_kernel(make: Any, of_user: MotionModel | None = None) -> Any:
    """Make a function of `ARRAYS` that computes a kernel in Python, lane by lane.

    `make` makes the kernel of `PlainNumbers`; for `of_user` see there.
    """

    def kernel(lanes: Any, inputs: Any, constants: Any) -> int:
        flags = 0
        with np.errstate(all="ignore"):
            for lane in range(lanes.shape[1]):
                plain = PlainNumbers(lanes[:, lane], inputs[:, lane], constants, of_user)
                lane_kernel = make(plain)
                for place, flag in enumerate(lane_kernel.flags):
                    flags |= bool(flag) << (place * FLAG_BITS + lane)
                for _, row, value in lane_kernel.stores:
                    lanes[row, lane] = value
        return flags

    return kernel


def _without_parts(row: Vector, parts: Iterable[Part]) -> Vector:
    """Entries of a row that are in none of its parts."""
    shared = {i for _, part in parts for i in part}
    return {i: value for i, value in row.items() if i not in shared}


def values_for(x: Any, row: Vector) -> Vector:
    """Values of the states that a row has."""
    return {i: x[i] for i in row}
