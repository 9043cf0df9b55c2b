"""Dead reckoning on the sample logs, with a geometry calibrated only on other logs of the same robot.

    python benchmarks/accuracy.py DATA [--ablation] [--write BASELINE | --check BASELINE]

DATA is a folder with these logs (public, BSD licences): warthog_grass_2024_8_8_15h56s39,
warthog_grass_2024_8_8_16h11s19, warthog_grass_2024_7_29_14h46s15, warthog_asphalt_2024_9_25_12h8s57,
marmotte_part1 and husky_deflated_part1, as MCAP bags.

Every fold begins with the makers' geometry (wheel radius, track, no slip) and an IMU that is mounted
square, which are calibrated anew (`icreckon calibrate`) on the training logs, as is the latency of the
track speeds: for each Warthog log the other three, for Marmotte and Husky one half of the log for the
other. Noise is that of the robot files: measured on these logs at rest and as vibration, not tuned to
their drift. No fixes. The truth's lag and lever arm are found anew for each filter, on the log that is
scored, since where in the robot its base_link lies is the filter's to say.

Figures are the position error after 30 s (10 s) over the distance [%], summed over all segments,
aligned at each one's start. Intervals are 95 % bootstrap intervals over blocks of 60 s of all logs of a
row. NEES is that of the motion over 30 s (10 s), by its own covariance and the truth's noise, which is
taken to be what is left over half a second; 3 is ideal. "Nominal track" is the same filter with the
calibrated radius and the maker's track; "nothing known" has the maker's radius too, which no gyro shows.

`gyro` is wheels and gyro: radius, latency, gyro scale and bias calibrated as for all others. It stands
first, and ratios are to it and to `constant-online`. With --ablation the filters that learn also run
without gravity along the ground (and without accelerometers), with equal radii, and without the force
along the tracks, each with everything else as it is.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np
from _logs import ASPHALT, GRASS
from _study import bootstrap, data_parser, ratio_of_sums, spread, table

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import relative
from icreckon.estimator.calibration import calibrate
from icreckon.estimator.log.lag import Lag
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import drift, interpolate_poses
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Indices, Robot, Slope, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.soil import Soil
from icreckon.estimator.robot.variants import VARIANTS, default_adaptation
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run
from icreckon.replay.comparison.truth_alignment import align_truth
from icreckon.replay.estimates.imu_mounting import estimate_mounting, vertical_rate
from icreckon.replay.estimates.latency import objection, track_latency
from icreckon.replay.reading.read_log import read_log

HORIZONS = (30.0, 10.0)
BLOCK = 60.0
DRAWS = 5000
# Motions whose covariance is looked at begin so often [s], and the truth's noise shows in such [s].
MARK_EVERY, NOISE_HORIZON = 10.0, 0.5
REFERENCES = ("gyro", "constant-online")
ONLINE = ("constant-online", "inertia-online")
# The makers' wheel (sprocket) radius and track [m], from the README beside the logs.
MAKERS = {
    "warthog": (0.3, 1.1652),
    "marmotte": (0.116702, 0.592723),
    "husky-deflated": (0.165, 0.55),
}
# How far a figure may be from the baseline's [percentage points], for other processors and libraries.
ROUNDING = 0.03


class Piece(NamedTuple):
    """A part of a log, in shares of its duration."""

    log: str
    begin: float = 0.0
    end: float = 1.0

    @property
    def label(self) -> str:
        """Its name in tables."""
        whole = (self.begin, self.end) == (0.0, 1.0)
        return self.log if whole else f"{self.log}, {self.begin:.0%} to {self.end:.0%}"


class Fold(NamedTuple):
    """What is scored, and what its geometry is calibrated on; `row` is where it counts."""

    row: str
    robot: str
    scored: Piece
    training: tuple[Piece, ...]


HALVED = {
    "Marmotte": ("marmotte", "marmotte_part1"),
    "Husky": ("husky-deflated", "husky_deflated_part1"),
}
# After 30 s and 10 s, where one was set [%].
GOALS = {
    "Warthog, grass": (2.1, 3.3),
    "Warthog, asphalt": (2.6, 2.8),
    "Marmotte": (5.0, 4.2),
    "Husky": (4.5, None),
}


def folds() -> list[Fold]:
    """All folds."""
    warthog = (*GRASS, ASPHALT)
    found = [
        Fold(
            "Warthog, grass" if name in GRASS else "Warthog, asphalt",
            "warthog",
            Piece(name),
            tuple(Piece(other) for other in warthog if other != name),
        )
        for name in warthog
    ]
    for row, (robot, name) in HALVED.items():
        halves = Piece(name, 0.0, 0.5), Piece(name, 0.5, 1.0)
        found += [Fold(row, robot, halves[k], (halves[1 - k],)) for k in range(2)]
    return found


@dataclass(frozen=True)
class Score:
    """A filter on the scored part of a fold.

    Attributes:
        row: of the fold.
        log: what was scored.
        who: the variant, and what it knew.
        segments: errors [m], distances [m] and blocks of segments, by horizon.
        nees: by horizon, of motions.
    """

    row: str
    log: str
    who: str
    segments: dict[float, tuple[Floats, Floats, Floats]]
    nees: dict[float, Floats]


class Job(NamedTuple):
    """A fold, with the folder of the logs."""

    data: Path
    fold: Fold
    variants: tuple[str, ...]
    less_known: bool = True
    ablation: bool = False


def without_gravity(robot: Robot, _: str) -> tuple[Robot, Settings]:
    """Level ground for the filter, which then has no use for accelerometers."""
    level = msgspec.structs.replace(robot, slope=Slope(sigma=0.0))
    return level, Settings(use_accelerometer=False)


def with_equal_radii(robot: Robot, _: str) -> tuple[Robot, Settings]:
    """No difference of the radii, known or learnt."""
    tracks = msgspec.structs.replace(robot.tracks, difference=0.0, difference_sigma=0.0)
    return msgspec.structs.replace(robot, tracks=tracks), Settings()


def without_creep(robot: Robot, name: str) -> tuple[Robot, Settings]:
    """No shift of the ICRs by the force along the tracks, known or learnt."""
    indices = msgspec.structs.replace(robot.indices, epsilon_F=0.0)
    adaptation = default_adaptation(name, epsilon_F=0.0)
    return msgspec.structs.replace(robot, indices=indices), Settings(adaptation=adaptation)


ABLATIONS = {
    "without gravity": without_gravity,
    "with equal radii": with_equal_radii,
    "without epsilon_F": without_creep,
}


def score(job: Job) -> list[Score]:
    """The scores of all variants on a fold, and of those that learn with less known."""
    fold = job.fold
    known, makers = calibrated(job.data, fold)
    log = cut(read_log(job.data / fold.scored.log, known), fold.scored)
    found = [scored(fold, log, known, name, name) for name in job.variants]
    if job.ablation:
        for what, change in ABLATIONS.items():
            for name in ONLINE:
                robot, settings = change(known, name)
                found.append(scored(fold, log, robot, name, f"{name}, {what}", settings))
    if not job.less_known:
        return found
    track = msgspec.structs.replace(known, indices=Indices(eta0=1.0), constant_icr=None)
    found += [scored(fold, log, track, name, f"{name}, nominal track") for name in ONLINE]
    unknown = cut(read_log(job.data / fold.scored.log, makers), fold.scored)
    found += [scored(fold, unknown, makers, name, f"{name}, nothing known") for name in ONLINE]
    return found


def calibrated(data: Path, fold: Fold) -> tuple[Robot, Robot]:
    """The robot as its training logs show it, and as its makers do (both with the latency found)."""
    robot = with_latency(as_made(fold.robot), 0.0)
    late = []
    for piece in fold.training:
        log = cut(read_log(data / piece.log, robot), piece)
        mounting = estimate_mounting(log)
        if log.imu is None or mounting is None:
            raise ValueError(f"{piece.log} has no IMU with accelerometers")
        latency = track_latency(log.tracks, vertical_rate(log.imu, mounting))
        if isinstance(latency, Lag) and not objection(latency):
            late.append(latency.seconds)
    makers = with_latency(robot, float(np.mean(late)) if late else 0.0)
    logs = [cut(read_log(data / piece.log, makers), piece) for piece in fold.training]
    return calibrate(logs, makers).robot, makers


def as_made(name: str) -> Robot:
    """A robot with its makers' geometry, which does not slip, and with an IMU mounted square."""
    robot, (radius, track) = load_robot(name), MAKERS[name]
    vehicle = msgspec.structs.replace(robot.vehicle, sprocket_radius=radius, track_gauge=track)
    roll, pitch, yaw = (90.0 * round(angle / 90.0) for angle in robot.imu.rotation_rpy_deg)
    imu = msgspec.structs.replace(
        robot.imu, rotation_rpy_deg=(roll, pitch, yaw), position=(0.0, 0.0, 0.0), gyro_scale=1.0
    )
    return msgspec.structs.replace(
        robot, vehicle=vehicle, imu=imu, indices=Indices(eta0=1.0), constant_icr=None, soil=Soil()
    )


