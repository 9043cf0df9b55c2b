"""Tracks that spin free: error, own uncertainty, and how soon it is noticed; false alarms on real logs.

    python benchmarks/spinning_track.py [LOGS] [--runs N]

Everyday driving of auriga-alpha on the friction model, without fixes. After 30 s the left track reads
0.8 m/s more than it drives the ground, for 3 s. The error is that of the motion from the start of the
fault to 1 s after its end, root mean square over the runs, beside the filter's own standard deviation of
the same motion (`relative_motion`), and with the same drive without the fault. `delay` is the longest
time from the start of the fault until `health.slip` names the track.

In the second table both tracks spin, as at a wall: both read more than they drive the ground. `found` is
the share of drives in which `health.slip.forward` shows it; error and sigma are those of all drives.

On the demo's rolling ground the tall robot stands on its lower track alone at times, and the upper one
slides. The third table has the error of v_x while a track is found spinning, of the mean of the track
speeds and of `gyro`, root mean square. LOGS is the folder of the sample logs: each time that a track is
found spinning in them is counted, and each slide. Whether the Jackal's tracks really spin, which has no
truth, its accelerometer tells: while they are found spinning, the force to the left follows the speed
times the turning by the gyro, or by the tracks. Printed are the shares of both, with 95 % intervals by
resampling blocks of a second.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _logs import logs_without
from _motion import Motion, motion_between
from _study import table
from scipy.ndimage import gaussian_filter1d

from icreckon.cli.demo import DURATION, demo_scenario
from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
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
BOTH_SPIN = ((0.5, 3), (0.8, 3), (1.0, 3), (1.0, 10), (1.5, 3))
"""Speed of both free tracks beyond the ground's [m/s], and how long they spin [s]."""
RAMP = 0.2
"""Time in which both tracks speed up [s]."""
VARIANTS = ("gyro", "differential", "constant-online", "inertia-online", "friction-online")


class Sliding(NamedTuple):
    """Upper tracks that slide: number of times in a drive [s], and errors of v_x meanwhile [m/s]."""

    times: int
    duration: float
    of_tracks: list[float]
    of_filter: list[float]


def drive(robot: Robot, seed: int, duration: float = 36.0) -> Log:
    """A drive without the fault."""
    return simulate(
        Scenario(duration=duration, seed=seed, trajectory="random", fix_rate=0.0), robot
    )


def with_free_track(
    log: Log, excess: float = EXCESS, *, lasts: int = LASTS, both: bool = False
) -> Log:
    """The log whose left track spins at once, or both, which speed up and slow down in `RAMP`."""
    stamps, speeds = log.tracks.stamps, log.tracks.speeds.copy()
    times, end = (stamps - log.start - BEGINS) / SECOND, lasts / SECOND
    if both:
        share = np.interp(times, [0.0, RAMP, end, end + RAMP], [0.0, 1.0, 1.0, 0.0])
        speeds += excess * share[:, None]
    else:
        speeds[(times >= 0.0) & (times < end), 0] += excess
    return replace(log, tracks=TrackSpeedSeries(stamps, speeds))


def motion_over_fault(log: Log, robot: Robot, variant: str, lasts: int = LASTS) -> Motion:
    """Run a variant up to a second after the fault; shown is a spinning track, or a slide."""
    begin = log.start + BEGINS

    def shown(health: Health) -> bool:
        return health.slip.track is not None or health.slip.forward is not None

    return motion_between(log, PoseEstimator(robot, variant), begin, begin + lasts + AFTER, shown)


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


def both_row(drives: list[Log], robot: Robot, excess: float, seconds: int) -> list[str]:
    """Row of the table of both tracks."""
    lasts = seconds * SECOND
    moved = []
    for log in drives:
        faulty = with_free_track(log, excess, lasts=lasts, both=True)
        moved.append(motion_over_fault(faulty, robot, "inertia-online", lasts))
    seen = [one.delay for one in moved if one.delay == one.delay and one.delay < seconds]
    return [
        f"{excess} m/s, {seconds} s",
        f"{len(seen)} of {len(moved)}",
        f"{max(seen):.2f}" if seen else "",
        f"{rms([one.error for one in moved]):.2f}",
        f"{rms([one.sigma for one in moved]):.2f}",
    ]


