"""Start of the map by positions alone: how long it takes, and whether its own sigma is true.

    python benchmarks/map_start.py [--runs N]

Everyday driving of auriga-alpha on the friction model in a map that is turned and shifted at random,
with a position each second. NEES is the squared error of the pose in the map by its own covariance, 3 if
it is true: at the start of the map, and after 90 s.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import compose, wrap_angle
from icreckon.estimator.log.measurements import PositionFix
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.live.map_frame import MapFrame
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

SECOND = 1_000_000_000
SIGMAS = (0.05, 0.5, 2.0)
"""Standard deviations of the positions [m]."""


class Found(NamedTuple):
    """Start of a map.

    Attributes:
        after: time from the start of the drive [s], NaN if the map never starts.
        yaw: error of the yaw at the start [rad].
        yaw_sigma: its own standard deviation [rad].
        nees: NEES at the start.
        last_nees: NEES after the last position.
    """

    after: float
    yaw: float
    yaw_sigma: float
    nees: float
    last_nees: float


def start_of_map(sigma: float, seed: int) -> Found:
    """Drive with positions of a standard deviation [m]."""
    robot, rng = load_robot("auriga-alpha"), np.random.default_rng(seed)
    scenario = Scenario(duration=90.0, seed=seed, trajectory="random", fix_rate=0.0)
    log = simulate(scenario, robot)
    if log.truth is None:
        raise ValueError("a simulated log has a truth")
    place = np.array([*(3.0 * rng.standard_normal(2)), rng.uniform(-np.pi, np.pi)])
    odom, in_map = PoseEstimator(robot, "constant-online"), MapFrame()
    due, found = log.start + SECOND, Found(*[float("nan")] * 5)
    for measurement in log.measurements():
        odom.feed(measurement)
        if in_map.estimator is not None:
            in_map.take([measurement], odom, in_odom=False)
        if measurement.stamp < due:
            continue
        due += SECOND
        true = compose(place, interpolate_poses(log.truth.poses, np.array([measurement.stamp]))[0])
        x, y = true[:2] + sigma * rng.standard_normal(2)
        fix = PositionFix(measurement.stamp, float(x), float(y), sigma * sigma)
        in_map.take([fix], odom, in_odom=False)
        if in_map.estimator is None:
            continue
        off, covariance = in_map.estimator.pose - true, in_map.estimator.pose_covariance
        off[2] = wrap_angle(off[2])
        nees = float(off @ np.linalg.solve(covariance, off))
        if found.after != found.after:
            after = (measurement.stamp - log.start) / SECOND
            own = float(np.sqrt(covariance[2, 2]))
            found = Found(after, float(off[2]), own, nees, nees)
        found = found._replace(last_nees=nees)
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=12)
    given = parser.parse_args()
    print(
        "positions [m] | starts | after [s] | yaw, RMS [rad] | own sigma [rad] | NEES at the start | "
        "NEES at the end"
    )
    for sigma in SIGMAS:
        found: Floats = np.array([start_of_map(sigma, seed) for seed in range(given.runs)])
        known = found[np.isfinite(found[:, 0])]
        after, yaw, own, first, last = known.T
        print(
            f"{sigma:g} | {len(known)} of {len(found)} | {after.min():.0f} to {after.max():.0f} | "
            f"{np.sqrt(np.mean(yaw**2)):.2f} | {own.mean():.2f} | {first.mean():.2f} | {last.mean():.2f}"
        )


if __name__ == "__main__":
    main()