def with_latency(robot: Robot, seconds: float) -> Robot:
    """The robot whose track speeds are late by so much [s]."""
    tracks = {**robot.log["tracks"], "latency": seconds}
    return msgspec.structs.replace(robot, log={**robot.log, "tracks": tracks})


def cut(log: Log, piece: Piece) -> Log:
    """The part of a log."""
    begin, length = log.start, log.end - log.start
    return log.between(begin + round(piece.begin * length), begin + round(piece.end * length))


def scored(
    fold: Fold, log: Log, robot: Robot, variant: str, who: str, settings: Settings | None = None
) -> Score:
    """Run a variant over a log, and score it."""
    if log.truth is None:
        raise ValueError(f"{log.name} holds no truth")
    blind = replace(log, truth=None)
    reckoned = run(blind, robot, variant, settings=settings).trajectory
    found, truth = reckoned.pose_series, align_truth(log.truth, reckoned).truth.poses
    return Score(
        fold.row,
        fold.scored.label,
        who,
        segments_of(found, truth, log.start),
        motion_nees(blind, PoseEstimator(robot, variant, settings=settings), truth),
    )


def segments_of(
    found: PoseSeries, truth: PoseSeries, start: int
) -> dict[float, tuple[Floats, Floats, Floats]]:
    """Errors [m], distances [m] and blocks of segments, by horizon.

    Args:
        found: estimated poses.
        truth: at the right time and place.
        start: of the log [ns].
    """
    segments = {}
    for horizon in HORIZONS:
        of = drift(found, truth, horizon)
        moved = of.moved
        blocks = np.floor((of.starts[moved] - start) * NANOSECOND / BLOCK)
        segments[horizon] = (of.position_errors[moved], of.distances[moved], blocks)
    return segments


