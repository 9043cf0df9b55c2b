"""A small robot file, and a short drive as a bag, for tests of commands."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bag_messages import imu, joints, write_bag

ROBOT = """
name = {name}

[vehicle]
mass = 50.0
track_gauge = 0.8
sprocket_radius = 0.1

[imu]
gyro_axes = "z"

[log]
tracks = {{ topic = {topic}, left = ["l"], right = ["r"] }}
imu = {{ topic = "/imu" }}
truth = {{ topic = "/odom", source = {name} }}

[log.columns]
time = "t"
tracks = {{ left = ["l"], right = ["r"] }}
imu = {{ angular_velocity = ["w"] }}
truth = {{ x = "x", y = "y", yaw = "yaw" }}
"""


# Columns of a table with all streams.
COLUMNS = """
[log.columns]
time = "t"
time_unit = "s"
[log.columns.tracks]
left = ["left"]
right = ["right"]
unit = "m/s"
[log.columns.imu]
angular_velocity = ["gx", "gy", "gz"]
linear_acceleration = ["ax", "ay", "az"]
[log.columns.truth]
x = "truth_x"
y = "truth_y"
yaw = "truth_yaw"
"""


def write_robot(path: Path, name: str = "small", topic: str = "/js") -> Path:
    """Write the file of a robot with a name, and with a topic of the track speeds."""
    text = ROBOT.format(name=json.dumps(name), topic=json.dumps(topic))
    path.write_text(text, encoding="utf-8")
    return path


def drive(path: Path, stamps: Sequence[int], topic: str = "/js") -> Path:
    """Write a bag of a drive that stops and goes, recorded at its stamps [ns]."""
    messages = []
    for k, stamp in enumerate(stamps):
        speed = 10.0 * np.sin(0.05 * k) ** 2
        messages.append((topic, joints(stamp, (speed, 1.2 * speed))))
        messages.append(("/imu", imu(stamp, rate=(0.0, 0.0, 0.25 * speed))))
    return write_bag(path, messages)
