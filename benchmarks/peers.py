"""icreckon beside what people use: the same logs, the same knowledge, noise tuned for all.

    python benchmarks/peers.py DATA [--workers N]

DATA is the folder of the sample logs. Folds and calibration are those of `accuracy.py`: radii, effective
track, mounting, latency, scale and bias of the gyro are calibrated on other logs of the same robot, and
given to all. GTSAM comes with `pip install gtsam`; without it its rows are left out.

- integration: wheels and gyro, its bias the mean of the newest rest
- filterpy: its EKF of x, y, yaw, speed, yaw rate and gyro bias (robot_localization in the plane)
- GTSAM: wheels and gyro preintegrated over 0.2 s, bias at rest, fixed-lag smoother of 2 s

The last two have error densities of the motion that are tuned on the training logs until the NEES of
motions over 10 s is 3. Drift is the position error after 30 s (10 s) over the distance [%], with 95 %
bootstrap intervals over blocks of 60 s. Lag and lever arm of the truth are found by the estimator, for
the peers by `gyro`. Time is that of an IMU sample with its track speeds, in one
process; the ratio is to integration.

Faults are put in every 30 s of each log while it drives. The error is that of the motion from the start
of the fault to 1 s after its end, against the same estimator without it; survived: less than 0.3 m, in %
of the faults. `covered`: less than three own standard deviations.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _peers import FilterpyEkf, GtsamSmoother, Integration, Noise, PeerEstimator
from _study import data_parser, spread, table
from accuracy import (
    HORIZONS,
    Fold,
    Piece,
    Reckoner,
    Score,
    calibrated,
    cut,
    folds,
    motion_nees,
    pooled,
    segments_of,
)

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import relative
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ImuSample, Measurement, TrackSpeeds
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run
from icreckon.replay.comparison.truth_alignment import align_truth
from icreckon.replay.reading.read_log import read_log

PEERS = ("integration", "filterpy", *(("GTSAM",) if find_spec("gtsam") else ()))
OURS = ("gyro", "constant-online", "full-linear", "inertia-online")
START = Noise(0.02, 0.005)
TUNED_AT, ROUNDS = 10.0, 3
EVERY, AFTER = 30.0, 1.0
SURVIVED = 0.3
SECOND = 1_000_000_000
# Speed of a track of a robot that drives [m/s].
DRIVES = 0.1


class Fault(NamedTuple):
    """A fault.

    Attributes:
        lasts: its duration [s].
        put: the measurement in its place, or None.
    """

    lasts: float
    put: Callable[[Measurement], Measurement | None]


def _stuck_gyro(m: Measurement) -> Measurement:
    if isinstance(m, ImuSample):
        return replace(m, angular_velocity=(0.0, 0.0, 2.0))
    return m


def _spinning(m: Measurement) -> Measurement:
    if isinstance(m, TrackSpeeds):
        return replace(m, left=m.left + 0.8)
    return m


def _silent(m: Measurement) -> Measurement | None:
    return None if isinstance(m, TrackSpeeds) else m


FAULTS = {
    "gyro reads 2 rad/s for 1 s": Fault(1.0, _stuck_gyro),
    "left track +0.8 m/s for 3 s": Fault(3.0, _spinning),
    "no track speeds for 3 s": Fault(3.0, _silent),
}


class Result(NamedTuple):
    """One estimator on one fold.

    Attributes:
        score: drift and NEES.
        microseconds: time of an IMU sample with its track speeds.
        faults: (n, 2) error [m] and own standard deviation [m] of each, by fault.
    """

    score: Score
    microseconds: float
    faults: dict[str, Floats]


def make(name: str, robot: Robot, noise: Noise) -> Reckoner:
    """Make an estimator by its name in the tables."""
    if name in OURS:
        return PoseEstimator(robot, name)
    bias, sigma = robot.imu.gyro_bias, max(robot.imu.gyro_bias_sigma, 1e-5)
    density = robot.imu.gyro_noise_density**2
    if name == "integration":
        return PeerEstimator(Integration(bias), robot)
    if name == "filterpy":
        return PeerEstimator(FilterpyEkf(bias, sigma, noise, density), robot)
    return PeerEstimator(GtsamSmoother(bias, sigma, noise, density), robot)


def path_of(log: Log, estimator: Reckoner) -> PoseSeries:
    """Feed a log, and record the poses at its track speeds."""
    stamps, poses = [], []
    for measurement in log.measurements():
        estimator.feed(measurement)
        if isinstance(measurement, ImuSample) and estimator.stamp == measurement.stamp:
            stamps.append(measurement.stamp)
            poses.append(estimator.pose.copy())
    return PoseSeries(np.array(stamps), np.array(poses))


def tuned(name: str, robot: Robot, logs: list[Log], truths: list[PoseSeries]) -> Noise:
    """Noise at which the NEES of motions on the training logs is 3; their truths are aligned."""
    noise = START
    if name not in ("filterpy", "GTSAM"):
        return noise
    for _ in range(ROUNDS):
        found = [
            motion_nees(replace(log, truth=None), make(name, robot, noise), truth)
            for log, truth in zip(logs, truths, strict=True)
        ]
        noise = noise.scaled(float(np.mean(np.concatenate([one[TUNED_AT] for one in found]))) / 3.0)
    return noise


def aligned(log: Log, robot: Robot, variant: str = "gyro") -> PoseSeries:
    """Truth at the time and place of a robot's base_link, which a variant finds."""
    if log.truth is None:
        raise ValueError(f"{log.name} holds no truth")
    return align_truth(
        log.truth, run(replace(log, truth=None), robot, variant).trajectory
    ).truth.poses


