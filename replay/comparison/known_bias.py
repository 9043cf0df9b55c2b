"""Gyro bias that wheels and gyro had no chance to learn.

The variant `gyro` learns its bias at standstill or from fixes. Without either it keeps that of the robot
file, while other variants learn it from the tracks, too. Its drift is then that of a bias, not of its
model. The truth shows the bias, and `gyro` runs with that instead: a fair rival.
"""

from dataclasses import dataclass, replace

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, changed_robot
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.streaming.outputs import Run
from icreckon.replay.estimates.gyro_bias import bias_while_driving
from icreckon.replay.estimates.imu_mounting import YawRates

GYRO = "gyro"
UNLEARNT = 0.5  # share of its initial standard deviation from which a bias is not learnt
LEAST_SHARE = 0.1  # least share of the scored time without a learnt bias that matters
LARGEST = 1.0  # a robot file has no larger bias [rad/s]: the gyro's unit is wrong, not its bias


@dataclass(frozen=True)
class KnownBias:
    """Gyro bias from the truth, if `gyro` used a different one."""

    used: float  # mean of the bias that `gyro` used [rad/s]
    shown: float  # the bias that the truth shows [rad/s]
    sigma: float  # its standard error [rad/s]

    def robot(self, robot: Robot) -> Robot:
        """Copy of a robot that has this bias."""
        sigma = min(self.sigma, robot.imu.gyro_bias_sigma)
        return changed_robot(robot, {"imu.gyro_bias": self.shown, "imu.gyro_bias_sigma": sigma})


def known_bias(run: Run, log: Log, robot: Robot, within: list[tuple[int, int]]) -> KnownBias | None:
    """Estimate from the truth the gyro bias that `gyro` could not learn.

    The log must hold the aligned truth; `within` are the scored intervals of stamps [ns]. None if `gyro`
    learnt its bias in nearly all of them, or if the truth shows no bias that differs significantly from
    the used one, or one larger than `LARGEST`.
    """
    if log.truth is None or log.imu is None:
        return None
    inside = np.zeros(len(run.stamps), bool)
    for start, end in within:
        inside |= (run.stamps >= start) & (run.stamps <= end)
    initial = robot.imu.gyro_bias_sigma
    unlearnt = inside & (run.state_sigmas[:, s.GYRO_BIAS] >= UNLEARNT * initial)
    if not inside.any() or unlearnt.sum() < LEAST_SHARE * inside.sum():
        return None
    used = float(run.states[unlearnt, s.GYRO_BIAS].mean())
    rates = SensorModels(robot).yaw_rates(log.imu.angular_velocity)
    with_headings = replace(log, truth=replace(log.truth, headings=True))
    bias = bias_while_driving(with_headings, YawRates(log.imu.stamps, rates))
    if bias is None or bias.source != "truth" or abs(bias.value) > LARGEST:
        return None
    return KnownBias(used, bias.value, bias.sigma) if bias.differs(used) else None
