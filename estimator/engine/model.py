"""Motion models and noise models in traced numbers.

Equations and derivatives are those of `estimator.motion`, `estimator.filter.process_noise` and
`estimator.sensors.sensor_models`. Only the search for the force of inertia differs: all lanes take part
in each round until the last has found it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.engine.covariance import Vector
from icreckon.estimator.filter import process_noise
from icreckon.estimator.friction import model as friction_model
from icreckon.estimator.friction.layout import PARAMETERS as FRICTION_PARAMETERS
from icreckon.estimator.friction.model import FrictionMotion
from icreckon.estimator.motion import index_model, motion_model, propagation
from icreckon.estimator.motion.index_model import InertiaMotion
from icreckon.estimator.motion.motion_model import MotionModel, VehicleConstants
from icreckon.estimator.sensors import sensor_models, standstill
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.elementary import traced

# Newton's method squares the error in each round: after a relative change of this size it has converged.
LAST_CHANGE = {64: 1e-6, 32: 1e-4}
SMALLEST_CHANGE = {64: index_model.TOLERANCE, 32: 1e-6}
# Up to this angle [rad] a series of so many terms is exact to rounding.
SERIES_TO, TERMS = 0.5, 8
# From the paper's axes: forward is its second, left minus its first.
PAPER_AXIS = (1, 0, 2)
PAPER_SIGN = (1.0, -1.0, 1.0)

Kind = Literal["smooth", "literal", "friction"]


class TracedModel(NamedTuple):
    """Motion model as the code of a filter depends on it.

    Attributes:
        kind: form of the index model, or friction.
        slip_in_inertia: True if the inertia is that of the twist with slip.
        parameters: places of the parameters that the model uses among the eight.
        bounds: places of the parameters in each bound.
        memory: number of values in the model's memory.
        sheared: friction builds up with the shear displacement.
    """

    kind: Kind
    slip_in_inertia: bool
    parameters: tuple[int, ...]
    bounds: tuple[tuple[int, ...], ...]
    memory: int
    sheared: bool = False


def traced_model(model: MotionModel) -> TracedModel | None:
    """Describe a motion model; None if it has no traced form."""
    kind: Kind
    slip_in_inertia = sheared = False
    # A subclass may have equations of its own.
    if type(model) is InertiaMotion:
        kind, slip_in_inertia = model.form, model.slip_in_inertia
        # H counts by its sign alone, so there is no derivative by it.
        used = range(1, 8)
    elif type(model) is FrictionMotion:
        kind, used, sheared = "friction", range(FRICTION_PARAMETERS), model.sheared
    else:
        return None
    bounds = tuple(tuple(np.flatnonzero(bound[:8]).tolist()) for bound in model.bounds)
    return TracedModel(kind, slip_in_inertia, tuple(used), bounds, len(model.memory), sheared)


class TracedTwist(NamedTuple):
    """Body velocity and its derivatives.

    Attributes:
        twist: (3,) twist of base_link.
        rows: (3,) its derivatives by the states, where they are not zero.
        by_speeds: (3, 2) its derivatives by the track speeds.
        u: force of inertia, see `estimator.motion.index_model`; None if nothing depends on it.
        motion: motion in the paper's axes.
    """

    twist: Any
    rows: tuple[Vector, Vector, Vector]
    by_speeds: Any
    u: Any
    motion: motion_model.Motion


class ModelInputs(NamedTuple):
    """Inputs of a motion model besides state and track speeds.

    Attributes:
        model: the model.
        vehicle: L, M, x_CM, y_CM.
        memory: (m,) its memory.
    """

    model: TracedModel
    vehicle: VehicleConstants
    memory: Any


class SlipConstants(NamedTuple):
    """Values of `estimator.robot.robot_file.Slip`."""

    turning_x: Any
    turning_y: Any
    turning_w: Any
    driving_x: Any
    driving_y: Any
    driving_w: Any
    time_constant: Any
    white_time: Any


def twist_model(
    x: Any,
    inputs: ModelInputs,
    left: Any,
    right: Any,
    slip_share: Any,
    states: tuple[int, ...],
    guess: Any,
) -> TracedTwist:
    """Evaluate the body velocity, see `IcrEkf.twist_model`.

    Args:
        x: (SIZE,) the state.
        inputs: inputs of the motion model.
        left: speed of the left track [m/s].
        right: speed of the right track [m/s].
        slip_share: factor on the slip.
        states: uncertain states, by which derivatives are wanted.
        guess: initial guess of the force of inertia [N].
    """
    scale = 1.0 + x[s.TRACK_SCALE]
    slip = [slip_share * slow + fast for slow, fast in zip(x[s.SLIP], x[s.FAST_SLIP], strict=True)]
    in_paper = (-slip[1], slip[0], slip[2])
    speeds, parameters = (left * scale, right * scale), tuple(x[s.PARAMETERS])
    if inputs.model.kind == "friction":
        motion, by = _linearise_friction(
            *speeds, parameters, in_paper, inputs.vehicle, inputs.memory
        )
        u = None
    else:
        motion, by, u = _linearise_indices(speeds, parameters, in_paper, inputs, guess)
    wanted = (*states, *range(s.FAST_SLIP.start, s.FAST_SLIP.stop))
    twist, by_speeds = np.empty(3, dtype=object), np.empty((3, 2), dtype=object)
    rows: list[Vector] = []
    velocity = motion.twist.v_x, motion.twist.v_y, motion.twist.w
    for i, (axis, sign) in enumerate(zip(PAPER_AXIS, PAPER_SIGN, strict=True)):
        twist[i] = sign * velocity[axis]
        row: Vector = {}
        for j in range(3):
            by_slip = sign * PAPER_SIGN[j] * by.by_slip[axis][PAPER_AXIS[j]]
            row[s.SLIP.start + j] = slip_share * by_slip
            row[s.FAST_SLIP.start + j] = by_slip
        for j in range(8):
            row[s.PARAMETERS.start + j] = sign * by.by_parameters[axis][j]
        by_left, by_right = sign * by.by_speeds[axis][0], sign * by.by_speeds[axis][1]
        row[s.TRACK_SCALE] = by_left * left + by_right * right
        by_speeds[i] = scale * by_left, scale * by_right
        rows.append({k: row[k] for k in wanted if k in row and not is_zero(row[k])})
    return TracedTwist(twist, (rows[0], rows[1], rows[2]), by_speeds, u, motion)


def _linearise_indices(
    speeds: tuple[Any, Any], parameters: Any, slip: Any, inputs: ModelInputs, guess: Any
) -> tuple[Any, Any, Any]:
    """Motion, derivatives, and the force of inertia if anything depends on it."""
    model = inputs.model
    in_inertia = slip if model.slip_in_inertia else motion_model.NO_SLIP
    is_literal = model.kind == "literal"
    problem = _balance_problem(*speeds, parameters, inputs.vehicle, is_literal, in_inertia)
    at_zero = _evaluate(trace.lift(0.0), problem)
    matters = not is_zero(at_zero.g_u)
    u = _balance(problem, guess) if matters else at_zero.g
    motion, by = _linearise_at(u, problem, slip, model.slip_in_inertia)
    return motion, by, u if matters else None


def is_zero(value: Any) -> bool:
    """Return True if a number is the constant zero."""
    return trace.lift(value).constant == 0.0


def _balance(problem: Any, guess: Any) -> Any:
    """Solve `index_model.balance` in rounds of all lanes, each from its own guess."""
    bits = trace.Traced.bits

    def newton(u: Any, goes_on: Any) -> Any:
        # A settled lane stays where it is, so that no filter depends on its neighbours.
        step = _evaluate(u, problem)
        slope = 1.0 - step.g_u
        change = (step.g - u) / _at_least(slope, index_model.SMALLEST_SLOPE)
        # With a slope that is not Newton's, the error shrinks by a factor in each round only.
        is_newton = slope >= index_model.SMALLEST_SLOPE
        last = trace.select(is_newton, LAST_CHANGE[bits], SMALLEST_CHANGE[bits])
        moves = goes_on > 0.5
        u = trace.select(moves, u + change, u)
        unsettled = moves & ~(abs(change) <= last * (1.0 + abs(u)))
        return [u, trace.truth_as_number(unsettled)], unsettled

    u, _, unsettled = trace.repeat(True, [guess, 1.0], newton, index_model.NEWTON_ITERATIONS)

    def widen(high: Any) -> Any:
        short = (high - _evaluate(high, problem).g < 0.0) | (
            -high - _evaluate(-high, problem).g > 0.0
        )
        return [trace.select(short, 2.0 * high, high)], unsettled & short

    high, _ = trace.repeat(unsettled, [1.0], widen, index_model.BISECTIONS)

    def halve(low: Any, high: Any) -> Any:
        middle = 0.5 * (low + high)
        below = middle - _evaluate(middle, problem).g < 0.0
        return [trace.select(below, middle, low), trace.select(below, high, middle)], unsettled

    low, high, _ = trace.repeat(unsettled, [-high, high], halve, index_model.BISECTIONS)
    return trace.select(unsettled, 0.5 * (low + high), u)


def step_on_se2(yaw: Any, motion: Any) -> Any:
    """Compute `propagation.step_on_se2`."""
    return _step_along_arc(yaw, motion, _arc_with_slopes(motion[2]))


def _arc_with_slopes(angle: Any) -> Any:
    """Compute `propagation.arc_with_slopes` by series in angle², without cancellation."""
    square = angle * angle

    def series(factorial: int, factor: Callable[[int], float]) -> Any:
        total: Any = 0.0
        for k in range(TERMS, -1, -1):
            term = (-1.0) ** k * factor(k) / math.factorial(2 * k + factorial)
            total = term + square * total
        return total

    values = [
        series(1, lambda _: 1.0),
        angle * series(2, lambda _: 1.0),
        -angle * series(3, lambda k: 2.0 * (k + 1)),
        series(2, lambda k: 2.0 * k + 1.0),
    ]
    is_large = abs(angle) > SERIES_TO
    large = trace.select(is_large, angle, 1.0)
    return trace.where_needed(is_large, values, lambda: _arc_in_full(large))


_arc_in_full = traced(propagation.arc_with_slopes)
_balance_problem = traced(index_model.balance_problem)
_evaluate = traced(index_model.evaluate)
_linearise_at = traced(index_model.linearise_at)
_linearise_friction = traced(friction_model.linearise)
_at_least = traced(motion_model.at_least)
slip_at = traced(process_noise.slip_at)
fast_slip_density = traced(process_noise.fast_slip_density)
sideways_density = traced(process_noise.sideways_density)
share_of_walk = traced(process_noise.share_of_walk)
stands = traced(standstill.stands)
gyro_variance = traced(sensor_models.gyro_variance)
accelerometer_forecast = traced(sensor_models.accelerometer_forecast)
_step_along_arc = traced(propagation.step_along_arc)