class Reckoner(Protocol):
    """Dead reckoning that is fed one measurement at a time, as a `PoseEstimator`."""

    @property
    def stamp(self) -> int | None:
        """Time of the estimate [ns]."""

    @property
    def pose(self) -> Floats:
        """(3,) pose: x, y [m], yaw [rad]."""

    @property
    def marks(self) -> tuple[int, ...]:
        """Stamps that are marked."""

    def feed(self, measurement: Any, /) -> bool:
        """Update with a measurement."""

    def mark(self, stamp: int) -> int:
        """Remember the present pose."""

    def forget(self, stamp: int) -> None:
        """Forget a mark."""

    def relative_motion(self, stamp: int) -> Any:
        """Motion since a mark, with its covariance."""


def motion_nees(log: Log, estimator: Reckoner, truth: PoseSeries) -> dict[float, Floats]:
    """NEES of motions of each horizon, by the filter's own covariance and the truth's noise.

    Args:
        log: without its truth.
        estimator: a new one.
        truth: at the right time and place.
    """
    wanted: dict[float, list[tuple[Floats, Floats, Floats]]] = {h: [] for h in HORIZONS}
    short, marked, due = [], 0, log.start
    noise_mark: int | None = None
    for measurement in log.measurements():
        estimator.feed(measurement)
        now = estimator.stamp
        if now is None or now < due:
            continue
        if noise_mark is not None:
            short.append(_motion(estimator, noise_mark, truth))
            noise_mark = None
        for mark in list(estimator.marks):
            for horizon in HORIZONS:
                late = (now - mark) * NANOSECOND - horizon
                if 0.0 <= late < NOISE_HORIZON:
                    wanted[horizon].append(_motion(estimator, mark, truth))
            if (now - mark) * NANOSECOND > max(HORIZONS):
                estimator.forget(mark)
        if now - log.start >= marked * MARK_EVERY / NANOSECOND:
            noise_mark = estimator.mark(now)
            marked += 1
        due = now + round(NOISE_HORIZON / NANOSECOND)
    errors = np.array([error for error, _, _ in short if np.isfinite(error).all()])
    # Both ends have half of it.
    noise = 0.5 * np.cov(errors.T, bias=True)
    nees = {}
    for horizon, motions in wanted.items():
        values = []
        for error, covariance, motion in motions:
            if not np.isfinite(error).all() or np.hypot(*motion[:2]) < 0.02 * horizon:
                continue
            by_start = np.eye(3)
            by_start[0, 2], by_start[1, 2] = -motion[1], motion[0]
            turn = np.array(
                [
                    [np.cos(motion[2]), -np.sin(motion[2]), 0.0],
                    [np.sin(motion[2]), np.cos(motion[2]), 0.0],
                    [0.0, 0.0, 1.0],
                ]
            )
            total = covariance + by_start @ noise @ by_start.T + turn @ noise @ turn.T
            values.append(error @ np.linalg.solve(total, error))
        nees[horizon] = np.array(values)
    return nees


