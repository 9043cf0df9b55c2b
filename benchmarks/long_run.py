"""Does the covariance stay a covariance, and the step as fast and as small, over hours?

A minute of driving, drawn from the filter's own model, is repeated: each time the robot continues from
where it was. A step is a track-speed and an IMU sample; fixes come each second in three minutes of four.
Twenty times a minute the covariance must be finite, symmetric, and positive definite in the states that
are estimated: the table has the smallest eigenvalue of the correlation matrix. It has a row for each
hour: processor time of a step, largest memory of the process so far, NEES of the pose (3 is ideal; each
minute has the same noise, so rows should be alike, and show nothing of other noise).

    python benchmarks/long_run.py --hours 24 --rate 200 --set history=1
"""

from __future__ import annotations

import resource
import sys
import time
from ast import literal_eval
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from _sampled_model import Fixes, ModelSampler, SampledRun
from _study import script_parser, table
from msgspec import structs

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import compose, relative, wrap_angle
from icreckon.estimator.log.measurements import ImuSample, Measurement, PositionFix
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings, StandstillSettings
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.drives.trajectories import make_trajectory

SEED = 20_247
RATE = 50.0
# The standstill that every trajectory begins with, and the start after it [s].
BEGIN = 5.0
SETTINGS = Settings(standstill=StandstillSettings(track_speed=0.0))
CHECK_EVERY = 1000
MINUTE = 60.0
FIX_SIGMA = 0.05


def smallest_correlation(P: Floats) -> float:
    """Smallest eigenvalue of the correlation matrix of what is estimated.

    It is -1 where a variance is negative, and NaN where `P` is not finite or not symmetric.
    """
    if not np.isfinite(P).all() or not np.array_equal(P, P.T):
        return float("nan")
    variances = np.diagonal(P)
    if (variances < 0.0).any():
        return -1.0
    known = variances > 0.0
    sigma = np.sqrt(variances[known])
    return float(np.linalg.eigvalsh(P[np.ix_(known, known)] / np.outer(sigma, sigma))[0])


def nees_of(error: Floats, covariance: Floats) -> float:
    """Normalised estimation error squared, in units that make the covariance a correlation."""
    unit = np.sqrt(np.diagonal(covariance))
    scaled = error / unit
    return float(scaled @ np.linalg.solve(covariance / np.outer(unit, unit), scaled))


def settings_of(pairs: list[str]) -> Settings:
    """Settings of a fast run, with some changed: NAME=VALUE."""
    changes: dict[str, Any] = {"history": 0.0}
    for pair in pairs:
        name, _, value = pair.partition("=")
        with suppress(ValueError):
            value = literal_eval(value)
        changes[name] = value
    fields = {name: getattr(SETTINGS, name) for name in SETTINGS.__struct_fields__}
    return Settings(**{**fields, **changes})


def repeated(run: SampledRun, steps: int) -> Iterator[tuple[Measurement, Floats]]:
    """The measurements of a run, again and again, and the pose that each repetition starts from."""
    length = int(run.stamps[-1] - run.stamps[0])
    first, last = run.states[0, s.POSE], run.states[-1, s.POSE]
    lap_motion = compose(last, relative(first, np.zeros(3)))
    pose, count, lap = np.zeros(3), 0, 0
    while True:
        turn = pose[2]
        cos, sin = np.cos(turn), np.sin(turn)
        for measurement in run.measurements[(1 if lap else 0) :]:
            m = replace(measurement, stamp=measurement.stamp + lap * length)
            if isinstance(m, PositionFix):
                if lap % 4 == 3:
                    continue
                x, y = pose[0] + cos * m.x - sin * m.y, pose[1] + sin * m.x + cos * m.y
                m = replace(m, x=float(x), y=float(y))
            yield m, pose
            count += isinstance(m, ImuSample)
            if count >= steps:
                return
        pose, lap = compose(pose, lap_motion), lap + 1


def sampled_minute(robot: Robot, variant: str, rate: float) -> SampledRun:
    """A minute of driving from the filter's own model, with fixes."""
    drive = np.random.default_rng([SEED])
    moving = {"stop": 0.0, "reverse": 0.0}
    command = make_trajectory("random", MINUTE + BEGIN, robot, drive, moving)
    speeds = np.asarray(command(BEGIN + np.arange(int(MINUTE * rate) + 1) / rate))
    fixes = Fixes(position_sigma=FIX_SIGMA)
    sampler = ModelSampler(robot, find_variant(variant), SETTINGS, fixes)
    return sampler.run(speeds, 1.0 / rate, np.random.default_rng(SEED))


def hour_rows(
    robot: Robot, variant: str, settings: Settings, hours: int, rate: float
) -> Iterator[list[str]]:
    """Rows of one long run on level ground, a row for each hour."""
    # A slope of the repeated minute would jump where it starts again.
    robot = structs.replace(robot, slope=structs.replace(robot.slope, sigma=0.0))
    run = sampled_minute(robot, variant, rate)
    every, of_hour = round(CHECK_EVERY * rate / RATE), round(3600.0 * rate)
    steps_of_run = len(run.stamps) - 1
    estimator = PoseEstimator(robot, variant, settings=settings)
    count, bad, least, nees = 0, 0, np.inf, list[float]()
    spent = time.process_time()
    for measurement, origin in repeated(run, hours * of_hour):
        estimator.feed(measurement)
        if not isinstance(measurement, ImuSample):
            continue
        count += 1
        if count % every == 0:
            P = estimator.covariance
            smallest = smallest_correlation(P)
            bad += not smallest > 0.0 or not np.isfinite(estimator.state).all()
            least = min(least, smallest)
            place = (count - 1) % steps_of_run + 1
            error = estimator.state[s.POSE] - compose(origin, run.states[place, s.POSE])
            error[2] = wrap_angle(error[2])
            nees.append(nees_of(error, P[s.POSE, s.POSE]))
        if count % of_hour == 0:
            taken = 1e6 * (time.process_time() - spent) / of_hour
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            row = [f"{count // of_hour}", f"{count:,}", str(bad), f"{least:.1e}"]
            yield [*row, f"{np.mean(nees):.1f}", f"{taken:.0f}", f"{memory:.0f}"]
            print(f"{variant}: {count // of_hour} of {hours} hours", file=sys.stderr, flush=True)
            least, nees, spent = np.inf, [], time.process_time()


def main() -> None:
    """Print the table."""
    parser = script_parser(__doc__)
    parser.add_argument("--hours", type=int, default=1)
    parser.add_argument("--rate", type=float, default=RATE, help="steps per second [Hz]")
    parser.add_argument("--variant", default="inertia-online")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="settings")
    arguments = parser.parse_args()
    robot, settings = load_robot("auriga-alpha"), settings_of(arguments.set)
    table(
        ("hour", "steps", "failed", "smallest eigenvalue", "NEES", "µs a step", "peak MB"),
        list(hour_rows(robot, arguments.variant, settings, arguments.hours, arguments.rate)),
    )


if __name__ == "__main__":
    main()
