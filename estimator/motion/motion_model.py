"""Interface of motion models: body velocity from track speeds, with derivatives.

`icreckon.estimator.motion.lagged_index_model` has the inertia-based model,
`icreckon.estimator.motion.linear_model` the linear one.

Symbols and axes are the paper's (see `icreckon.estimator.motion.icr`). Functions without a class are
written for floats, complex numbers and arrays, and for numba (`icreckon.estimator.tracing.jit_kernel`):
comparisons use real parts only, and branches plain flags only.
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import IndexValues, Number, PaperTwist

# Residual of the twist: r_x, r_y [m/s], r_w [rad/s].
BodySlip = tuple[Number, Number, Number]
NO_SLIP: BodySlip = (0.0, 0.0, 0.0)
# Acceleration of gravity along the ground, right and forward [m/s²].
Gravity = tuple[Number, Number]
LEVEL: Gravity = (0.0, 0.0)
NO_MEMORY: Floats = np.zeros(0)  # checkpoint of a model without memory


def track_factors(x: Any) -> tuple[Any, Any]:
    """True over measured speeds of the left and the right track, of a state."""
    scale, half = 1.0 + x[s.TRACK_SCALE], 0.5 * x[s.TRACK_DIFFERENCE]
    return scale - half, scale + half


def gravity_in(x: Any) -> tuple[Any, Any]:
    """Gravity along the ground, right and forward [m/s²], of a state."""
    return -x[s.GRAVITY_Y], x[s.GRAVITY_X]


class VehicleConstants(NamedTuple):
    """Constants of a vehicle, the paper's first."""

    gauge: float  # L [m]
    mass: float  # M [kg]
    x_CM: float  # centre of mass, right of the origin [m]
    y_CM: float  # centre of mass, forward of it [m]
    rolling_resistance: float = 0.0  # coefficient of rolling resistance [-]
    load_lag: float = 0.2  # time constant of the load transfer [s]
    zeta_F: float = 0.0  # shift of y_ICR backward by a force forward as large as the weight [m]


class Motion(NamedTuple):
    """Motion at given track speeds."""

    twist: PaperTwist  # body velocity, slip included
    indices: IndexValues  # index values of this motion
    u: Number  # the (signed) force of inertia [N]
    force: Number  # u limited to the weight [N]


class TwistDerivatives(NamedTuple):
    """Total derivatives of (v_x, v_y, w), three rows each, as tuples or arrays."""

    by_parameters: Any  # (3, 9) by the parameters, in the order of `robot_file.Indices`
    by_speeds: Any  # (3, 2) by V_l and V_r
    by_slip: Any  # (3, 3) by r_x, r_y and r_w
    # (3, 2) by gravity along the ground, right and forward
    by_gravity: Any = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))


class MotionModel(Protocol):
    """Motion model: body velocity of a robot at given track speeds.

    A model may have memory: its output may depend on earlier motion. Then `begin_step` advances it in
    time, and `memory` and `recall` are checkpoint and restore, with which the filter goes back in time,
    is copied and saved. A model without memory inherits from `Unremembering`.
    """

    @property
    def vehicle(self) -> VehicleConstants:
        """L, M, x_CM, y_CM."""

    @property
    def bounds(self) -> Floats:
        """Bounds (n, 10) of the parameters p: rows of a (9,) and b in a p >= b."""

    @property
    def taught_by_imu(self) -> tuple[int, ...]:
        """Indices in p of the parameters that the filter corrects by the IMU.

        Fixes and body velocities alone correct the others: the IMU would take other errors of the motion
        for errors of these parameters.
        """

    def steering_efficiency(self, parameters: Any) -> float:
        """Steering efficiency index [-] at parameters (9,), without the effect of inertia."""

    def linearise(
        self, V_l: Number, V_r: Number, parameters: Any, slip: BodySlip, gravity: Gravity
    ) -> tuple[Motion, TwistDerivatives]:
        """Compute the motion and the total derivatives of its twist, without side effects.

        Args:
            V_l: speed of the left track [m/s].
            V_r: speed of the right track [m/s].
            parameters: nine parameters, those of index models in the order of
                `icreckon.estimator.robot.robot_file.Indices`.
            slip: residual (r_x, r_y, r_w) added to the model's twist.
            gravity: acceleration of gravity along the ground, right and forward [m/s²].
        """

    @property
    def memory(self) -> Floats:
        """Memory (m,) of the model itself, which steps change in place."""

    def recall(self, memory: Floats) -> None:
        """Restore a checkpoint, a copy (m,) of `memory`; `ValueError` for another length."""

    def begin_step(
        self, dt: float, V_l: float, V_r: float, parameters: Any, gravity: Gravity
    ) -> None:
        """Begin a step; later calls of `linearise` are at its mean speeds.

        Args:
            dt: length of the step [s].
            V_l: mean speed of the left track in the step [m/s].
            V_r: mean speed of the right track in the step [m/s].
            parameters: present estimate of the nine parameters.
            gravity: acceleration of gravity along the ground, right and forward [m/s²].
        """


class Unremembering:
    """Base of a `MotionModel` without memory."""

    @property
    def memory(self) -> Floats:
        """Checkpoint (0,), empty."""
        return NO_MEMORY

    def recall(self, memory: Floats) -> None:
        """Restore a checkpoint, as in `MotionModel`."""
        if memory.shape != NO_MEMORY.shape:
            raise ValueError(f"a motion model without memory cannot recall {len(memory)} numbers")

    def begin_step(
        self, dt: float, V_l: float, V_r: float, parameters: Any, gravity: Gravity
    ) -> None:
        """Begin a step, as in `MotionModel`."""


def sign(x: Number) -> Number:
    """Sign of the real part: -1, 0 or 1."""
    return 1.0 * (x.real > 0.0) - 1.0 * (x.real < 0.0)


def at_or_above(x: Number, bound: float) -> Number:
    """Return 1 if x is at least `bound`, else 0."""
    return 1.0 * (x.real >= bound)


def is_zero(x: Number) -> Number:
    """Return 1 if x is zero, else 0."""
    return 1.0 * (x == 0.0)


def at_least(x: Number, bound: float) -> Number:
    """Larger of x and `bound`."""
    inside = at_or_above(x, bound)
    return inside * x + (1.0 - inside) * bound


class TwistModel(NamedTuple):
    """Body velocity at a state, with derivatives."""

    twist: Floats  # (3,) v_x, v_y [m/s], w [rad/s]
    jacobian: Floats  # (3, SIZE) its derivative by the state, smoothed for parameters
    by_speeds: Floats  # (3, 2) its derivative by the speeds of the left and the right track
    motion: Motion  # the solved motion model, in the paper's axes
