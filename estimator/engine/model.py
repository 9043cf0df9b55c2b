"""Motion models and noise models in traced numbers.

Equations and derivatives are those of `icreckon.estimator.motion`,
`icreckon.estimator.filter.process_noise` and `icreckon.estimator.sensors.sensor_models`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.engine.covariance import Vector, combined
from icreckon.estimator.faults import departing_fixes
from icreckon.estimator.filter import gate, process_noise, slip_factor
from icreckon.estimator.motion import lagged_index_model, linear_model, motion_model, propagation
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.motion.linear_model import LinearMotion
from icreckon.estimator.motion.motion_model import (
    MotionModel,
    VehicleConstants,
    gravity_in,
    track_factors,
)
from icreckon.estimator.sensors import sensor_models, standstill
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.elementary import exponential, traced
from icreckon.estimator.tracing.trace import Real, Truth, select

SERIES_TO, TERMS = 0.5, 8  # up to this angle [rad] a series of this many terms is exact to rounding
# From the paper's axes: forward is its second, left minus its first.
PAPER_AXIS = (1, 0, 2)
PAPER_SIGN = (1.0, -1.0, 1.0)

Kind = Literal["index", "linear", "plain"]


class TracedModel(NamedTuple):
    """Motion model as the code of a filter depends on it."""

    kind: Kind  # kind of the model; "plain" of one that only plain numbers can evaluate
    parameters: tuple[int, ...]  # places of the parameters that the model uses among the nine
    bounds: tuple[tuple[int, ...], ...]  # places of the parameters in each bound
    memory: int  # number of values in the model's memory
    taught: tuple[int, ...]  # places of the parameters that the IMU moves


def described(model: MotionModel) -> TracedModel:
    """Describe a motion model."""
    kind: Kind
    # A subclass may have equations of its own.
    if type(model) is LaggedIndexMotion:
        # There is no derivative by H.
        kind, used = "index", range(1, s.PARAMETER_COUNT)
    elif type(model) is LinearMotion:
        kind, used = "linear", range(len(linear_model.PARAMETER_NAMES))
    else:
        kind, used = "plain", range(s.PARAMETER_COUNT)
    bounds = tuple(tuple(np.flatnonzero(bound[:-1]).tolist()) for bound in model.bounds)
    taught = model.taught_by_imu
    return TracedModel(kind, tuple(used), bounds, len(model.memory), taught)


def traced_model(model: MotionModel) -> TracedModel | None:
    """Describe a motion model; None if it has no traced form."""
    description = described(model)
    return None if description.kind == "plain" else description


class TracedTwist(NamedTuple):
    """Body velocity and its derivatives."""

    twist: Any  # (3,) twist of base_link
    # (3,) its derivatives by the states, where they are not zero
    rows: tuple[Vector, Vector, Vector]
    by_speeds: Any  # (3, 2) its derivatives by the track speeds
    motion: motion_model.Motion  # motion in the paper's axes


class Tilting(NamedTuple):
    """Turning of the body about its own axes of roll and pitch."""

    # acceleration of gravity towards the ground [m/s²]; 0 if the rates are not known
    down: Real
    roll_rate: Real  # without bias [rad/s]; 0 if it is not known
    pitch_rate: Real  # without bias [rad/s]; 0 if it is not known
    is_known: Truth  # True if the rates are known
    # pitch by a random change of gravity's forward component [rad s²/m]; 0 if the rates are known
    pitch_by_walk: Real


class Climb(NamedTuple):
    """Change of height of a body that moves along a slope."""

    rate: Real  # the change [m/s]
    by_twist: tuple[Real, Real]  # (2,) its derivatives by the speeds forward and left
    by_gravity: tuple[Real, Real]  # (2,) those by gravity along the ground

    def times(self, twist_vectors: Sequence[Vector], gravity_vectors: dict[int, Vector]) -> Vector:
        """Combine vectors, by twist and gravity, as these contribute to the height."""
        parts = (*zip(self.by_twist, twist_vectors[:2], strict=True),)
        parts += (*zip(self.by_gravity, gravity_vectors.values(), strict=True),)
        return combined({}, *parts)


class ModelInputs(NamedTuple):
    """Inputs of a motion model besides state and track speeds."""

    model: TracedModel  # the model
    vehicle: VehicleConstants  # constants of the vehicle
    memory: Any  # (m,) its memory
    of_user: MotionModel | None = None  # the model itself, if only plain numbers can evaluate it


def twist_model(
    x: Any, inputs: ModelInputs, left: Real, right: Real, slip_shares: Any, states: tuple[int, ...]
) -> TracedTwist:
    """Evaluate the body velocity in a state x (SIZE,), at measured track speeds [m/s].

    `slip_shares` (3,) are factors on the slip, `states` those by which derivatives are wanted.
    """
    left_factor, right_factor = track_factors(x)
    slip_x, slip_y, slip_w = (
        share * slow + fast
        for share, slow, fast in zip(slip_shares, x[s.SLIP], x[s.FAST_SLIP], strict=True)
    )
    speeds, parameters = (left * left_factor, right * right_factor), tuple(x[s.PARAMETERS])
    # The motion model has the paper's axes: right, which is minus left, and forward.
    arguments = *speeds, parameters, (-slip_y, slip_x, slip_w), gravity_in(x)
    if inputs.of_user is not None:
        motion, derivatives = inputs.of_user.linearise(*arguments)
    elif inputs.model.kind == "linear":
        motion, derivatives = _linearise_linear(*arguments, inputs.vehicle)
    else:
        motion, derivatives = _linearise_indices(*arguments, inputs.vehicle, inputs.memory)
    wanted_states = (*states, *range(s.FAST_SLIP.start, s.FAST_SLIP.stop))
    twist, by_speeds = np.empty(3, dtype=object), np.empty((3, 2), dtype=object)
    rows: list[Vector] = []
    velocity = motion.twist.v_x, motion.twist.v_y, motion.twist.w
    for i, (axis, sign) in enumerate(zip(PAPER_AXIS, PAPER_SIGN, strict=True)):
        twist[i] = sign * velocity[axis]
        row: Vector = {}
        for j in range(3):
            by_slip = sign * PAPER_SIGN[j] * derivatives.by_slip[axis][PAPER_AXIS[j]]
            row[s.SLIP.start + j] = slip_shares[j] * by_slip
            row[s.FAST_SLIP.start + j] = by_slip
        for j in range(s.PARAMETER_COUNT):
            row[s.PARAMETERS.start + j] = sign * derivatives.by_parameters[axis][j]
        by_gravity_right, by_gravity_forward = derivatives.by_gravity[axis]
        row[s.GRAVITY_X], row[s.GRAVITY_Y] = sign * by_gravity_forward, -sign * by_gravity_right
        by_left, by_right = (sign * by_speed for by_speed in derivatives.by_speeds[axis])
        row[s.TRACK_SCALE] = by_left * left + by_right * right
        row[s.TRACK_DIFFERENCE] = 0.5 * (by_right * right - by_left * left)
        by_speeds[i] = left_factor * by_left, right_factor * by_right
        wanted = {k: row[k] for k in wanted_states if k in row}
        if inputs.of_user is None:  # a zero of a user's model may be one for now
            wanted = {k: value for k, value in wanted.items() if not trace.is_zero(value)}
        rows.append(wanted)
    return TracedTwist(twist, (rows[0], rows[1], rows[2]), by_speeds, motion)


def tilting(x: Any, roll_rate: Real, pitch_rate: Real) -> Tilting:
    """Compute the turning of a tilted body; rates that are not known are NaN."""
    is_known = roll_rate == roll_rate  # not NaN
    downward = downward_gravity((x[s.GRAVITY_X], x[s.GRAVITY_Y]))
    down, by_walk = select(is_known, downward, 0.0), select(is_known, 0.0, 1.0 / downward)
    roll = select(is_known, roll_rate - x[s.GYRO_BIAS_X], 0.0)
    pitch = select(is_known, pitch_rate - x[s.GYRO_BIAS_Y], 0.0)
    return Tilting(down, roll, pitch, is_known, by_walk)


def climb(now: TracedTwist, gravity: Any) -> Climb:
    """Compute the climb of a twist at gravity along the ground (2,) [m/s²]."""
    v_x, v_y = now.twist[0], now.twist[1]
    a, b = propagation.upward(gravity)
    return Climb(a * v_x + b * v_y, (a, b), propagation.upward((v_x, v_y)))


def gravity_rows(angle: Real, tilt: Tilting, kept_share: Real, dt: Real) -> dict[int, Vector]:
    """Transition of gravity along the ground, which is fixed in odom, over dt [s].

    The body turns by an angle [rad] about its z axis, and by `tilt` about the others; if the latter is
    not known, only `kept_share` is not forgotten.
    """
    cos, sin = turn(angle)
    kept_share, down = select(tilt.is_known, 1.0, kept_share), tilt.down * dt
    cos, sin = kept_share * cos, kept_share * sin
    return {
        s.GRAVITY_X: {s.GRAVITY_X: cos, s.GRAVITY_Y: sin, s.GYRO_BIAS_Y: -down},
        s.GRAVITY_Y: {s.GRAVITY_X: -sin, s.GRAVITY_Y: cos, s.GYRO_BIAS_X: down},
    }


def advanced_memory(x: Any, inputs: ModelInputs, left: Real, right: Real, dt: Real) -> list[Real]:
    """Memory of an index model after a step of dt [s], see `MotionModel.begin_step`.

    `left` and `right` are mean speeds of the tracks in the step [m/s], x (SIZE,) is the state.
    """
    left_factor, right_factor = track_factors(x)
    speeds = left * left_factor, right * right_factor
    parameters = tuple(x[s.PARAMETERS])
    if inputs.of_user is not None:
        # A model of the user is never traced: it runs on plain numbers and keeps its own memory.
        inputs.of_user.recall(np.array(inputs.memory, dtype=float))
        inputs.of_user.begin_step(dt, *speeds, parameters, gravity_in(x))
        return list(inputs.of_user.memory)
    kept_share = exponential(-dt / inputs.vehicle.load_lag)
    memory, gravity = inputs.memory, gravity_in(x)
    return list(_memory_after(memory, kept_share, speeds, parameters, gravity, inputs.vehicle))


def step_on_se2(yaw: Real, motion: Any) -> Any:
    """Compute `propagation.step_on_se2`."""
    return _step_along_arc(yaw, motion, _arc_with_slopes(motion[2]))


def turn(angle: Real) -> Any:
    """Compute `propagation.turn`."""
    return _turn_along_arc(angle, _arc_with_slopes(angle))


def _arc_with_slopes(angle: Real) -> Any:
    """Compute `propagation.arc_with_slopes`; of a small angle by power series."""
    square = angle * angle

    def series(first: int, factor: Callable[[int], float]) -> Real:
        """Sum of (-1)^k factor(k) angle^(2 k) / (2 k + first)!, by Horner's scheme."""
        total: Real = 0.0
        for k in range(TERMS, -1, -1):
            term = (-1.0) ** k * factor(k) / math.factorial(2 * k + first)
            total = term + square * total
        return total

    a, b = series(1, lambda _: 1.0), angle * series(2, lambda _: 1.0)
    a_slope = -angle * series(3, lambda k: 2.0 * (k + 1))
    b_slope = series(2, lambda k: 2.0 * k + 1.0)
    is_large = abs(angle) > SERIES_TO
    large = trace.select(is_large, angle, 1.0)
    return trace.where_needed(is_large, [a, b, a_slope, b_slope], lambda: _arc_in_full(large))


