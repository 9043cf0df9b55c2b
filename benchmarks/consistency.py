"""Is the filter as sure as it may be where its model is the truth? NEES and NIS over many runs.

Runs are drawn from the filter's own stochastic model (`analysis.sampled_model`): everyday driving
without stops, track speeds and IMU in step at 50 Hz, a position fix and a body velocity each second and
a heading with every fix, so that all sensors have their say; nominal noise, with scales of tracks and
gyro unknown by 1 % and 0.5 %. Standstill detection is off, since nothing stands.

NEES is taken each 5 s. Its mean over the runs should be the number of states, and lie in its 95 % band
(chi-square over the runs) at 95 % of the times. NIS is per degree of freedom; beside it stands the
share of runs in which it lies in the 95 % band. What the gates cut off is allowed for. The factor by
which position fixes enlarge the slip is at least 1 in the filter and 1 in the truth.

    python benchmarks/consistency.py                     # all terms of the filter are true
    python benchmarks/consistency.py --without lateness  # one of the careful ones is not
    python benchmarks/consistency.py --each-without      # a row for each of them, and one for all
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import msgspec
import numpy as np
from _study import mean_interval, spread, study_parser, table, told
from analysis.sampled_model import Fixes, ModelSampler, Terms
from scipy.stats import chi2

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.gate import CHI_SQUARE_1E4
from icreckon.estimator.log.measurements import TrackSpeeds
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings, StandstillSettings
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.drives.trajectories import make_trajectory

SEED = 20_240
RATE = 50.0
NEES_EVERY = 5.0
# The standstill that every trajectory begins with, and the start after it [s].
BEGIN = 5.0
SETTINGS = Settings(standstill=StandstillSettings(track_speed=0.0))
FIXES = Fixes(heading_sigma=0.02, velocity_sigma=0.05)
QUANTITIES = ("pose", "velocity", "parameters", "all states")
CAREFUL = {
    "white_slip": "white noise of the yaw rate (`Slip.white_time`): what is learnt is to be what lasts",
    "lateness": "track speeds are averages of the time before (`TrackChange`, a fifth of the "
    "kinematics' acceleration)",
    "slip_change": "the slip changes within a sample of the accelerometers",
    "track_noise": "noise of the track speeds",
}
"""What the filter allows for by each careful term."""


@dataclass(frozen=True)
class Job:
    """One run: its variant, index, length [s], drive, careful terms, and share of the initial spread."""

    variant: str
    index: int
    duration: float
    trajectory: str
    terms: Terms
    share: float


@dataclass(frozen=True)
class Score:
    """NEES (n, 4) of the quantities, their degrees (4,), and by sensor NIS sum and degrees."""

    nees: Floats
    degrees: Floats
    nis: dict[str, tuple[float, int]]
    rejected: int


def studied_robot() -> Robot:
    """The robot, whose scales are not known either."""
    robot = load_robot("auriga-alpha")
    return msgspec.structs.replace(
        robot,
        tracks=msgspec.structs.replace(robot.tracks, scale_sigma=0.01),
        imu=msgspec.structs.replace(robot.imu, gyro_scale_sigma=0.005),
    )


def moving_speeds(
    robot: Robot, trajectory: str, duration: float, seed: list[int], rate: float = RATE
) -> Floats:
    """(n, 2) track speeds of a drive that never stops, at a rate [Hz]."""
    options = {"stop": 0.0, "reverse": 0.0} if trajectory == "random" else {}
    rng = np.random.default_rng(seed)
    command = make_trajectory(trajectory, duration + BEGIN, robot, rng, options)
    times = BEGIN + np.arange(int(duration * rate) + 1) / rate
    return np.asarray(command(times))


def nees_of(error: Floats, covariance: Floats) -> float:
    """Normalised estimation error squared, in units that make the covariance a correlation."""
    unit = np.sqrt(np.diagonal(covariance))
    scaled = error / unit
    return float(scaled @ np.linalg.solve(covariance / np.outer(unit, unit), scaled))


def score(job: Job) -> Score:
    """One run."""
    robot, variant = studied_robot(), find_variant(job.variant)
    speeds = moving_speeds(robot, job.trajectory, job.duration, [SEED, job.index])
    sampler = ModelSampler(robot, variant, SETTINGS, FIXES, job.terms, share=job.share)
    run = sampler.run(speeds, 1.0 / RATE, np.random.default_rng([SEED, job.index, 1]))
    estimator = PoseEstimator(robot, job.variant, settings=SETTINGS)
    estimated = np.flatnonzero(np.diagonal(estimator.covariance))
    parameters = estimated[(estimated >= s.PARAMETERS.start) & (estimated < s.PARAMETERS.stop)]
    every = round(NEES_EVERY * RATE)
    rows, at = [], -1
    pending = list(run.measurements)
    for number, measurement in enumerate(pending):
        estimator.feed(measurement)
        at += isinstance(measurement, TrackSpeeds)
        last = number + 1 == len(pending) or isinstance(pending[number + 1], TrackSpeeds)
        if not last or at == 0 or at % every:
            continue
        estimate = estimator.snapshot()
        error, P = estimate.state - run.states[at], estimate.covariance
        error[s.YAW] = (error[s.YAW] + np.pi) % (2.0 * np.pi) - np.pi
        asked = np.concatenate([np.arange(3, 6), estimated, np.arange(3)])
        rows.append(
            (
                nees_of(error[:3], P[:3, :3]),
                nees_of(estimate.twist - run.twists[at], estimate.twist_covariance),
                nees_of(error[parameters], P[np.ix_(parameters, parameters)])
                if len(parameters)
                else np.nan,
                nees_of(error[asked], P[np.ix_(asked, asked)]),
            )
        )
    degrees = np.array([3.0, 3.0, len(parameters), len(estimated) + 6])
    sensors = estimator.health.sensors
    nis = {name: (one.nis_sum, one.degrees) for name, one in sensors.items() if one.degrees}
    rejected = sum(estimator.health.rejections().values())
    return Score(np.array(rows), degrees, nis, rejected)


def expected_nis(degrees: int) -> float:
    """Mean NIS for each degree of freedom of what a gate lets through."""
    gate = CHI_SQUARE_1E4[degrees]
    return float(chi2.cdf(gate, degrees + 2) / chi2.cdf(gate, degrees))


def nees_row(variant: str, quantity: int, scores: list[Score]) -> list[str]:
    """A row of the first table."""
    nees = np.array([one.nees[:, quantity] for one in scores])
    degrees = scores[0].degrees[quantity]
    low, high = chi2.interval(0.95, degrees * len(nees))
    means = nees.mean(axis=0)
    inside = (means * len(nees) > low) & (means * len(nees) < high)
    return [
        f"`{variant}`",
        QUANTITIES[quantity],
        f"{degrees:.0f}",
        told(*mean_interval(nees.mean(axis=1))),
        f"{low / len(nees):.2f} to {high / len(nees):.2f}",
        f"{100.0 * inside.mean():.0f} % of {len(means)}",
    ]


def nis_row(variant: str, sensor: str, scores: list[Score]) -> list[str]:
    """A row of the second table."""
    sums = np.array([one.nis[sensor][0] for one in scores])
    degrees = np.array([one.nis[sensor][1] for one in scores])
    expected = expected_nis(2 if sensor == "position" else 1)
    low, high = chi2.interval(0.95, degrees)
    inside = (sums / expected > low) & (sums / expected < high)
    return [
        f"`{variant}`",
        sensor,
        f"{degrees.sum()}",
        told(*mean_interval(sums / degrees), ".3f"),
        f"{expected:.3f}",
        f"{100.0 * inside.mean():.0f} %",
    ]


def careful_rows(arguments: argparse.Namespace) -> Iterator[list[str]]:
    """Rows of the table of careful terms, for the first variant."""
    cases = {"(nothing)": (), **{f"`{name}`": (name,) for name in CAREFUL}, "all four": (*CAREFUL,)}
    for label, without in cases.items():
        terms = replace(Terms(), **dict.fromkeys(without, 0.0))
        jobs = jobs_of(arguments, arguments.variants[:1], terms)
        scores = spread(score, jobs, arguments.workers)
        nis = [
            np.array([one.nis[sensor][0] / one.nis[sensor][1] for one in scores])
            for sensor in ("gyro", "accelerometer_x", "accelerometer_y")
        ]
        nees = [
            np.array([one.nees[:, QUANTITIES.index(name)].mean() for one in scores])
            for name in ("pose", "parameters")
        ]
        yield [
            label,
            CAREFUL[without[0]] if len(without) == 1 else "",
            *(told(*mean_interval(one)) for one in nis),
            *(told(*mean_interval(one), ".1f") for one in nees),
        ]


def jobs_of(arguments: argparse.Namespace, variants: Sequence[str], terms: Terms) -> list[Job]:
    """Jobs of some variants."""
    return [
        Job(
            name,
            index,
            arguments.duration,
            arguments.trajectory,
            terms,
            arguments.share,
        )
        for name in variants
        for index in range(arguments.runs)
    ]


def main() -> None:
    """Print the tables."""
    parser = study_parser(__doc__, 200, ("constant-online", "inertia-online"))
    parser.add_argument("--duration", type=float, default=60.0, help="s")
    parser.add_argument("--trajectory", default="random")
    parser.add_argument(
        "--share", type=float, default=1.0, help="of the initial spread, in the truth"
    )
    parser.add_argument(
        "--without",
        nargs="+",
        default=[],
        choices=[field.name for field in fields(Terms)],
        help="careful terms that are not in the truth",
    )
    parser.add_argument(
        "--each-without", action="store_true", help="a row for each careful term, one variant"
    )
    arguments = parser.parse_args()
    if arguments.each_without:
        head = ("not in the truth (`TERM`)", "what it allows for", "NIS of the gyro")
        head = (*head, "of accelerometer_x", "of accelerometer_y", "NEES of the pose (3)")
        table((*head, "of the parameters (8)"), careful_rows(arguments))
        return
    terms = replace(Terms(), **dict.fromkeys(arguments.without, 0.0))
    scores = spread(score, jobs_of(arguments, arguments.variants, terms), arguments.workers)
    by_variant = {
        name: scores[row * arguments.runs : (row + 1) * arguments.runs]
        for row, name in enumerate(arguments.variants)
    }
    print(f"{arguments.runs} runs of {arguments.duration:.0f} s\n")
    table(
        ("variant", "NEES of", "states", "mean (95 %)", "95 % band of a time", "times inside"),
        [
            nees_row(name, quantity, found)
            for name, found in by_variant.items()
            for quantity in range(len(QUANTITIES))
            if found[0].degrees[quantity]
        ],
    )
    print()
    table(
        ("variant", "NIS of", "samples", "mean (95 %)", "expected", "runs inside their 95 % band"),
        [
            nis_row(name, sensor, found)
            for name, found in by_variant.items()
            for sensor in found[0].nis
        ],
    )
    rejected = {name: sum(one.rejected for one in found) for name, found in by_variant.items()}
    print("\nrejected:", ", ".join(f"{count} `{name}`" for name, count in rejected.items()))


if __name__ == "__main__":
    main()
