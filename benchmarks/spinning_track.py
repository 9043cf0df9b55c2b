"""A track that spins free: error, own uncertainty, and how soon it is noticed; false alarms on real logs.

    python benchmarks/spinning_track.py [LOGS] [--runs N]

Everyday driving of auriga-alpha on the friction model, without fixes. After 30 s the left track reads
0.8 m/s more than it drives the ground, for 3 s. The error is that of the motion from the start of the
fault to 1 s after its end, root mean square over the runs, beside the filter's own standard deviation of
the same motion (`relative_motion`), and with the same drive without the fault. `delay` is the longest
time from the start of the fault until `health.slip` names the track.

On the demo's rolling ground the tall robot stands on its lower track alone at times, and the upper one
slides. The second table has the error of v_x while a track is found spinning, of the mean of the track
speeds and of `gyro`, root mean square. LOGS is the folder of the sample logs: each time that a track is
found spinning in them is counted.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _logs import logs_without

from icreckon.cli.demo import DURATION, demo_scenario
from icreckon.estimator.base.frames import relative
from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

SECOND = 1_000_000_000
BEGINS, LASTS, AFTER = 30 * SECOND, 3 * SECOND, SECOND
EXCESS = 0.8
"""Speed of the free track beyond the ground's [m/s]."""
VARIANTS = ("gyro", "differential", "constant-online", "inertia-online", "friction-online")


class Sliding(NamedTuple):
    """Upper tracks that slide: number of times in a drive [s], and errors of v_x meanwhile [m/s]."""

    times: int
    duration: float
    of_tracks: list[float]
    of_filter: list[float]


class Motion(NamedTuple):
    """Error of the motion over the fault and its own standard deviation [m]; delay [s] or NaN."""

    error: float
    sigma: float
    delay: float


def drive(robot: Robot, seed: int) -> Log:
    """A drive without the fault."""
    return simulate(Scenario(duration=36.0, seed=seed, trajectory="random", fix_rate=0.0), robot)


def with_free_track(log: Log, excess: float = EXCESS) -> Log:
    """The log whose left track spins."""
    stamps, speeds = log.tracks.stamps, log.tracks.speeds.copy()
    free = (stamps >= log.start + BEGINS) & (stamps < log.start + BEGINS + LASTS)
    speeds[free, 0] += excess
    return replace(log, tracks=TrackSpeedSeries(stamps, speeds))


def motion_over_fault(log: Log, robot: Robot, variant: str) -> Motion:
    """Run a variant up to a second after the fault."""
    estimator, delay = PoseEstimator(robot, variant), float("nan")
    begin, end = log.start + BEGINS, log.start + BEGINS + LASTS + AFTER
    for measurement in log.measurements():
        if measurement.stamp > end:
            break
        estimator.feed(measurement)
        if estimator.stamp == begin and begin not in estimator.marks:
            estimator.mark(begin)
        if measurement.stamp > begin and delay != delay and estimator.health.slip.track:
            delay = (measurement.stamp - begin) / SECOND
    found = estimator.relative_motion(begin)
    if log.truth is None:
        raise ValueError("a simulated log has a truth")
    true = interpolate_poses(log.truth.poses, np.array([begin, end]))
    error = (found.pose - relative(true[0], true[1]))[:2]
    return Motion(
        float(np.hypot(*error)), float(np.sqrt(np.trace(found.covariance[:2, :2]))), delay
    )


def rolling_ground(robot: Robot, index: int) -> Sliding:
    """A drive over the demo's ground."""
    log = simulate(demo_scenario(1, DURATION, "random"), robot, run_index=index)
    if log.truth is None:
        raise ValueError("a simulated log has a truth")
    twists, estimator, mean = log.truth.twists, PoseEstimator(robot, "gyro"), 0.0
    of_tracks, of_filter = [], []
    for measurement in log.measurements():
        estimator.feed(measurement)
        if isinstance(measurement, TrackSpeeds):
            mean = 0.5 * (measurement.left + measurement.right)
        elif isinstance(measurement, ImuSample) and estimator.health.slip.track is not None:
            true = float(np.interp(measurement.stamp, twists.stamps, twists.twists[:, 0]))
            of_tracks.append(mean - true)
            of_filter.append(float(estimator.twist[0]) - true)
    return Sliding(estimator.health.slip.times, log.duration, of_tracks, of_filter)


def rms(values: list[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=8)
    given = parser.parse_args()
    robot = load_robot("auriga-alpha")
    drives = [drive(robot, seed) for seed in range(given.runs)]
    print(
        "variant | without the fault: error [m] | error [m] | worst [m] | own sigma [m] | delay [s]"
    )
    for variant in VARIANTS:
        plain = [motion_over_fault(log, robot, variant) for log in drives]
        faulty = [motion_over_fault(with_free_track(log), robot, variant) for log in drives]

        delays = [one.delay for one in faulty]
        noticed = f"{np.nanmax(delays):.2f}" if np.isfinite(delays).all() else "not always"
        print(
            f"{variant} | {rms([one.error for one in plain]):.2f} | "
            f"{rms([one.error for one in faulty]):.2f} | {max(one.error for one in faulty):.2f} | "
            f"{rms([one.sigma for one in faulty]):.2f} | {noticed}"
        )
    slid = [rolling_ground(robot, index) for index in range(given.runs)]
    minutes = sum(one.duration for one in slid) / 60.0
    of_tracks = [error for one in slid for error in one.of_tracks]
    of_filter = [error for one in slid for error in one.of_filter]
    print(
        f"rolling ground: {sum(one.times for one in slid)} times in {minutes:.0f} min; v_x meanwhile: "
        f"tracks {rms(of_tracks):.2f} m/s, gyro {rms(of_filter):.2f} m/s off"
    )
    if given.logs is None:
        return
    hours = found = 0.0
    for name, robot_name in logs_without("jackal", "wetexplorer").items():
        of_log = load_robot(robot_name)
        log = read_log(given.logs / name, of_log)
        times = run_side_by_side(log, of_log, ["gyro"])["gyro"].health.slip.times
        print(f"{name}: {times} times in {log.duration:.0f} s")
        hours, found = hours + log.duration / 3600.0, found + times
    print(f"real logs: {found:.0f} times in {hours:.2f} h")


if __name__ == "__main__":
    main()
