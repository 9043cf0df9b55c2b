"""Does the covariance stay a covariance? Millions of steps, huge gaps, tiny steps, extreme inputs.

First a minute of driving, drawn from the filter's own model, is repeated as often as needed: each time
the robot goes on from where it was. A step is a track-speed and an IMU sample; fixes come each second
in three minutes of four. Every 1000 steps the covariance must be finite, symmetric, and positive
definite in the states that are estimated: the smallest eigenvalue of the correlation matrix is told.
Then come inputs that are finite, but far from anything sensible.

    python benchmarks/long_run.py --steps 1_000_000

With `--hours` the only table is one run on level ground, a row for each hour: processor time of a step,
largest memory of the process so far, NEES of the pose (3 is ideal; each minute has the same noise, so
rows are to be alike, and say nothing of other noise).

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
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    Measurement,
    PositionFix,
    TrackSpeeds,
)
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
SECOND = 1_000_000_000
FIX_SIGMA = 0.05
PROGRESS_EVERY = 10.0


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


def repeated(run: SampledRun, steps: int) -> Iterator[Measurement]:
    """The measurements of a run, again and again, each time from where it has ended."""
    for measurement, _ in repeated_from(run, steps):
        yield measurement


def repeated_from(run: SampledRun, steps: int) -> Iterator[tuple[Measurement, Floats]]:
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
    # A slope of the repeated minute would jump where it begins anew.
    robot = structs.replace(robot, slope=structs.replace(robot.slope, sigma=0.0))
    run = sampled_minute(robot, variant, rate)
    every, of_hour = round(CHECK_EVERY * rate / RATE), round(3600.0 * rate)
    steps_of_run = len(run.stamps) - 1
    estimator = PoseEstimator(robot, variant, settings=settings)
    count, bad, least, nees = 0, 0, np.inf, list[float]()
    spent = time.process_time()
    for measurement, origin in repeated_from(run, hours * of_hour):
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


def long_row(robot: Robot, variant: str, settings: Settings, steps: int) -> list[str]:
    """A row of the first table."""
    run = sampled_minute(robot, variant, RATE)
    estimator = PoseEstimator(robot, variant, settings=settings)
    least, count, bad = np.inf, 0, 0
    begin = told = time.monotonic()
    for measurement in repeated(run, steps):
        estimator.feed(measurement)
        if not isinstance(measurement, ImuSample):
            continue
        count += 1
        if count % CHECK_EVERY:
            continue
        smallest = smallest_correlation(estimator.covariance)
        bad += not smallest > 0.0 or not np.isfinite(estimator.state).all()
        least = min(least, smallest)
        if time.monotonic() - told > PROGRESS_EVERY:
            told = time.monotonic()
            print(f"{variant}: {count} steps, {told - begin:.0f} s", file=sys.stderr, flush=True)
    spent = time.monotonic() - begin
    return [
        f"`{variant}`",
        f"{count:,}",
        f"{count // CHECK_EVERY:,}",
        str(bad),
        f"{least:.1e}",
        f"{1e6 * spent / count:.0f}",
    ]


def start(robot: Robot, variant: str) -> tuple[PoseEstimator, int]:
    """An estimator after two seconds of a bend, and the stamp it has reached [ns]."""
    estimator, stamp = PoseEstimator(robot, variant), SECOND
    for _ in range(200):
        stamp += SECOND // 100
        estimator.feed(TrackSpeeds(stamp, 0.3, 0.6))
        estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.27), (0.0, 0.11, 9.81)))
    return estimator, stamp


def extremes(stamp: int) -> dict[str, list[Measurement]]:
    """Inputs that are finite and far from anything sensible, from a stamp [ns] on."""

    def samples(
        step: int, count: int, rate: float, force: float, speed: float
    ) -> list[Measurement]:
        found: list[Measurement] = []
        for k in range(1, count + 1):
            at = stamp + k * step
            found.append(TrackSpeeds(at, speed, -speed))
            found.append(ImuSample(at, (0.0, 0.0, rate), (0.0, force, 9.81)))
        return found

    far = range(1, 30)
    return {
        "steps of 10 µs": samples(10_000, 2000, 0.27, 0.11, 0.5),
        "a gap of 90 s, then on": samples(90 * SECOND, 1, 0.27, 0.11, 0.5),
        "gaps of 90 s, 30 of them": samples(90 * SECOND, 30, 0.27, 0.11, 0.5),
        "gaps of 10 000 s, 30 of them": samples(10_000 * SECOND, 30, 0.27, 0.11, 0.5),
        "gyro at 1e6 rad/s": samples(SECOND // 100, 300, 1e6, 0.11, 0.5),
        "accelerometer at 1e9 m/s²": samples(SECOND // 100, 300, 0.27, 1e9, 0.5),
        "tracks at ten times their range": samples(SECOND // 100, 300, 0.27, 0.11, 9.9),
        "all of these": samples(SECOND // 100, 300, 1e6, 1e9, 9.9),
        "fixes 1e9 m off": [PositionFix(stamp + k * SECOND, 1e9, -1e9, 1e-2) for k in far],
        "fixes of variance 1e-30": [PositionFix(stamp + k * SECOND, 1.0, 1.0, 1e-30) for k in far],
        "fixes of variance 1e30": [PositionFix(stamp + k * SECOND, 1.0, 1.0, 1e30) for k in far],
        "headings of variance 1e-30": [HeadingFix(stamp + k * SECOND, 3.0, 1e-30) for k in far],
        "body velocities of 1e8 m/s": [
            BodyVelocity(stamp + k * SECOND // 10, 1e8, -1e8, 1e-4) for k in far
        ],
        "body velocities of variance 1e-30": [
            BodyVelocity(stamp + k * SECOND // 10, 0.4, 0.0, 1e-30) for k in far
        ],
    }


def extreme_row(robot: Robot, variant: str, name: str) -> list[str]:
    """A row of the second table: the smallest correlation on the way, and what became of the input."""
    estimator, stamp = start(robot, variant)
    least, finite = np.inf, True
    with np.errstate(all="ignore"):
        for measurement in extremes(stamp)[name]:
            estimator.feed(measurement)
            least = float(np.minimum(least, smallest_correlation(estimator.covariance)))
            finite &= bool(np.isfinite(estimator.state).all())
    refused = sum(estimator.health.rejections().values())
    sigma = float(np.sqrt(np.diagonal(estimator.pose_covariance)[:2].sum().clip(0.0)))
    return [
        name,
        f"`{variant}`",
        "yes" if finite else "no",
        f"{least:.0e}",
        str(refused),
        f"{sigma:.2g}",
    ]


def main() -> None:
    """Print the tables."""
    parser = script_parser(__doc__)
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--hours", type=int, default=0, help="a row for each hour of one run")
    parser.add_argument("--rate", type=float, default=RATE, help="of those hours [Hz]")
    parser.add_argument("--variants", nargs="+", default=["inertia-online"])
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="settings")
    arguments = parser.parse_args()
    robot, settings = load_robot("auriga-alpha"), settings_of(arguments.set)
    for name in arguments.variants if arguments.hours else ():
        print(f"{name}, {arguments.rate:g} Hz\n")
        table(
            ("hour", "steps", "failed", "smallest eigenvalue", "NEES", "µs a step", "peak MB"),
            list(hour_rows(robot, name, settings, arguments.hours, arguments.rate)),
        )
    if arguments.hours:
        return
    table(
        ("variant", "steps", "checks", "failed", "smallest eigenvalue", "µs a step"),
        [long_row(robot, name, settings, arguments.steps) for name in arguments.variants],
    )
    print()
    table(
        ("input", "variant", "finite", "smallest eigenvalue", "refused", "position sigma after, m"),
        [
            extreme_row(robot, variant, name)
            for variant in arguments.variants
            for name in extremes(0)
        ],
    )


if __name__ == "__main__":
    main()
