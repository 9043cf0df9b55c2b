"""What a filter needs of a motion model: body velocity from track speeds, with its derivatives.

`estimator.motion.index_model` has the paper's model, `estimator.motion.friction_model` that of friction.
Inside, inputs act only through eight *channels* (D = V_r - V_l, V_m = (V_l + V_r) / 2, the three indices
and the slip), so a derivative by a parameter is a channel's times what multiplies that parameter in its
index, its *regressor*. What is handed out are derivatives by the parameters, track speeds and slip
themselves.

Symbols and axes are the paper's (see `kinematics`). Functions without a class are written for floats,
complex numbers and arrays, and for numba (`estimator.tracing.jit_kernel`): they look at real parts only
in comparisons, and branch on plain flags only.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import IndexValues, Number, PaperTwist

NO_SLIP: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
# What a model remembers that remembers nothing.
NO_MEMORY: Floats = np.zeros(0)


class VehicleConstants(NamedTuple):
    """L [m], M [kg] and the centre of mass (right, forward) [m], as the paper has them."""

    gauge: float
    mass: float
    x_CM: float
    y_CM: float


class Motion(NamedTuple):
    """The motion at given track speeds.

    Attributes:
        twist: body velocity, slip included.
        indices: index values of this motion.
        u: the (signed) force of inertia [N].
        force: the same, of at most the weight.
    """

    twist: PaperTwist
    indices: IndexValues
    u: Number
    force: Number


class TwistDerivatives(NamedTuple):
    """Total derivatives of (v_x, v_y, w); each has three rows, as tuples or as an array.

    Attributes:
        by_parameters: (3, 8), in the order of `estimator.robot.robot_file.Indices`.
        by_speeds: (3, 2) by V_l and V_r.
        by_slip: (3, 3) by r_x, r_y and r_w.
    """

    by_parameters: Any
    by_speeds: Any
    by_slip: Any


class MotionModel(Protocol):
    """How a robot moves at given track speeds.

    A model may remember: what it says may depend on how the robot has moved before. Then `begin_step`
    tells it how time goes on, and `memory` and `recall` let the filter go back in time, be copied and be
    saved. A model that does not remember inherits from `Unremembering`.
    """

    @property
    def vehicle(self) -> VehicleConstants:
        """L, M, x_CM, y_CM."""

    @property
    def bounds(self) -> Floats:
        """(n, 9) where the parameters p can be: rows of a (8,) and b in a p >= b."""

    def steering_efficiency(self, parameters: Any) -> float:
        """Typical steering efficiency index [-] at these parameters, without inertia."""

    def linearise(
        self, V_l: Number, V_r: Number, parameters: Any, slip: tuple[Number, Number, Number]
    ) -> tuple[Motion, TwistDerivatives]:
        """The motion and the total derivatives of its twist; changes nothing.

        Args:
            V_l: speed of the left track [m/s].
            V_r: speed of the right track [m/s].
            parameters: the eight, those of index models in the order of
                `estimator.robot.robot_file.Indices`.
            slip: residual (r_x, r_y, r_w) added to the model's twist.
        """

    @property
    def memory(self) -> Floats:
        """(m,) all that it remembers; never changed afterwards."""

    def recall(self, memory: Floats) -> None:
        """Go by what it remembered then.

        Args:
            memory: (m,) as `memory` gave it.

        Raises:
            ValueError: it is not of the length that the model's memory has.
        """

    def begin_step(self, dt: float, V_l: float, V_r: float, parameters: Any) -> None:
        """A step begins, at whose mean speeds the model is asked from here on.

        Args:
            dt: how long it is [s].
            V_l: mean speed of the left track in it [m/s].
            V_r: mean speed of the right track in it [m/s].
            parameters: the eight, as they stand.
        """


class Unremembering:
    """The part of a `MotionModel` that is about memory, for one that has none."""

    @property
    def memory(self) -> Floats:
        """(0,)."""
        return NO_MEMORY

    def recall(self, memory: Floats) -> None:
        """See `MotionModel`."""
        if memory.shape != NO_MEMORY.shape:
            raise ValueError(f"a motion model without memory cannot recall {len(memory)} numbers")

    def begin_step(self, dt: float, V_l: float, V_r: float, parameters: Any) -> None:
        """See `MotionModel`."""


class Regressors(NamedTuple):
    """What multiplies each gain in its index, in units of the index over those of the gain."""

    zeta1: Number
    epsilon1: Number
    eta1: Number
    eta2: Number


class Channels(NamedTuple):
    """Total derivatives of (v_x, v_y, w) by each channel: each a triple."""

    D: tuple[Number, Number, Number]
    V_m: tuple[Number, Number, Number]
    zeta: tuple[Number, Number, Number]
    epsilon: tuple[Number, Number, Number]
    eta: tuple[Number, Number, Number]
    r_x: tuple[Number, Number, Number]
    r_y: tuple[Number, Number, Number]
    r_w: tuple[Number, Number, Number]


def through_channels(by: Channels, gains: Regressors) -> TwistDerivatives:
    """Derivatives by the parameters, track speeds and slip from those by the channels."""
    return TwistDerivatives(
        (_by_parameters(by, gains, 0), _by_parameters(by, gains, 1), _by_parameters(by, gains, 2)),
        (_by_speeds(by, 0), _by_speeds(by, 1), _by_speeds(by, 2)),
        (
            (by.r_x[0], by.r_y[0], by.r_w[0]),
            (by.r_x[1], by.r_y[1], by.r_w[1]),
            (by.r_x[2], by.r_y[2], by.r_w[2]),
        ),
    )


def _by_parameters(by: Channels, gains: Regressors, axis: int) -> tuple[Number, ...]:
    """H has no gradient in any model."""
    zeta, epsilon, eta = by.zeta[axis], by.epsilon[axis], by.eta[axis]
    return (
        0.0 * zeta,
        zeta,
        zeta * gains.zeta1,
        epsilon,
        epsilon * gains.epsilon1,
        eta,
        eta * gains.eta1,
        eta * gains.eta2,
    )


def _by_speeds(by: Channels, axis: int) -> tuple[Number, Number]:
    half = 0.5 * by.V_m[axis]
    return half - by.D[axis], half + by.D[axis]


# Comparisons look at the real part only, so that a complex step passes through.


def sign(x: Number) -> Number:
    """-1, 0 or 1."""
    return 1.0 * (x.real > 0.0) - 1.0 * (x.real < 0.0)


def at_or_above(x: Number, bound: float) -> Number:
    """1 or 0."""
    return 1.0 * (x.real >= bound)


def is_zero(x: Number) -> Number:
    """1 or 0."""
    return 1.0 * (x == 0.0)


def at_least(x: Number, bound: float) -> Number:
    """The larger of the two."""
    inside = at_or_above(x, bound)
    return inside * x + (1.0 - inside) * bound


def dot(a: tuple[Number, Number, Number], b: tuple[Number, Number, Number]) -> Number:
    """Of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class TwistModel(NamedTuple):
    """The body velocity at a state.

    Attributes:
        twist: (3,) v_x, v_y [m/s], w [rad/s].
        jacobian: (3, SIZE) its derivative by the state; that by the parameters smoothed in time.
        by_speeds: (3, 2) its derivative by the speeds of the left and the right track.
        motion: the solved motion model, in the paper's axes.
    """

    twist: Floats
    jacobian: Floats
    by_speeds: Floats
    motion: Motion
