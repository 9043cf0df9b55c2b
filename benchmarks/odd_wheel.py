"""A wheel that spins or is blocked, on robots with a motor and a sensor at each wheel.

    python benchmarks/odd_wheel.py [LOGS] [--runs N]

Everyday driving of auriga-alpha on the friction model, without fixes, with the speed of each side read
at two or three wheels: each has an error of its own of 3 % of the speed, and the rear one lags by 20 ms.
After 30 s, or after 2 s, when no bend has shown yet how the robot turns, the foremost left wheel reads
0.8 m/s more than it drives the ground for 3 s, or stands still. The error is that of the motion from the
start of the fault to 1 s after its end, root mean square over the runs, beside the filter's own standard
deviation of it; `means` has the means of the sides alone. `within 3 sigma` counts runs.

LOGS is the folder of the sample logs. None of them has more than one joint a side; so each side is read
at two and at three wheels as above, and the times that they are found to disagree are counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from _logs import WITH_TRUTH
from _motion import Motion, motion_between
from _study import table

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

SECOND = 1_000_000_000
LASTS, AFTER, LATER, SOON = 3.0, 1.0, 30.0, 2.0
EXCESS, OWN_ERROR, LAG = 0.8, 0.03, 0.02
"""Speed of a free wheel beyond the ground's [m/s], error of each wheel [-], lag of the rear one [s]."""
VARIANTS = ("gyro", "constant-online", "inertia-online", "friction-online")


def with_wheels(log: Log, count: int, seed: int = 0) -> Log:
    """The log with so many wheels at each side."""
    rng, stamps = np.random.default_rng(seed), log.tracks.stamps
    times = (stamps - stamps[0]) / SECOND
    sides: list[Floats] = []
    for speeds in log.tracks.speeds.T:
        wheels = [
            np.interp(times - LAG * k / (count - 1), times, speeds)
            * (1.0 + OWN_ERROR * rng.standard_normal(len(times)))
            for k in range(count)
        ]
        sides.append(np.column_stack(wheels))
    return _of_wheels(log, sides)


def _of_wheels(log: Log, sides: Sequence[Floats]) -> Log:
    means = np.column_stack([side.mean(axis=1) for side in sides])
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, means, *sides))


def with_odd_wheel(log: Log, begins: float, *, blocked: bool = False) -> Log:
    """The log whose foremost left wheel spins, or is blocked."""
    left, right = log.tracks.left_wheels, log.tracks.right_wheels
    if left is None or right is None:
        raise ValueError("the log has no wheels")
    times, left = (log.tracks.stamps - log.start) / SECOND, left.copy()
    odd = (times >= begins) & (times < begins + LASTS)
    left[odd, 0] = 0.0 if blocked else left[odd, 0] + EXCESS
    return _of_wheels(log, (left, right))


def without_wheels(log: Log) -> Log:
    """The log with the means of the sides alone."""
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, log.tracks.speeds))


def drive(robot: Robot, seed: int, count: int, duration: float = LATER + 6.0) -> Log:
    """A drive with so many wheels at each side."""
    scenario = Scenario(duration=duration, seed=seed, trajectory="random", fix_rate=0.0)
    return with_wheels(simulate(scenario, robot), count, seed)


def motion_over_fault(log: Log, robot: Robot, variant: str, begins: float) -> Motion:
    """Run a variant up to a second after the fault; shown are odd wheels on the left."""
    begin = log.start + round(begins * SECOND)
    end = begin + round((LASTS + AFTER) * SECOND)
    estimator = PoseEstimator(robot, variant)
    return motion_between(
        log, estimator, begin, end, lambda health: health.slip.left_wheels is not None
    )


def false_alarms(log: Log, robot: Robot) -> int:
    """Times that wheels of a log without a fault are found to disagree."""
    estimator = PoseEstimator(robot, "gyro")
    for measurement in log.measurements():
        estimator.feed(measurement)
    return estimator.health.slip.odd_wheels


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def case_rows(
    robot: Robot, count: int, begins: float, blocked: bool, runs: int
) -> Iterator[list[str]]:
    """Rows of a number of wheels and a fault."""
    drives = [drive(robot, seed, count, begins + 6.0) for seed in range(runs)]
    faulty = [with_odd_wheel(log, begins, blocked=blocked) for log in drives]
    for variant in VARIANTS:
        plain = [motion_over_fault(log, robot, variant, begins).error for log in drives]
        found = [motion_over_fault(log, robot, variant, begins) for log in faulty]
        means = [
            motion_over_fault(without_wheels(log), robot, variant, begins).error for log in faulty
        ]
        yield [
            f"{count}, {'blocked' if blocked else 'spins'} after {begins:g} s",
            f"`{variant}`",
            f"{_rms(plain):.2f}",
            f"{_rms(means):.2f}",
            f"{_rms([one.error for one in found]):.2f}",
            f"{max(one.error for one in found):.2f}",
            f"{_rms([one.sigma for one in found]):.2f}",
            f"{sum(one.error < 3.0 * one.sigma for one in found)} of {len(found)}",
            f"{max(one.delay for one in found):.2f}",
        ]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=8)
    given = parser.parse_args()
    robot = load_robot("auriga-alpha")
    head = ("wheels a side, fault", "variant", "without the fault, m", "means, m", "wheels, m")
    head = (*head, "worst, m", "own sigma, m", "within 3 sigma", "named after, s")
    cases = [(2, LATER, False), (3, LATER, False), (2, LATER, True), (2, SOON, False)]
    table(head, (row for case in cases for row in case_rows(robot, *case, given.runs)))
    if given.logs is None:
        return
    for name, robot_name in WITH_TRUTH.items():
        of_log = load_robot(robot_name)
        log = read_log(given.logs / name, of_log)
        times = [false_alarms(with_wheels(log, count), of_log) for count in (2, 3)]
        print(f"{name}: {times[0]} and {times[1]} times in {log.duration:.0f} s")


if __name__ == "__main__":
    main()
