"""True motion of a robot that follows a command, from friction or kinematics.

In: a command, the robot, terrain and loads. Out: `TrueMotion`. Below: `drives`, `base`.
"""
