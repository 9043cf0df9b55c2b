"""Layout of the friction model: parameters, memory, and names of constants."""

from __future__ import annotations

from typing import Final

# Slip and travel below which friction and rolling resistance fade [m/s].
REGULARISING_SPEED = 1e-3

# Places of the friction parameters among the nine.
FRICTION, ROLLING, LENGTH, X_CM, Y_CM, Z_CM = range(6)

PARAMETERS = 6

# Gravity along the ground, right and forward, behind the parameters in the derivatives and in what
# these are at.
INPUTS = PARAMETERS + 2

PARAMETER_NAMES: Final[tuple[str, ...]] = (
    "friction",
    "rolling_resistance",
    "half_contact_length",
    "x_CM",
    "y_CM",
    "z_CM",
)

# v_x, v_y, w, and the force at the centre of mass that transfers load, right and forward.
STATES = 5

# Memory of the model, flat: states, their derivatives by parameters and gravity in rows, those of the
# twist by the track speeds in rows, parameters, gravity and speeds of the linearisation, indices of the
# newest turns, and a flag for the first step.
OF_STATES = slice(0, STATES)

OF_SENSITIVITIES = slice(STATES, STATES * (1 + INPUTS))

OF_SPEEDS = slice(OF_SENSITIVITIES.stop, OF_SENSITIVITIES.stop + 6)

AT_INPUTS = slice(OF_SPEEDS.stop, OF_SPEEDS.stop + INPUTS)

AT_SPEEDS = slice(AT_INPUTS.stop, AT_INPUTS.stop + 2)

TURN = slice(AT_SPEEDS.stop, AT_SPEEDS.stop + 3)

STARTED = TURN.stop

MEMORY = STARTED + 1

# Derivatives of the force that transfers load by the track speeds, which a substep hands to the next.
CARRIED = ("right_by_left", "right_by_right", "forward_by_left", "forward_by_right")

# Constants of a substep: its length h [s], the factor exp(-h / T) on the force that transfers load, 1 in
# the first of a step, and the share of a step in the averaged indices of turns, 0 before the last.
SUBSTEP_CONSTANTS = ("h", "keep", "is_first", "turn_share")

# Constants of a vehicle on its ground, see `icreckon.estimator.motion.contact_forces.Ground`: `even` is
# the upper triangle of a symmetric matrix, `friction` across and along each track, `pairs` the number of
# pairs of contact points.
BODY_CONSTANTS = (
    *("mass", "weight", "yaw_inertia", "load_lag", "half_gauge", "half_width", "rear", "front"),
    *("shear_modulus", "small", "opposes_travel"),
    *(f"even{k}" for k in range(6)),
    *(f"friction{k}" for k in range(4)),
    *(f"nominal{k}" for k in range(PARAMETERS)),
    *(f"estimated{k}" for k in range(PARAMETERS)),
    "pairs",
)
