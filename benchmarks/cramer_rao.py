"""How near the filter comes to the posterior Cramér-Rao bound where its model is the truth.

Runs of one drive (the same track speeds, 50 Hz, IMU in step, a position fix each second for the first
half, then none) are drawn from the filter's own stochastic model (`analysis.sampled_model`): each
with its own parameters, biases, slip and noise. The RMSE of the filter over the runs at the end of each
half stands over two bounds: the mean covariance of the best linear filter that knew the Jacobians of
the truth, and the posterior Cramér-Rao bound by Tichavský's recursion, expectations over the same runs.
The last column is what the former would lose by obeying the filter's rule that the IMU moves neither
pose nor track scale. Position errors are in the axes of the true robot. Intervals are 95 % bootstrap
intervals over the runs.

`--share` draws parameters and biases with a share of the initial standard deviations, of which the
filter is told: the smaller, the more linear the problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from _study import bootstrap, spread, study_parser, table, told
from analysis.cramer_rao import BoundTerms, bound_terms, in_axes_of_robot, posterior_bound
from analysis.linearised import LinearisedModel, Sensors, stepped
from analysis.sampled_model import Fixes, ModelSampler
from consistency import RATE, SETTINGS, moving_speeds, studied_robot

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import relative
from icreckon.estimator.log.measurements import HeadingFix, PositionFix
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import DEFAULT_ADAPTATION, find_variant, parameter_names
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

SEED = 20_242
START_SIGMA = (0.05, 0.05, 0.02)
POSITION_SIGMA = 0.05


@dataclass(frozen=True)
class Job:
    """One run: variant, index, drive, length [s], share of the initial spread."""

    variant: str
    index: int
    trajectory: str
    duration: float
    share: float


@dataclass(frozen=True)
class Score:
    """At the end of each half (2, SIZE), and the terms of Tichavský's recursion.

    Attributes:
        squares: squared errors of the filter.
        bound: variances along the true motion, of the best linear filter.
        with_rule: of one that keeps the rule of the IMU.
        terms: of this motion.
    """

    squares: Floats
    bound: Floats
    with_rule: Floats
    terms: BoundTerms


def told_of(robot: Robot, variant: str, share: float) -> tuple[Robot, Settings]:
    """Robot and settings with a share of the initial standard deviations."""
    adaptation = DEFAULT_ADAPTATION[find_variant(variant).model]
    names = [name for name in adaptation.__struct_fields__ if name != "walk"]
    smaller = {name: share * getattr(adaptation, name) for name in names}
    # The walk is a share of these.
    smaller["walk"] = adaptation.walk / share
    imu = robot.imu
    return (
        msgspec.structs.replace(
            robot,
            tracks=msgspec.structs.replace(
                robot.tracks, scale_sigma=share * robot.tracks.scale_sigma
            ),
            imu=msgspec.structs.replace(
                imu,
                gyro_bias_sigma=share * imu.gyro_bias_sigma,
                accelerometer_bias_sigma=share * imu.accelerometer_bias_sigma,
                gyro_scale_sigma=share * imu.gyro_scale_sigma,
            ),
        ),
        msgspec.structs.replace(
            SETTINGS, adaptation=msgspec.structs.replace(adaptation, **smaller)
        ),
    )


def score(job: Job) -> Score:
    """One run."""
    robot, settings = told_of(studied_robot(), job.variant, job.share)
    variant = find_variant(job.variant)
    speeds = moving_speeds(robot, job.trajectory, job.duration, [SEED])
    half = len(speeds) // 2
    sampler = ModelSampler(robot, variant, settings, Fixes(), start_sigma=START_SIGMA)
    run = sampler.run(speeds, 1.0 / RATE, np.random.default_rng([SEED, job.index]))
    ends = {int(run.stamps[half]): half, int(run.stamps[-1]): len(speeds) - 1}
    estimator = PoseEstimator(robot, job.variant, settings=settings, start_sigma=START_SIGMA)
    squares = np.zeros((2, s.SIZE))
    for measurement in run.measurements:
        if measurement.stamp > run.stamps[half] and isinstance(
            measurement, PositionFix | HeadingFix
        ):
            continue
        estimator.feed(measurement)
        if estimator.stamp in ends:
            at = ends[estimator.stamp]
            error = estimator.state - run.states[at]
            error[s.POSE] = relative(run.states[at, s.POSE], estimator.state[s.POSE])
            squares[int(at > half)] = error**2
    fixed = Sensors(gyro=True, accelerometer=True, position_sigma=POSITION_SIGMA)
    model = LinearisedModel(robot, variant, fixed, 1.0 / RATE, settings)
    sigmas = model.sigmas.copy()
    sigmas[s.POSE] = START_SIGMA
    best = ruled = np.diag(sigmas**2)
    bound, with_rule, steps = np.zeros((2, s.SIZE)), np.zeros((2, s.SIZE)), []
    for k in range(1, len(speeds)):
        model.begin(run.begins[k], *speeds[k].tolist())
        step = model.step(run.begins[k], *speeds[k].tolist(), run.states[k])
        if k > half:
            step = step._replace(after=[])
        steps.append(step)
        best, ruled = stepped(best, step), stepped(ruled, step, ruled=True)
        if k in ends.values():
            yaw = float(run.states[k, s.YAW])
            bound[int(k > half)] = np.diagonal(in_axes_of_robot(best, yaw))
            with_rule[int(k > half)] = np.diagonal(in_axes_of_robot(ruled, yaw))
    return Score(squares, bound, with_rule, bound_terms(steps, run.states[:, s.YAW], sigmas))


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 200, ("constant-online", "inertia-online"))
    parser.add_argument("--duration", type=float, default=40.0, help="s")
    parser.add_argument("--trajectory", default="random")
    parser.add_argument("--share", type=float, default=1.0, help="of the initial spread")
    arguments = parser.parse_args()
    rows = []
    for name in arguments.variants:
        jobs = [
            Job(name, index, arguments.trajectory, arguments.duration, arguments.share)
            for index in range(arguments.runs)
        ]
        scores = spread(score, jobs, arguments.workers)
        rows += variant_rows(name, scores, arguments.share)
    print(f"{arguments.runs} runs of {arguments.duration:.0f} s\n")
    head = (
        "variant",
        "at the end of",
        "error of",
        "RMSE",
        "over the bound along the motion (95 %)",
    )
    table((*head, "over Tichavský's bound (95 %)", "what the rule costs"), rows)


def variant_rows(name: str, scores: list[Score], share: float) -> list[list[str]]:
    """The rows of a variant."""
    robot, settings = told_of(studied_robot(), name, share)
    start = LinearisedModel(robot, find_variant(name), Sensors(), 1.0 / RATE, settings).sigmas
    start[s.POSE] = START_SIGMA
    terms = scores[0].terms
    for one in scores[1:]:
        terms = terms + one.terms
    bounds = posterior_bound(terms, start)
    half = round(0.5 * len(bounds))
    names = list(s.STATE_NAMES)
    names[s.PARAMETERS] = parameter_names(find_variant(name))
    groups = {
        "position": ([s.X, s.Y], "m"),
        "yaw": ([s.YAW], "rad"),
        "slip of w": ([s.SLIP_W], "rad/s"),
        **{
            names[index]: ([index], "")
            for index in terms.states.tolist()
            if index >= s.PARAMETERS.start
        },
    }
    rows = []
    for which, (told_as, at) in enumerate({"fixes": half - 1, "dead reckoning": -1}.items()):
        for group, (states, unit) in groups.items():
            places = np.searchsorted(terms.states, states)
            least = float(np.diagonal(bounds[at])[places].sum())
            squares = np.array([one.squares[which, states].sum() for one in scores])
            known = np.array([one.bound[which, states].sum() for one in scores])
            ruled = np.array([one.with_rule[which, states].sum() for one in scores])
            paired = np.stack([squares, known], axis=-1)
            by_least = bootstrap(lambda x, b=least: np.sqrt(x[..., 0].mean(-1) / b), paired)
            by_known = bootstrap(lambda x: np.sqrt(x[..., 0].mean(-1) / x[..., 1].mean(-1)), paired)
            rows.append(
                [
                    f"`{name}`",
                    told_as,
                    group,
                    f"{np.sqrt(squares.mean()):.3g} {unit}".strip(),
                    told(*by_known),
                    told(*by_least),
                    f"{np.sqrt(ruled.mean() / known.mean()):.2f}",
                ]
            )
    return rows


if __name__ == "__main__":
    main()