def _motion(estimator: Reckoner, mark: int, truth: PoseSeries) -> tuple[Floats, Floats, Floats]:
    """Error (3,), covariance (3, 3) and motion (3,) since a mark; NaN where the truth has a hole."""
    motion = estimator.relative_motion(mark)
    ends = np.array([mark, motion.to_stamp])
    places = np.searchsorted(truth.stamps, ends)
    nowhere = np.full(3, np.nan)
    if places[0] == 0 or places[1] >= len(truth.stamps):
        return nowhere, motion.covariance, motion.pose
    around = truth.stamps[places[0] - 1 : places[1] + 1]
    if np.diff(around).max() * NANOSECOND > 1.0:
        return nowhere, motion.covariance, motion.pose
    start, end = interpolate_poses(truth, ends)
    error = motion.pose - relative(start, end)
    error[2] = np.angle(np.exp(1j * error[2]))
    return error, motion.covariance, motion.pose


class Pooled(NamedTuple):
    """Summed errors over summed distances with its interval [%], and the mean NEES."""

    percent: float
    low: float
    high: float
    nees: float


def pooled(scores: Iterable[Score], horizon: float) -> Pooled:
    """Of several logs, drawn anew by blocks."""
    scores = list(scores)
    sums = []
    for one in scores:
        errors, distances, blocks = one.segments[horizon]
        sums += [
            (errors[blocks == block].sum(), distances[blocks == block].sum())
            for block in np.unique(blocks)
        ]
    percent, low, high = (100.0 * one for one in bootstrap(ratio_of_sums, np.array(sums), DRAWS))
    nees = np.concatenate([one.nees[horizon] for one in scores])
    return Pooled(percent, low, high, float(nees.mean()) if len(nees) else float("nan"))


class Ratio(NamedTuple):
    """Errors over those of another filter on the same segments, with its interval [-]."""

    ratio: float
    low: float
    high: float


def paired(scores: Iterable[Score], others: Iterable[Score], horizon: float) -> Ratio:
    """Of several logs, drawn anew by blocks.

    Args:
        scores: of a filter.
        others: of the one that it is compared with, log by log.
        horizon: of the segments [s].
    """
    sums = []
    for one, other in zip(scores, others, strict=True):
        errors, _, blocks = one.segments[horizon]
        errors_of_other = other.segments[horizon][0]
        # Lag and lever arm, found for each filter, may let one segment more or less of the truth in.
        count = min(len(errors), len(errors_of_other))
        sums += [
            (errors[:count][at].sum(), errors_of_other[:count][at].sum())
            for at in (blocks[:count] == block for block in np.unique(blocks[:count]))
        ]
    return Ratio(*bootstrap(ratio_of_sums, np.array(sums), DRAWS))


def results_of(scores: list[Score]) -> dict[str, Any]:
    """Rows (each log, each robot and ground, all) -> filter -> horizon -> figures."""
    rows: dict[str, list[Score]] = {}
    for one in scores:
        for row in (one.log, one.row, "all logs"):
            rows.setdefault(row, []).append(one)
    names = list(dict.fromkeys(one.who for one in scores))

    def figures(some: list[Score], name: str, horizon: float) -> dict[str, float]:
        own = [one for one in some if one.who == name]
        found = pooled(own, horizon)._asdict()
        for name_of_reference in REFERENCES:
            reference = [one for one in some if one.who == name_of_reference]
            if reference:
                ratio = paired(own, reference, horizon)._asdict()
                found |= {f"{key}_of_{name_of_reference}": value for key, value in ratio.items()}
        return found

    return {
        row: {
            name: {f"{horizon:.0f}s": figures(some, name, horizon) for horizon in HORIZONS}
            for name in names
        }
        for row, some in rows.items()
    }


