"""Latency of the track speeds, estimated while driving: after how much turning it is how sure.

    python benchmarks/track_latency.py LOGS

LOGS is the folder of the sample logs. For each log: latency and standard error after 5, 10, 20 and 40 rad
of turning (by the gyro) and at its end, with the time since its start, beside what `icreckon inspect`
finds in the whole log; then the cost of the watch. Stamps are raw: the robot file's latency is left out.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import msgspec
import numpy as np
from _logs import logs_without

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.lag import NoLag
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.sensors.track_latency import BLOCK, TrackLatency, TrackLatencyEstimator
from icreckon.replay.inspection.latency import track_latency
from icreckon.replay.reading.read_log import read_log

TURNED = (5.0, 10.0, 20.0, 40.0)
"""Turning at which the estimate is shown [rad]."""
PART = 5_000_000_000
"""Length of the parts of a log that the watch takes at once [ns]."""


def with_raw_stamps(name: str) -> Robot:
    """A robot whose log's stamps are read as they are."""
    robot = load_robot(name)
    tracks = {**robot.log["tracks"], "latency": 0.0}
    return msgspec.structs.replace(robot, log={**robot.log, "tracks": tracks})


def shown(found: TrackLatency | None) -> str:
    """The estimate as text."""
    return "-" if found is None else f"{found.seconds:.3f} +- {found.sigma:.3f}"


def watch(log: Log, models: SensorModels) -> tuple[list[str], str, float]:
    """Estimates after `TURNED`, that at the end, and seconds of processor time."""
    estimator, blocks, cells = TrackLatencyEstimator(), 0, []
    begun = time.process_time()
    tracks, imu = log.tracks, log.imu
    rates = models.yaw_rates(imu.angular_velocity)
    for begin in range(log.start, log.start + round(log.duration / NANOSECOND) + 1, PART):
        of_tracks, of_imu = (
            (begin <= one.stamps) & (one.stamps < begin + PART) for one in (tracks, imu)
        )
        turning = np.diff(tracks.speeds[of_tracks])[:, 0]
        estimator.take(tracks.stamps[of_tracks], turning, imu.stamps[of_imu], rates[of_imu])
        passed = sum(blocks < turned / BLOCK <= estimator.completed for turned in TURNED)
        blocks, seconds = estimator.completed, (begin + PART - log.start) * NANOSECOND
        cells += [f"{shown(estimator.estimate())} ({seconds:.0f} s)"] * passed
    spent = time.process_time() - begun
    cells += ["-"] * (len(TURNED) - len(cells))
    return cells, shown(estimator.estimate()), spent


def main() -> None:
    """Print the table."""
    folder = Path(sys.argv[1])
    heads = [f"{turned:g} rad" for turned in TURNED]
    print(" | ".join(["log", "whole log [s]", *heads, "end"]))
    spent = duration = 0.0
    for name, robot_name in logs_without("wetexplorer").items():
        if not (folder / name).exists():
            print(f"{name}: not there", file=sys.stderr)
            continue
        robot = with_raw_stamps(robot_name)
        log, models = read_log(folder / name, robot), SensorModels(robot)
        if log.imu is None:
            continue
        whole = track_latency(log.tracks, log.imu, models.yaw_rates(log.imu.angular_velocity))
        cells, end, seconds = watch(log, models)
        spent, duration = spent + seconds, duration + log.duration
        of_whole = (
            "-" if isinstance(whole, NoLag) else shown(TrackLatency(whole.seconds, whole.sigma))
        )
        print(" | ".join([name.removesuffix(".bag"), of_whole, *cells, end]))
    print(f"cost: {1e3 * spent / duration:.2f} ms of processor time for each second of a log")


if __name__ == "__main__":
    main()