def over_faults(name: str, robot: Robot, log: Log, noise: Noise, fault: Fault) -> Floats:
    """Error and own standard deviation (n, 2) of motions over faults [m]."""
    found = []
    for begin in _moments(log, fault.lasts):
        end, stop = (
            begin + round(some / NANOSECOND) for some in (fault.lasts, fault.lasts + AFTER)
        )
        # Enough for every estimator to have learnt what it needs.
        part = log.between(begin - round(25.0 / NANOSECOND), stop)
        motions = []
        for faulty in (False, True):
            estimator = make(name, robot, noise)
            for measurement in part.measurements():
                at = measurement.stamp
                if at >= begin and not estimator.marks and estimator.stamp is not None:
                    estimator.mark(estimator.stamp)
                put = fault.put(measurement) if faulty and begin <= at < end else measurement
                if put is not None:
                    estimator.feed(put)
            if estimator.marks:
                motions.append(estimator.relative_motion(estimator.marks[0]))
        if len(motions) < 2:
            # The log begins, or has a hole, just before.
            continue
        off = relative(motions[0].pose, motions[1].pose)[:2]
        sigma = float(np.sqrt(np.trace(motions[1].covariance[:2, :2])))
        found.append((float(np.hypot(*off)), sigma))
    return np.array(found).reshape(-1, 2)


def _moments(log: Log, lasts: float) -> Iterator[int]:
    """Stamps at which a driving robot gets a fault."""
    size = np.abs(log.tracks.speeds).max(axis=1)
    at = log.start + round(EVERY / NANOSECOND)
    while at + round((lasts + AFTER + 1.0) / NANOSECOND) < log.end:
        around = np.searchsorted(
            log.tracks.stamps, [at - SECOND, at + round(lasts / NANOSECOND) + 2 * SECOND]
        )
        whole = np.diff(log.tracks.stamps[slice(*around)]).max(initial=0) < SECOND
        if whole and np.interp(at, log.tracks.stamps, size) > DRIVES:
            yield at
        at += round(EVERY / NANOSECOND)


class Job(NamedTuple):
    """A fold, with the folder of the logs."""

    data: Path
    fold: Fold


def results_of(job: Job) -> dict[str, Result]:
    """All estimators on one fold."""
    fold, found = job.fold, {}
    robot = calibrated(job.data, fold)[0]

    def read(piece: Piece) -> Log:
        return cut(read_log(job.data / piece.log, robot), piece)

    log, training = read(fold.scored), [read(piece) for piece in fold.training]
    blind, truths = replace(log, truth=None), [aligned(one, robot) for one in training]
    for name in (*PEERS, *OURS):
        noise = tuned(name, robot, training, truths)
        begin = time.perf_counter()
        path = path_of(blind, make(name, robot, noise))
        spent = time.perf_counter() - begin
        truth = aligned(log, robot, name if name in OURS else "gyro")
        segments = segments_of(path, truth, log.start)
        nees = motion_nees(blind, make(name, robot, noise), truth)
        score = Score(fold.row, fold.scored.label, name, segments, nees)
        faults = {
            what: over_faults(name, robot, blind, noise, fault) for what, fault in FAULTS.items()
        }
        found[name] = Result(score, 1e6 * spent / len(path.stamps), faults)
    return found


def show(results: list[dict[str, Result]]) -> None:
    """Print the tables."""
    names = list(results[0])
    plain = np.mean([one["integration"].microseconds for one in results])
    rows = []
    for name in names:
        scores = [one[name].score for one in results]
        cells = []
        for horizon in HORIZONS:
            of = pooled(scores, horizon)
            nees = "" if np.isnan(of.nees) else f"{of.nees:.1f}"
            cells += [f"{of.percent:.2f} ({of.low:.2f} to {of.high:.2f})", nees]
        spent = float(np.mean([one[name].microseconds for one in results]))
        rows.append([name, *cells, f"{spent:.0f}", f"{spent / plain:.1f}"])
    heads = [
        f"{head} {horizon:.0f} s" for horizon in HORIZONS for head in ("drift % after", "NEES (3),")
    ]
    table(["estimator", *heads, "time of a sample, µs", "ratio"], rows)
    print()
    rows = []
    for name in names:
        row = [name]
        for what in FAULTS:
            of_all = np.concatenate([one[name].faults[what] for one in results])
            error, sigma = of_all.T
            own = "" if np.isnan(sigma).any() else f"{100.0 * np.mean(error < 3.0 * sigma):.0f}"
            row += [
                f"{np.sqrt(np.mean(error**2)):.2f}",
                f"{100.0 * np.mean(error < SURVIVED):.0f}",
                own,
            ]
        rows.append(row)
    heads = [head for what in FAULTS for head in (f"{what}: RMS m", "survived %", "covered %")]
    table(["estimator", *heads], rows)
    counts = {what: sum(len(one[names[0]].faults[what]) for one in results) for what in FAULTS}
    print("\nfaults: " + ", ".join(f"{count} x {what}" for what, count in counts.items()))


def main() -> None:
    """Print the tables."""
    parser = data_parser(__doc__)
    given = parser.parse_args()
    if "GTSAM" not in PEERS:
        print("GTSAM is left out: pip install gtsam\n")
    show(spread(results_of, [Job(given.data, fold) for fold in folds()], given.workers))


if __name__ == "__main__":
    main()