_arc_in_full = traced(propagation.arc_with_slopes)
_linearise_indices = traced(lagged_index_model.linearise)
_linearise_linear = traced(linear_model.linearise)
_memory_after = traced(lagged_index_model.memory_after)
_turn_along_arc = traced(propagation.turn_along_arc)
slip_at = traced(process_noise.slip_at)
slip_times = traced(process_noise.slip_times)
gauss_markov = traced(propagation.gauss_markov)
present_factor_after = traced(slip_factor.present_factor_after)
slip_factor_after = traced(slip_factor.slip_factor_after)
trend_after = traced(slip_factor.trend_after)
departure_after = traced(departing_fixes.departure_after)
lasting_slip = traced(process_noise.lasting_slip)
patience_for = traced(gate.patience_for)
normalised = traced(slip_factor.normalised)
fast_slip_density = traced(process_noise.fast_slip_density)
white_density = traced(process_noise.white_density)
change_density = traced(process_noise.change_density)
travel_speed = traced(process_noise.travel_speed)
share_of_walk = traced(process_noise.share_of_walk)
share_of_sigma = traced(process_noise.share_of_sigma)
bias_change = traced(standstill.bias_change)
accelerometer_forecast = traced(sensor_models.accelerometer_forecast)
_step_along_arc = traced(propagation.step_along_arc)
horizontal_projection = traced(propagation.horizontal_projection)
downward_gravity = traced(propagation.downward_gravity)