def show(results: dict[str, Any]) -> None:
    """Print the tables."""

    def figure(of: dict[str, Any]) -> str:
        thirty, ten = of["30s"], of["10s"]
        return f"{thirty['percent']:.2f} ({ten['percent']:.2f})"

    def interval(of: dict[str, Any]) -> str:
        thirty, ten = of["30s"], of["10s"]
        return (
            f"{thirty['low']:.2f} to {thirty['high']:.2f} ({ten['low']:.2f} to {ten['high']:.2f})"
        )

    def ratio(of: dict[str, Any], reference: str) -> str:
        thirty = of["30s"]
        value, low, high = (thirty[f"{key}_of_{reference}"] for key in Ratio._fields)
        return f"{value:.2f} ({low:.2f} to {high:.2f})"

    variants = [name for name in results["all logs"] if name in VARIANTS]
    order = [*dict.fromkeys(fold.scored.label for fold in folds()), *GOALS, "all logs"]
    rows = [row for row in order if row in results]
    table(
        ["% after 30 s (10 s)", *variants, "goal"],
        ([row, *(figure(results[row][name]) for name in variants), _goal(row)] for row in rows),
    )
    print()
    pools = [row for row in rows if row in GOALS or row == "all logs"]
    table(
        ["95 % intervals", *variants],
        ([row, *(interval(results[row][name]) for name in variants)] for row in pools),
    )
    print()
    for reference in REFERENCES:
        if reference in variants:
            table(
                [f"30 s, ratio to {reference}", *variants],
                (
                    [row, *(ratio(results[row][name], reference) for name in variants)]
                    for row in pools
                ),
            )
            print()
    others = [name for name in results["all logs"] if name not in VARIANTS]
    table(
        ["less known, or less used", *others],
        ([row, *(figure(results[row][name]) for name in others)] for row in pools),
    )
    print()
    table(
        ["NEES of motions (3)", *variants],
        (
            [
                row,
                *(
                    f"{results[row][name]['30s']['nees']:.1f} ({results[row][name]['10s']['nees']:.1f})"
                    for name in variants
                ),
            ]
            for row in pools
        ),
    )


def _goal(row: str) -> str:
    thirty, ten = GOALS.get(row, (None, None))
    if thirty is None:
        return ""
    return f"{thirty:.1f}" + (f" ({ten:.1f})" if ten is not None else "")


def differences(results: dict[str, Any], baseline: dict[str, Any]) -> list[str]:
    """What is not as in the baseline, by more than rounding."""
    found = []
    for row, filters in baseline.items():
        for name, of in filters.items():
            for horizon, figures in of.items():
                now = results.get(row, {}).get(name, {}).get(horizon, {}).get("percent")
                before = figures["percent"]
                if now is None or not abs(now - before) <= ROUNDING:
                    found.append(f"{row}, {name}, {horizon}: {before:.3f} % before, now {now}")
    return found


def _rounded(value: Any) -> Any:
    """Figures to four decimals, so that a new baseline differs where results do."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return value if isinstance(value, str | int) else round(float(value), 4)


def main() -> None:
    """Print the tables; write or check the baseline."""
    parser = data_parser(__doc__)
    parser.add_argument("--write", type=Path, help="write the figures as the baseline")
    parser.add_argument("--check", type=Path, help="compare the figures with the baseline")
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--ablation", action="store_true", help="leave out one part at a time")
    arguments = parser.parse_args()
    jobs = [
        Job(arguments.data, fold, tuple(arguments.variants), ablation=arguments.ablation)
        for fold in folds()
    ]
    scores = [one for some in spread(score, jobs, arguments.workers) for one in some]
    results = results_of(scores)
    show(results)
    if arguments.write:
        text = json.dumps(_rounded(results), indent=1)
        arguments.write.write_text(f"{text}\n", encoding="utf-8")
    if arguments.check:
        found = differences(results, json.loads(arguments.check.read_text(encoding="utf-8")))
        for line in found:
            print(line, file=sys.stderr)
        if found:
            sys.exit(f"{len(found)} figures are not those of {arguments.check}")


if __name__ == "__main__":
    main()
