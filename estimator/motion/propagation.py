"""Propagation of pose and slip over a step, with derivatives and process noise.

All functions work on scalars, in plain Python and numba (`icreckon.estimator.tracing.jit_kernel`).
"""

import math
from typing import Any, NamedTuple

from icreckon.estimator.base.choices import select
from icreckon.estimator.base.frames import arc_factors
from icreckon.estimator.motion.icr import GRAVITY

Triple = tuple[float, float, float]
LEAST_DOWN = 11.0  # least square of gravity's component towards the ground [m²/s⁴]: a slope of 70°
# Steps of a Gauss-Markov process up to this share of its time constant are computed by series.
SHORT = 0.1
# Coefficients of the integral's variance over the cube of that share, the highest power first.
INTEGRAL = tuple((-1) ** n * (4 - 2**n) / math.factorial(n) for n in range(10, 2, -1))


class PoseStep(NamedTuple):
    """Increment of a pose by a body motion."""

    step: Triple  # x, y [m], yaw [rad] in the axes in which the pose is given
    by_yaw: tuple[float, float]  # derivative of its x and y by the yaw of the pose
    by_motion: tuple[Triple, Triple, Triple]  # (3, 3) its derivative by the motion


class GaussMarkov(NamedTuple):
    """Transition of a Gauss-Markov process of unit variance, and its noise."""

    decay: float  # factor on its value at the end of the step [-]
    mean: float  # its mean over the step as a share of its initial value [-]
    integral: float  # variance that noise adds to its integral [s²]
    cross: float  # covariance that noise adds to integral and value [s]
    final: float  # variance that noise adds to its value [-]


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


def downward_gravity(gravity: Any) -> float:
    """Acceleration of gravity towards the ground, by its components along it [m/s²]."""
    along = gravity[0] * gravity[0] + gravity[1] * gravity[1]
    return math.sqrt(max(GRAVITY * GRAVITY - along, LEAST_DOWN))


def horizontal_projection(gravity: Any) -> tuple[Any, float]:
    """Factors from a body velocity to its projection onto the horizontal.

    The heading is the direction of the body's projected x axis. The yaw rate is the kinematics of Euler
    angles (Titterton and Weston, Strapdown Inertial Navigation Technology, section 3.6). Gravity along
    the ground is forward and left, in m/s².

    Returns:
        Matrix (3, 3) from velocity forward, left and rate about the body's z axis to velocity along the
        heading, to the left of it, and yaw rate; and the factor from the pitch rate to the yaw rate.
    """
    # Upward direction in the axes of the body; the x axis has the horizontal length cos(pitch).
    (up_x, up_y), up_z = upward(gravity), downward_gravity(gravity) / GRAVITY
    square = up_y * up_y + up_z * up_z
    cos_pitch = math.sqrt(square)
    along_heading = (cos_pitch, -up_x * up_y / cos_pitch, 0.0)
    projection = (along_heading, (0.0, up_z / cos_pitch, 0.0), (0.0, 0.0, up_z / square))
    return projection, up_y / square


def upward(gravity: Any) -> tuple[Any, Any]:
    """Components of the upward direction along the ground, forward and left [-]."""
    return gravity[0] / -GRAVITY, gravity[1] / -GRAVITY


def turn(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle [rad], to the last bit as along an arc."""
    return turn_along_arc(angle, arc_with_slopes(angle))


def turn_along_arc(angle: float, arc: Any) -> tuple[float, float]:
    """Cosine and sine as in `turn`, from `arc_with_slopes` of the angle."""
    return 1.0 - angle * arc[1], angle * arc[0]


def gauss_markov(dt: float, tau: float) -> GaussMarkov:
    """Transition of a Gauss-Markov process of unit variance over a step [s]."""
    ratio = dt / tau
    # Series in this ratio where differences of nearly equal numbers would be left.
    short, long = min(ratio, SHORT), max(ratio, SHORT)
    decay = math.exp(-ratio)
    lost = 1.0 - decay
    faded = 1.0
    for divisor in (8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0):
        faded = 1.0 - short / divisor * faded
    integral = 0.0
    for coefficient in INTEGRAL:
        integral = coefficient + short * integral
    is_short = ratio < SHORT
    mean = select(is_short, faded, lost / long)
    by_series = short * short * short * integral
    exact = 2.0 * (long - 2.0 * lost) + lost * (2.0 - lost)
    integral = select(is_short, by_series, exact)
    lost = mean * ratio
    return GaussMarkov(decay, mean, tau * tau * integral, tau * lost * lost, lost * (1.0 + decay))
