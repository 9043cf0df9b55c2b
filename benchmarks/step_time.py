"""Time of one step of the streaming filter, beside filterpy's plain EKF of the same size.

A step is a track-speed sample and an IMU sample (gyro and accelerometer), fed from a simulated drive.
The plain EKF does the same algebra (a prediction and two scalar updates with as many states) without any
motion model, gate or bookkeeping.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from estimator import state as s
from estimator.log import Log
from estimator.pose_estimator import PoseEstimator
from estimator.robot import Robot, load_robot
from estimator.settings import Settings
from estimator.variants import VARIANTS
from simulation.scenario import Scenario, simulate

RATE, DURATION = 50.0, 60.0


def filter_microseconds(
    log: Log, robot: Robot, variant: str, settings: Settings | None = None
) -> float:
    """Mean time of a step [µs] over a log whose track speeds and IMU are in step."""
    estimator = PoseEstimator(robot, variant, settings=settings)
    measurements = list(log.measurements())
    begin = time.perf_counter()
    for measurement in measurements:
        estimator.feed(measurement)
    return 1e6 * (time.perf_counter() - begin) / (len(measurements) / 2)


def plain_microseconds(steps: int) -> float:
    """The same of filterpy's EKF, which predicts and updates twice."""
    ekf = ExtendedKalmanFilter(dim_x=s.SIZE, dim_z=1)
    ekf.x = np.zeros(s.SIZE)
    row = np.zeros((1, s.SIZE))
    row[0, :3] = 1.0
    zero = np.zeros(1)
    begin = time.perf_counter()
    for _ in range(steps):
        ekf.predict()
        for _ in range(2):
            ekf.update(zero, lambda _: row, lambda x: row @ x)
    return 1e6 * (time.perf_counter() - begin) / steps


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--repeat", type=int, default=5, help="best of so many runs")
    arguments = parser.parse_args()
    robot = load_robot("auriga-alpha")
    log = simulate(
        Scenario(duration=DURATION, track_rate=RATE, imu_rate=RATE, fix_rate=0.0, seed=1), robot
    )
    plain = min(plain_microseconds(3000) for _ in range(arguments.repeat))
    print(f"{'filterpy, plain EKF':20s} {plain:6.0f} µs")
    for variant in VARIANTS:
        ours = min(filter_microseconds(log, robot, variant) for _ in range(arguments.repeat))
        print(f"{variant:20s} {ours:6.0f} µs, {ours / plain:.2f} of the plain EKF", flush=True)
    bare = min(
        filter_microseconds(log, robot, variant, Settings(history=0.0))
        for _ in range(arguments.repeat)
    )
    print(f"{variant}, no history: {bare:.0f} µs, {bare / ours:.2f} of that with it")


if __name__ == "__main__":
    main()
