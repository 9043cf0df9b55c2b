"""Layout of the friction state: parameters by place, and the flat record that a model remembers."""

from __future__ import annotations

from typing import Final

# Slip and travel below which friction and rolling resistance fade [m/s].
REGULARISING_SPEED = 1e-3


# The parameters, the places of the eight that they take.
FRICTION, ROLLING, LENGTH, X_CM, Y_CM, Z_CM = range(6)


PARAMETERS = 6


PARAMETER_NAMES: Final[tuple[str, ...]] = (
    "friction",
    "rolling_resistance",
    "half_contact_length",
    "x_CM",
    "y_CM",
    "z_CM",
    "unused_1",
    "unused_2",
)


# v_x, v_y, w, and the force at the centre of mass that the loads answer to, right and forward.
STATES = 5


# What the model remembers, laid out flat: the states, their derivatives by the parameters in rows, those
# of the twist by the track speeds in rows, the parameters and the speeds that all this is at, the indices
# of the newest turns, and whether there was a step yet.
OF_STATES = slice(0, STATES)


OF_SENSITIVITIES = slice(STATES, STATES * (1 + PARAMETERS))


OF_SPEEDS = slice(OF_SENSITIVITIES.stop, OF_SENSITIVITIES.stop + 6)


AT_PARAMETERS = slice(OF_SPEEDS.stop, OF_SPEEDS.stop + PARAMETERS)


AT_SPEEDS = slice(AT_PARAMETERS.stop, AT_PARAMETERS.stop + 2)


TURN = slice(AT_SPEEDS.stop, AT_SPEEDS.stop + 3)


STARTED = TURN.stop


MEMORY = STARTED + 1
