"""The motion model and the filter's noise, in traced numbers: what `estimator` says of one, for many.

Equations and derivatives are those of `estimator.motion.index_model`, `estimator.filter.process_noise`
and `estimator.sensors.sensor_models`. Only how the force of inertia is searched for is done otherwise:
all lanes take part in each round until the last has found it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.engine.covariance import Vector
from icreckon.estimator.filter import process_noise
from icreckon.estimator.motion import index_model as motion
from icreckon.estimator.motion import motion_model, propagation
from icreckon.estimator.scalar_engine import ekf_kernel
from icreckon.estimator.scalar_engine.motion_kernel import INERTIA
from icreckon.estimator.sensors import sensor_models
from icreckon.estimator.tracing import trace

# Newton's error is squared in each round: after a change of this share none that matters is left.
LAST_CHANGE = {64: 1e-6, 32: 1e-4}
# Up to this angle [rad] so many terms of a series are right to the last digit.
SERIES_TO, TERMS = 0.5, 8


class TracedTwist(NamedTuple):
    """The body velocity and what it depends on.

    Attributes:
        twist: (3,) of base_link.
        rows: (3,) its derivatives by the states, those that are not zero.
        by_speeds: (3, 2) its derivatives by the track speeds.
        u: the force of inertia, see `estimator.motion.index_model`; None where nothing depends on it.
    """

    twist: Any
    rows: tuple[Vector, Vector, Vector]
    by_speeds: Any
    u: Any


def twist_model(
    x: Any,
    constants: Any,
    left: Any,
    right: Any,
    slip_share: Any,
    states: tuple[int, ...],
    guess: Any,
) -> TracedTwist:
    """See `estimator.scalar_engine.ekf_kernel.fill_twist`.

    Args:
        x: (SIZE,) the state.
        constants: of the motion model, see `estimator.scalar_engine.motion_kernel`.
        left: speed of the left track [m/s].
        right: of the right.
        slip_share: how much of the slip counts.
        states: those that are uncertain, whose derivatives are wanted.
        guess: where the search for the force of inertia begins [N].
    """
    twist, by_speeds = np.empty(3, dtype=object), np.empty((3, 2), dtype=object)
    jacobian = np.empty((3, s.SIZE), dtype=object)

    matters = False

    def balance(problem: Any) -> Any:
        nonlocal matters
        at_zero = _evaluate(trace.lift(0.0), problem)
        matters = not is_zero(at_zero.g_u)
        return _balance(problem, guess) if matters else at_zero.g

    fill_twist = trace.traced(ekf_kernel.fill_twist, _balance=balance)
    motion = fill_twist(
        x, INERTIA, constants, None, left, right, slip_share, twist, jacobian, by_speeds
    )
    wanted = (*states, *range(s.FAST_SLIP.start, s.FAST_SLIP.stop))
    rows = tuple({i: row[i] for i in wanted if not is_zero(row[i])} for row in jacobian)
    return TracedTwist(twist, (rows[0], rows[1], rows[2]), by_speeds, motion.u if matters else None)


def is_zero(value: Any) -> bool:
    """Whether a number is known to be zero in all lanes."""
    return trace.lift(value).known == 0.0


def _balance(problem: Any, guess: Any) -> Any:
    """`estimator.motion.index_model._balance`, in rounds of all lanes, from a guess of one's own."""

    def newton(u: Any, goes_on: Any) -> Any:
        # A lane that has found its own stays there, so that a filter does not depend on its neighbours.
        step = _evaluate(u, problem)
        change = (step.g - u) / _at_least(1.0 - step.g_u, motion.SMALLEST_SLOPE)
        moves = goes_on > 0.5
        u = trace.select(moves, u + change, u)
        unsettled = moves & ~(abs(change) <= LAST_CHANGE[trace.Traced.bits] * (1.0 + abs(u)))
        return [u, trace.truth_as_number(unsettled)], unsettled

    u, _, unsettled = trace.repeat(True, [guess, 1.0], newton, motion.NEWTON_ITERATIONS)

    def widen(high: Any) -> Any:
        short = (high - _evaluate(high, problem).g < 0.0) | (
            -high - _evaluate(-high, problem).g > 0.0
        )
        return [trace.select(short, 2.0 * high, high)], unsettled & short

    high, _ = trace.repeat(unsettled, [1.0], widen, motion.BISECTIONS)

    def halve(low: Any, high: Any) -> Any:
        middle = 0.5 * (low + high)
        below = middle - _evaluate(middle, problem).g < 0.0
        return [trace.select(below, middle, low), trace.select(below, high, middle)], unsettled

    low, high, _ = trace.repeat(unsettled, [-high, high], halve, motion.BISECTIONS)
    return trace.select(unsettled, 0.5 * (low + high), u)


def _arc_with_slopes(angle: Any) -> Any:
    """`estimator.motion.propagation.arc_with_slopes` without its cancellations, by series in angle²."""
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


_arc_in_full = trace.traced(propagation.arc_with_slopes)
_evaluate = trace.traced(motion._evaluate)
_at_least = trace.traced(motion_model.at_least)
slip_at = trace.traced(process_noise.slip_at)
fast_slip_density = trace.traced(process_noise.fast_slip_density)
sideways_density = trace.traced(process_noise.sideways_density)
share_of_walk = trace.traced(process_noise.share_of_walk)
gyro_variance = trace.traced(sensor_models.gyro_variance)
accelerometer_forecast = trace.traced(sensor_models.accelerometer_forecast)
step_on_se2 = trace.traced(propagation.step_on_se2, arc_with_slopes=_arc_with_slopes)
