"""Time of one step of the filter, streaming and in C, next to filterpy's plain EKF of the same size.

A step is a track-speed sample and an IMU sample (gyro and accelerometer), fed from a simulated drive, one
by one or as arrays. Of arrays the newest second (`Settings.history`) is fed one by one, so their time
depends on the length of the drive, which is ten minutes.

The plain EKF does the same algebra (a prediction and two scalar updates with as many states) without any
motion model, gate or bookkeeping. "C" is what `icreckon export` writes, in double precision, built with
$CC and $CFLAGS (gcc -O2); without a compiler it is left out. All are timed in turn, and the
best of several runs counts, in processor time: what else the machine does makes a run longer, never
shorter. With --cold, it also prints how long the compiled engine takes when it is used for the first
time, and in a later process.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec
import numpy as np
from _study import script_parser
from filterpy.kalman import ExtendedKalmanFilter

from icreckon.estimator.base import state as s
from icreckon.estimator.batch.feed_arrays import feed_arrays
from icreckon.estimator.embedded.c_filter import filter_in_c
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import VARIANTS, find_variant
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
# Feeds lines of standard input (stamp, track speeds, angular velocity, specific force); prints the time
# of a line [µs].
FEEDER = """
#include <stdio.h>
#include <time.h>
#include "icreckon_filter.h"
static icr_filter filter;
static long long stamps[100000];
static double rows[100000][8];
int main(void) {
    int n = 0, got = 9;
    while (n < 100000 && got == 9) {
        double *r = rows[n];
        got = scanf("%lld%lf%lf%lf%lf", &stamps[n], r, r + 1, r + 2, r + 3);
        got += scanf("%lf%lf%lf%lf", r + 4, r + 5, r + 6, r + 7);
        n += got == 9;
    }
    icr_init(&filter);
    clock_t begin = clock();
    for (int k = 0; k < n; k++) {
        icr_tracks(&filter, stamps[k], rows[k][0], rows[k][1]);
        icr_imu(&filter, stamps[k], rows[k] + 2, rows[k] + 5);
    }
    printf("%g", 1e6 * (double)(clock() - begin) / CLOCKS_PER_SEC / n);
}
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


def feeder(robot: Robot, variant: str, folder: Path) -> list[str] | None:
    """Command that times the filter in C, compiled in a folder; None without a compiler."""
    compiler = shutil.which(os.environ.get("CC", "gcc"))
    if compiler is None:
        return None
    filter_in_c(robot, find_variant(variant), bits=64, imu_rate=RATE).write(folder)
    (folder / "feeder.c").write_text(FEEDER, encoding="utf-8")
    flags = os.environ.get("CFLAGS", "-O2").split()
    made = ["-o", variant, "feeder.c", "icreckon_filter.c", "-lm"]
    subprocess.run([compiler, *flags, *made], cwd=folder, check=True)
    return [str(folder / variant)]


def c_microseconds(log: Log, command: list[str]) -> float:
    """Mean time of a step of the filter in C [µs]."""
    imu = log.imu
    if imu is None or imu.linear_acceleration is None:
        raise ValueError("the log has no IMU")
    rows = np.column_stack([log.tracks.speeds, imu.angular_velocity, imu.linear_acceleration])
    lines = zip(imu.stamps.tolist(), rows.tolist(), strict=True)
    text = "\n".join(" ".join(map(str, [stamp, *row])) for stamp, row in lines)
    return float(
        subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout
    )


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
    columns_of = ("plain, x filterpy", "compiled", "arrays", "C")
    folder = tempfile.TemporaryDirectory()
    in_c = {variant: feeder(robot, variant, Path(folder.name)) for variant in VARIANTS}
    print(f"{'':29s} {'filterpy':>9s}  " + "  ".join(f"{name:>17s}" for name in columns_of))
    for name, variant, of_engine in rows:
        plain, best = np.inf, dict.fromkeys((*ENGINES, "arrays", "C"), np.inf)
        for _ in range(arguments.repeat):
            plain = min(plain, plain_microseconds(3000))
            for engine, of_log in zip(ENGINES, (short_log, log), strict=True):
                ours = filter_microseconds(of_log, robot, variant, of_engine[engine])
                best[engine] = min(best[engine], ours)
            best["arrays"] = min(best["arrays"], array_microseconds(long_log, robot, variant))
            if (command := in_c[variant]) is not None:
                best["C"] = min(best["C"], c_microseconds(long_log, command))
        columns = (f"{one:6.1f} µs, x {one / plain:4.2f}" for one in best.values())
        print(f"{name:29s} {plain:6.1f} µs  " + "  ".join(columns), flush=True)
    if arguments.cold:
        with tempfile.TemporaryDirectory() as cache:
            cold, warm = first_seconds(cache), first_seconds(cache)
        print(f"first use of the compiled engine {cold:.1f} s, in a later process {warm:.1f} s")


if __name__ == "__main__":
    main()
