"""State vector of the filter: its layout, and the names of its elements.

Pose, slip and biases are in REP-103 axes (x forward, y left); the index parameters are the paper's.
"""

from typing import Final

STATE_NAMES: Final[tuple[str, ...]] = (
    "x",  # pose of base_link in odom [m, m, rad]
    "y",
    "yaw",
    "z",  # height of base_link in odom [m]
    "slip_x",  # body velocity less that of the kinematics [m/s, m/s, rad/s]
    "slip_y",
    "slip_w",
    "H",  # the eight parameters, (25) to (27); units of the gains: docs/explanation/model.md
    "zeta0",
    "zeta1",
    "epsilon0",
    "epsilon1",
    "eta0",
    "eta1",
    "eta2",
    "epsilon_F",  # a ninth, for the force along the tracks
    "gyro_bias",  # reading less rate [rad/s]
    "accelerometer_bias_x",  # reading less specific force, in base_link [m/s²]
    "accelerometer_bias_y",
    "gyro_bias_x",  # biases of the roll and pitch rates [rad/s]
    "gyro_bias_y",
    "track_scale",  # true over measured track speed, less 1 [-]
    "track_difference",  # that of the right track less that of the left [-]
    "gyro_scale",  # measured over true rate, less 1 [-]
    "gravity_x",  # acceleration of gravity along the ground, in base_link [m/s²]
    "gravity_y",
    "fast_slip_x",  # slip and track-speed error that are new with each step [m/s, m/s, rad/s]
    "fast_slip_y",
    "fast_slip_w",
)
"""Names (SIZE,) of the states of the inertia-based variants, in their order."""

NO_NAME: Final = ""  # name of a parameter's place that the variant's model does not use
SIZE: Final = len(STATE_NAMES)
X, Y, YAW, Z = range(4)
POSE: Final = slice(0, 3)
POSITION: Final = slice(0, 2)
MOVED: Final = slice(0, 4)  # states that a step moves by the twist: the pose and the height
SLIP: Final = slice(4, 7)
SLIP_X, SLIP_Y, SLIP_W = range(4, 7)
PARAMETERS: Final = slice(7, 16)
PARAMETER_COUNT: Final = 9
# Derivatives by the parameters, and last the yaw rate, by which the gyro's scale counts.
REGRESSOR_COUNT: Final = PARAMETER_COUNT + 1
PARAMETER_NAMES: Final[tuple[str, ...]] = STATE_NAMES[PARAMETERS]
ZETA0, ZETA1, EPSILON0, EPSILON1, ETA0, ETA1, ETA2, EPSILON_F = range(8, 16)
GYRO_BIAS: Final = 16
ACCELEROMETER_BIAS_X, ACCELEROMETER_BIAS_Y = range(17, 19)
ACCELEROMETER_BIASES: Final = slice(17, 19)
GYRO_BIAS_X, GYRO_BIAS_Y = range(19, 21)
TRACK_SCALE: Final = 21
TRACK_DIFFERENCE: Final = 22
GYRO_SCALE: Final = 23
BIASES: Final = slice(GYRO_BIAS, GYRO_SCALE + 1)
LEARNT: Final = slice(PARAMETERS.start, BIASES.stop)
GRAVITY: Final = slice(24, 26)
GRAVITY_X, GRAVITY_Y = range(24, 26)
FAST_SLIP: Final = slice(26, 29)
FAST_SLIP_W: Final = 28
# Behind the states: wander of the position fixes along x and y of odom [m], if the filter estimates it.
WANDER: Final = slice(29, 31)
WANDER_X, WANDER_Y = range(29, 31)
WANDER_NAMES: Final[tuple[str, ...]] = ("wander_x", "wander_y")
