"""Friction motion model: a vehicle under the ground's forces, integrated in time.

    twist = v + dv/dp (p - p') + dv/dg (g - g') + dv/dV (V - V') + slip

where v is the twist that `icreckon.estimator.friction.step` has integrated up to the end of the present
step, with the estimates of the parameters p' and of gravity along the ground g' at its start, at its
track speeds V'. The derivatives are integrated,
too, so that they contain the effect of the parameters on all motion so far. Updates of the parameters
within a step act linearly, and enter the integration with the next step.

The parameters are the uncertain properties of the vehicle on its ground, in physical units: friction and
rolling resistance [-], half the contact's length and the three coordinates of the centre of mass [m]; two
of the nine places stay empty. The model does not use indices; those that it reports are of the newest
turns, averaged over a short time.

Friction is that of `icreckon.estimator.motion.contact`, but it fades at slip below `REGULARISING_SPEED`:
track speeds are not accurate enough to resolve the kink in Coulomb's law.

Symbols and axes are the paper's (see `icreckon.estimator.motion.icr`). `linearise` accepts floats, and
complex numbers for complex-step differentiation, and lanes trace it, see
`icreckon.estimator.motion.motion_model`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.state import PARAMETER_COUNT
from icreckon.estimator.friction.layout import (
    AT_INPUTS,
    AT_SPEEDS,
    BODY_CONSTANTS,
    FRICTION,
    INPUTS,
    LENGTH,
    MEMORY,
    OF_SENSITIVITIES,
    OF_SPEEDS,
    PARAMETERS,
    REGULARISING_SPEED,
    ROLLING,
    TURN,
    X_CM,
    Y_CM,
    Z_CM,
)
from icreckon.estimator.motion.contact import Contact, ground
from icreckon.estimator.motion.icr import GRAVITY, IndexValues, Number, PaperTwist, signed_inertia
from icreckon.estimator.motion.motion_model import (
    LEVEL,
    Gravity,
    Motion,
    TwistDerivatives,
    VehicleConstants,
    at_or_above,
    sign,
)

if TYPE_CHECKING:
    from icreckon.estimator.friction.kernel import OneModel

# Bounds of the parameters: least friction, rolling resistance and height of the centre of mass, which
# divides [m]; range of the contact's length as shares of its nominal value; range of the centre of mass
# as shares of half the gauge and of half the contact's length.
LEAST_FRICTION, LEAST_ROLLING, LEAST_HEIGHT = 0.05, 0.0, 1e-3
# Friction is at least this share of the robot file's, and so many times the rolling resistance.
LEAST_OF_NOMINAL, LEAST_TRACTION = 0.2, 2.0
LEAST_LENGTH = 0.1
WITHIN_GAUGE, WITHIN_LENGTH = 0.8, 0.8


class FrictionMotion:
    """Friction motion model of one vehicle on its ground; see `MotionModel`.

    Args:
        vehicle: L, M and the centre of mass.
        contact: nominal contact of the vehicle with its ground.
        yaw_inertia: moment of inertia about the vertical through the centre of mass [kg m²].
        load_lag: time constant of the load transfer [s].
        eta: typical steering efficiency index of the vehicle [-].
        estimated: (6,) mask of estimated parameters; derivatives by the others are omitted.
    """

    def __init__(
        self,
        vehicle: VehicleConstants,
        contact: Contact,
        yaw_inertia: float,
        load_lag: float,
        eta: float,
        estimated: Floats,
    ) -> None:
        self.vehicle = vehicle
        self.eta = eta
        self._yaw_inertia, self._load_lag = float(yaw_inertia), float(load_lag)
        at = ground(contact)
        self._ground = at._replace(small=max(REGULARISING_SPEED, at.small))
        self._estimated = np.array(estimated, dtype=float)
        self.nominal = nominal_parameters(contact)
        self._one: OneModel | None = None
        self._memory: Floats = np.zeros(MEMORY)
        self._memory[AT_INPUTS] = [*self.nominal, *LEVEL]
        self._memory[TURN] = 0.0, 0.0, eta

    @property
    def bounds(self) -> Floats:
        """Bounds (n, 10) of the parameters, as in `MotionModel`."""
        half_gauge = 0.5 * self.vehicle.gauge
        rows = np.zeros((9, PARAMETER_COUNT + 1))
        for row, (place, least) in enumerate(
            (
                (FRICTION, max(LEAST_FRICTION, LEAST_OF_NOMINAL * self.nominal[FRICTION])),
                (ROLLING, LEAST_ROLLING),
                (Z_CM, LEAST_HEIGHT),
                (LENGTH, LEAST_LENGTH * self.nominal[LENGTH]),
            )
        ):
            rows[row, [place, -1]] = 1.0, least
        for row, side in ((4, 1.0), (5, -1.0)):
            rows[row, [X_CM, -1]] = side, -WITHIN_GAUGE * half_gauge
            rows[row + 2, [Y_CM, LENGTH]] = side, WITHIN_LENGTH
        # Tracks that cannot overcome the rolling resistance would move nothing.
        rows[8, [FRICTION, ROLLING]] = 1.0, -LEAST_TRACTION
        return rows

    @property
    def memory(self) -> Floats:
        """Checkpoint (MEMORY,) of the model."""
        return self._memory

    def recall(self, memory: Floats) -> None:
        """Restore a checkpoint, as in `MotionModel`."""
        if memory.shape != (MEMORY,):
            raise ValueError(
                f"the friction model remembers {MEMORY} numbers, not {len(memory)}: they are another's"
            )
        self._memory = memory

    @property
    def sheared(self) -> bool:
        """True if friction builds up with the shear displacement."""
        return self._ground.shear_modulus > 0.0

    @property
    def constants(self) -> dict[str, float]:
        """Values of `layout.BODY_CONSTANTS`."""
        at, (half_width, rear, front) = self._ground, self._ground.outline
        upper = np.triu_indices(3)
        values = (
            *(at.mass, at.weight, self._yaw_inertia, self._load_lag, at.half_gauge),
            *(half_width, rear, front, at.shear_modulus, at.small, float(at.opposes_travel)),
            *(*at.even[upper], *at.friction.ravel(), *self.nominal, *(self._estimated != 0.0)),
            len(at.x) // 2,
        )
        return dict(zip(BODY_CONSTANTS, map(float, values), strict=True))

    @property
    def pairs(self) -> Floats:
        """Pairs of contact points (k, 4), see `icreckon.estimator.friction.loads`."""
        at, count = self._ground, len(self._ground.x) // 2
        return np.stack([at.x[:count], at.x[count:], at.y[:count], at.share[:count]], axis=-1)

    @property
    def taught_by_imu(self) -> tuple[int, ...]:
        """Places of the parameters that the IMU moves, as in `MotionModel`."""
        return (LENGTH,)

    def begin_step(
        self, dt: float, V_l: float, V_r: float, parameters: Any, gravity: Gravity
    ) -> None:
        """Begin a step, as in `MotionModel`."""
        from icreckon.estimator.friction.kernel import OneModel

        if self._one is None:
            self._one = OneModel(self.constants, self.pairs, sheared=self.sheared)
        inputs = [*parameters[:PARAMETERS], *gravity]
        self._memory = self._one.step(self._memory, inputs, (V_l, V_r), dt)

    def steering_efficiency(self, parameters: Any) -> float:  # noqa: ARG002 - it hardly depends
        """Typical steering efficiency index [-], as in `MotionModel`."""
        return self.eta

    def linearise(
        self,
        V_l: Number,
        V_r: Number,
        parameters: Any,
        slip: tuple[Number, Number, Number],
        gravity: Gravity,
    ) -> tuple[Motion, TwistDerivatives]:
        """Motion and derivatives of its twist; `u` is the signed specific force."""
        return linearise(V_l, V_r, parameters, slip, gravity, self.vehicle, self._memory)


def nominal_parameters(contact: Contact) -> Floats:
    """Parameters (6,) of a contact."""
    soil, body = contact.soil, contact.body
    return np.array(
        [
            soil.friction,
            soil.rolling_resistance,
            contact.geometry.positions[-1],
            body.x_CM,
            body.y_CM,
            max(body.z_CM, LEAST_HEIGHT),
        ]
    )


def linearise(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    slip: tuple[Number, Number, Number],
    gravity: Gravity,
    vehicle: VehicleConstants,
    memory: Floats,
) -> tuple[Motion, TwistDerivatives]:
    """Linearise the friction model, see `FrictionMotion.linearise`.

    `memory` is laid out as in `icreckon.estimator.friction.layout`.
    """
    left, right = V_l - memory[AT_SPEEDS.start], V_r - memory[AT_SPEEDS.start + 1]
    inputs = (*(parameters[k] for k in range(PARAMETERS)), gravity[0], gravity[1])
    v_x = _component(memory, 0, inputs, left, right) + slip[0]
    v_y = _component(memory, 1, inputs, left, right) + slip[1]
    w = _component(memory, 2, inputs, left, right) + slip[2]
    twist = PaperTwist(v_x, v_y, w)
    indices = IndexValues(memory[TURN.start], memory[TURN.start + 1], memory[TURN.start + 2])
    u, _ = signed_inertia(twist, vehicle.mass, vehicle.x_CM)
    u = u - vehicle.mass * gravity[0]
    weight = vehicle.mass * GRAVITY
    is_above = at_or_above(abs(u.real), weight)
    force = (1.0 - is_above) * u + is_above * sign(u) * weight
    return Motion(twist, indices, u, force), TwistDerivatives(
        (_sensitivities(memory, 0), _sensitivities(memory, 1), _sensitivities(memory, 2)),
        (_by_speeds(memory, 0), _by_speeds(memory, 1), _by_speeds(memory, 2)),
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        (_by_gravity(memory, 0), _by_gravity(memory, 1), _by_gravity(memory, 2)),
    )


def _component(memory: Floats, row: int, inputs: Any, left: Number, right: Number) -> Number:
    """Component of the twist, without slip."""
    total = memory[row] + memory[OF_SPEEDS.start + 2 * row] * left
    total = total + memory[OF_SPEEDS.start + 2 * row + 1] * right
    first = OF_SENSITIVITIES.start + INPUTS * row
    for k in range(INPUTS):
        total = total + memory[first + k] * (inputs[k] - memory[AT_INPUTS.start + k])
    return total


def _sensitivities(memory: Floats, row: int) -> tuple[float, ...]:
    first = OF_SENSITIVITIES.start + INPUTS * row
    return (
        memory[first],
        memory[first + 1],
        memory[first + 2],
        memory[first + 3],
        memory[first + 4],
        memory[first + 5],
        0.0,
        0.0,
        0.0,
    )


def _by_gravity(memory: Floats, row: int) -> tuple[float, float]:
    first = OF_SENSITIVITIES.start + INPUTS * row + PARAMETERS
    return memory[first], memory[first + 1]


def _by_speeds(memory: Floats, row: int) -> tuple[float, float]:
    return memory[OF_SPEEDS.start + 2 * row], memory[OF_SPEEDS.start + 2 * row + 1]
