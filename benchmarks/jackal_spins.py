"""Do the Jackal's tracks spin where the filter says so? Its log has no truth; its accelerometer tells.

    python benchmarks/jackal_spins.py LOGS

The force to the left follows the speed times the true turning. Printed are the share of the time for
which a track of `jackal_test2.bag` is found spinning, and meanwhile the shares of the turning by gyro and
by tracks in that force, with 95 % intervals by resampling blocks of a second. For the other real logs:
how often a track is found spinning, or the robot sliding. LOGS is the folder of the sample logs.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from _logs import logs_without
from _study import script_parser
from scipy.ndimage import gaussian_filter1d

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run
from icreckon.replay.reading.read_log import read_log

SECOND = 1_000_000_000


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
            spins.append(estimator.health.finding("spinning") is not None)
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
    """Print what is found."""
    parser = script_parser(__doc__)
    parser.add_argument("logs", type=Path)
    given = parser.parse_args()
    hours, found, slides = 0.0, 0, 0
    for name, robot_name in logs_without("jackal", "wetexplorer").items():
        robot = load_robot(robot_name)
        log = read_log(given.logs / name, robot)
        times = run(log, robot, "gyro").health.times
        spins, of_log = times.get("spinning", 0), times.get("sliding", 0)
        print(f"{name}: {spins} times in {log.duration:.0f} s, {of_log} slides")
        hours += log.duration / 3600.0
        found, slides = found + spins, slides + of_log
    print(f"these logs: {found} times in {hours:.2f} h, {slides} slides")
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
