"""Time of one step of the streaming filter, beside filterpy's plain EKF of the same size.

A step is a track-speed sample and an IMU sample (gyro and accelerometer), fed from a simulated drive, one
by one or as arrays. Of arrays the newest second (`Settings.history`) is fed one by one, so their time
depends on the length of the drive, which is ten minutes.

The plain EKF does the same algebra (a prediction and two scalar updates with as many states) without any
motion model, gate or bookkeeping. It and both engines of the filter are timed in turn, and the best of
several runs counts, in processor time: what else the machine does makes a run longer, never shorter. With
--cold, it also tells how long the compiled engine takes when it is used for the first time, and in a
later process.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

import msgspec
import numpy as np
from _study import script_parser
from filterpy.kalman import ExtendedKalmanFilter

from icreckon.estimator.base import state as s
from icreckon.estimator.batch.feed_arrays import feed_arrays
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

RATE, DURATION, OF_ARRAYS = 50.0, 60.0, 600.0
ENGINES = ("plain", "compiled")
# Makes an estimator and feeds it one sample of each kind: prints the time that this takes [s].
FIRST_STEPS = """
import time
import icreckon
robot = icreckon.load_robot("auriga-alpha")
icreckon.PoseEstimator(robot, settings=icreckon.Settings(engine="plain"))
begin = time.perf_counter()
estimator = icreckon.PoseEstimator(robot)
for stamp in (0, 20_000_000, 40_000_000):
    estimator.feed(icreckon.TrackSpeeds(stamp, 0.1, 0.3))
    estimator.feed(icreckon.ImuSample(stamp, (0.0, 0.0, 0.1), (0.0, 0.0, 9.81)))
    estimator.feed(icreckon.PositionFix(stamp, 0.0, 0.0, 0.01))
estimator.twist
print(time.perf_counter() - begin)
"""


def filter_microseconds(
    log: Log, robot: Robot, variant: str, settings: Settings | None = None
) -> float:
    """Mean time of a step [µs] over a log whose track speeds and IMU are in step."""
    estimator = PoseEstimator(robot, variant, settings=settings)
    measurements = list(log.measurements())
    begin = time.process_time()
    for measurement in measurements:
        estimator.feed(measurement)
    return 1e6 * (time.process_time() - begin) / (len(measurements) / 2)


def array_microseconds(log: Log, robot: Robot, variant: str) -> float:
    """Mean time of a step [µs] if the samples are fed as arrays, a second of them one by one."""
    if log.imu is None:
        raise ValueError("the log has no IMU")
    estimator = PoseEstimator(robot, variant)
    begin = time.process_time()
    feed_arrays(estimator, log.tracks, log.imu)
    return 1e6 * (time.process_time() - begin) / len(log.imu.stamps)


def plain_microseconds(steps: int) -> float:
    """The same of filterpy's EKF, which predicts and updates twice."""
    ekf = ExtendedKalmanFilter(dim_x=s.SIZE, dim_z=1)
    ekf.x = np.zeros(s.SIZE)
    row = np.zeros((1, s.SIZE))
    row[0, :3] = 1.0
    zero = np.zeros(1)
    begin = time.process_time()
    for _ in range(steps):
        ekf.predict()
        for _ in range(2):
            ekf.update(zero, lambda _: row, lambda x: row @ x)
    return 1e6 * (time.process_time() - begin) / steps


def first_seconds(cache: str) -> float:
    """Time that the compiled engine takes in a new process, with what is kept in a folder [s]."""
    done = subprocess.run(
        [sys.executable, "-c", FIRST_STEPS],
        env={**os.environ, "NUMBA_CACHE_DIR": cache},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout)


def main() -> None:
    """Print the table."""
    parser = script_parser(__doc__)
    parser.add_argument("--repeat", type=int, default=5, help="best of so many runs")
    parser.add_argument("--cold", action="store_true", help="also the time of the first use")
    arguments = parser.parse_args()
    robot = load_robot("auriga-alpha")
    scenario = Scenario(duration=DURATION, track_rate=RATE, imu_rate=RATE, fix_rate=0.0, seed=1)
    log = simulate(scenario, robot)
    long_log = simulate(msgspec.structs.replace(scenario, duration=OF_ARRAYS), robot)
    short_log = log.between(log.start, log.start + 10**9)
    settings = {engine: Settings(engine=engine) for engine in ENGINES}
    bare = {engine: Settings(engine=engine, history=0.0) for engine in ENGINES}
    rows = [(variant, variant, settings) for variant in VARIANTS]
    rows.append(("inertia-online, no history", "inertia-online", bare))
    columns_of = ("plain, x filterpy", "compiled", "arrays")
    print(f"{'':29s} {'filterpy':>9s}  " + "  ".join(f"{name:>17s}" for name in columns_of))
    for name, variant, of_engine in rows:
        plain, best = np.inf, dict.fromkeys((*ENGINES, "arrays"), np.inf)
        for _ in range(arguments.repeat):
            plain = min(plain, plain_microseconds(3000))
            for engine, of_log in zip(ENGINES, (short_log, log), strict=True):
                ours = filter_microseconds(of_log, robot, variant, of_engine[engine])
                best[engine] = min(best[engine], ours)
            best["arrays"] = min(best["arrays"], array_microseconds(long_log, robot, variant))
        columns = (f"{one:6.1f} µs, x {one / plain:4.2f}" for one in best.values())
        print(f"{name:29s} {plain:6.1f} µs  " + "  ".join(columns), flush=True)
    if arguments.cold:
        with tempfile.TemporaryDirectory() as cache:
            cold, warm = first_seconds(cache), first_seconds(cache)
        print(f"first use of the compiled engine {cold:.1f} s, in a later process {warm:.1f} s")


if __name__ == "__main__":
    main()
