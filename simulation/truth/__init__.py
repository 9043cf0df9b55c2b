"""True motion of a robot that follows a command: by friction at its contact points, or kinematic.

In: a command, the robot, terrain and loads. Out: `TrueMotion`. Below: `drives`, `base`.
"""