def one_row(drives: list[Log], robot: Robot, variant: str) -> list[str]:
    """Row of the table of the left track."""
    plain = [motion_over_fault(log, robot, variant) for log in drives]
    faulty = [motion_over_fault(with_free_track(log), robot, variant) for log in drives]
    delays = [one.delay for one in faulty]
    return [
        f"`{variant}`",
        f"{rms([one.error for one in plain]):.2f}",
        f"{rms([one.error for one in faulty]):.2f}",
        f"{max(one.error for one in faulty):.2f}",
        f"{rms([one.sigma for one in faulty]):.2f}",
        f"{np.nanmax(delays):.2f}" if np.isfinite(delays).all() else "not always",
    ]


def rms(values: list[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def shares_of_force(log: Log, robot: Robot) -> tuple[float, Floats]:
    """Share of the time with a spinning track, and of the turning by gyro and tracks in the force.

    Returns:
        The share of the time; (3, 2) shares by gyro and tracks, and the limits of their intervals.
    """
    estimator, spins = PoseEstimator(robot, "gyro"), []
    events = [(stamp, k, False) for k, stamp in enumerate(log.tracks.stamps.tolist())]
    events += [(stamp, k, True) for k, stamp in enumerate(log.imu.stamps.tolist())]
    for stamp, k, is_imu in sorted(events):
        if is_imu:
            rate, force = log.imu.angular_velocity[k], log.imu.linear_acceleration[k]
            estimator.feed(ImuSample(stamp, tuple(rate.tolist()), tuple(force.tolist())))
            spins.append(estimator.health.slip.track is not None)
        else:
            estimator.feed(TrackSpeeds(stamp, *log.tracks.speeds[k].tolist()))
    stamps, flagged = log.imu.stamps, np.array(spins)
    left, right = (np.interp(stamps, log.tracks.stamps, side) for side in log.tracks.speeds.T)
    rate, mean = log.imu.angular_velocity[:, 2], 0.5 * (left + right)
    bends = ~flagged & (np.abs(rate) > 0.1)
    width = np.median((right - left)[bends] / rate[bends])
    dt = np.median(np.diff(stamps)) / SECOND
    force, by_gyro, by_tracks = (
        gaussian_filter1d(one, 0.15 / dt) - gaussian_filter1d(one, 1.5 / dt)
        for one in (log.imu.linear_acceleration[:, 1], mean * rate, mean * (right - left) / width)
    )
    turning = np.stack([by_gyro, by_tracks], axis=1)

    def shares(at: Stamps) -> Floats:
        return np.asarray(np.linalg.lstsq(turning[at], force[at], rcond=None)[0])

    found = np.flatnonzero(flagged)
    blocks = np.array_split(found, max(5, round(len(found) * dt)))
    rng, resampled = np.random.default_rng(0), []
    for _ in range(500):
        picked = rng.integers(0, len(blocks), len(blocks))
        resampled.append(shares(np.concatenate([blocks[k] for k in picked])))
    limits = np.quantile(resampled, [0.025, 0.975], axis=0)
    return float(flagged.mean()), np.vstack([shares(found), limits])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=8)
    given = parser.parse_args()
    robot = load_robot("auriga-alpha")
    drives = [drive(robot, seed) for seed in range(given.runs)]
    head = ("variant", "without the fault, m", "with it, m", "worst, m", "own sigma, m", "delay, s")
    table(head, (one_row(drives, robot, variant) for variant in VARIANTS))
    print()
    drives = [drive(robot, seed, 43.0) for seed in range(given.runs)]
    head = ("both read too much", "found", "after, s", "error, m", "own sigma, m")
    table(head, (both_row(drives, robot, *case) for case in BOTH_SPIN))
    print()
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
    hours, found, slides = 0.0, 0, 0
    for name, robot_name in logs_without("jackal", "wetexplorer").items():
        of_log = load_robot(robot_name)
        log = read_log(given.logs / name, of_log)
        slip = run_side_by_side(log, of_log, ["gyro"])["gyro"].health.slip
        print(f"{name}: {slip.times} times in {log.duration:.0f} s, {slip.slides} slides")
        hours += log.duration / 3600.0
        found, slides = found + slip.times, slides + slip.slides
    print(f"real logs: {found} times in {hours:.2f} h, {slides} slides")
    jackal = load_robot("jackal")
    share, of_force = shares_of_force(read_log(given.logs / "jackal_test2.bag", jackal), jackal)
    by_gyro, by_tracks = (
        f"{one[0]:.2f} [{one[1]:.2f}, {one[2]:.2f}]" for one in of_force.T.tolist()
    )
    print(
        f"jackal_test2.bag: a track spins {share:.0%} of the time; meanwhile the force to the left has "
        f"{by_gyro} of the turning by the gyro, {by_tracks} of that by the tracks"
    )


if __name__ == "__main__":
    main()
