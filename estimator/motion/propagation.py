"""Propagation of pose and slip over a step, with derivatives and process noise.

All functions work on scalars.

Written for plain Python and for numba (`icreckon.estimator.tracing.jit_kernel`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from icreckon.estimator.base.choices import select
from icreckon.estimator.base.frames import arc_factors

Triple = tuple[float, float, float]


class PoseStep(NamedTuple):
    """Increment of a pose by a body motion.

    Attributes:
        step: x, y [m], yaw [rad] in the axes of the pose.
        by_yaw: derivative of its x and y by the yaw of the pose.
        by_motion: (3, 3) its derivative by the motion.
    """

    step: Triple
    by_yaw: tuple[float, float]
    by_motion: tuple[Triple, Triple, Triple]


class Fading(NamedTuple):
    """Decay of a Gauss-Markov process over a step.

    Attributes:
        decay: factor on its value at the end of the step [-].
        mean: its mean over the step as a share of its initial value [-].
    """

    decay: float
    mean: float


def arc_with_slopes(angle: float) -> tuple[float, float, float, float]:
    """Return both `arc_factors`, and their derivatives by the angle."""
    a, b = arc_factors(angle)
    is_small = abs(angle) < 1e-4
    divisor = select(is_small, 1.0, angle)
    a_slope = select(is_small, -angle / 3.0, (math.cos(angle) - a) / divisor)
    b_slope = select(is_small, 0.5 - angle * angle / 8.0, (math.sin(angle) - b) / divisor)
    return a, b, a_slope, b_slope


def step_on_se2(yaw: float, motion: Any) -> PoseStep:
    """Increment of a pose by a body motion: forward, left [m], yaw [rad]."""
    return step_along_arc(yaw, motion, arc_with_slopes(motion[2]))


def step_along_arc(yaw: float, motion: Any, arc: Any) -> PoseStep:
    """Increment of a pose as in `step_on_se2`, from `arc_with_slopes` of its angle."""
    dx, dy, angle = motion[0], motion[1], motion[2]
    a, b, a_slope, b_slope = arc
    cos, sin = math.cos(yaw), math.sin(yaw)
    chord_x, chord_y = a * dx - b * dy, b * dx + a * dy
    turn_x, turn_y = a_slope * dx - b_slope * dy, b_slope * dx + a_slope * dy
    step_x, step_y = cos * chord_x - sin * chord_y, sin * chord_x + cos * chord_y
    by_motion = (
        (cos * a - sin * b, -cos * b - sin * a, cos * turn_x - sin * turn_y),
        (sin * a + cos * b, -sin * b + cos * a, sin * turn_x + cos * turn_y),
        (0.0, 0.0, 1.0),
    )
    return PoseStep((step_x, step_y, angle), (-step_y, step_x), by_motion)


def turn(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle [rad]."""
    return turn_along_arc(angle, arc_with_slopes(angle))


def turn_along_arc(angle: float, arc: Any) -> tuple[float, float]:
    """Cosine and sine as in `turn`, from `arc_with_slopes` of the angle."""
    return 1.0 - angle * arc[1], angle * arc[0]


def fading(dt: float, tau: float) -> Fading:
    """Decay of a Gauss-Markov process with time constant `tau` over `dt` [s]."""
    ratio = dt / tau
    if ratio > 0.0:
        return Fading(math.exp(-ratio), -math.expm1(-ratio) / ratio)
    return Fading(1.0, 1.0)


def gauss_markov_noise(dt: float, tau: float) -> Triple:
    """Process noise over `dt` of a unit Gauss-Markov process and its integral.

    The process has unit variance.

    Returns:
        Variance of the integral [s²], covariance of integral and value [s], variance of the value.
    """
    ratio = dt / tau
    decay, lost = math.exp(-ratio), -math.expm1(-ratio)
    if ratio < 1e-3:
        integral = 2.0 / 3.0 * tau * tau * (ratio * ratio * ratio) * (1.0 - 0.75 * ratio)
    else:
        integral = 2.0 * tau * tau * (ratio - 2.0 * lost + 0.5 * lost * (1.0 + decay))
    return integral, tau * lost * lost, lost * (1.0 + decay)
