"""Real logs of the scoreboard: blind folds by accuracy.py; false alarms; turning predicted by the tracks.

BorealTC has no truth. The IMU is silent for two seconds of every ten: the turning predicted by the tracks
is compared with that of the gyro. NEES is over three degrees of freedom (1 is ideal).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import accuracy
import msgspec
import numpy as np
import pyarrow.parquet as pq
from _logs import LOGS
from _scoreboard_cells import Job, data_folder, excluded, flags, interval_of_ratio, rules_disabled

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Imu, Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.reading.read_log import read_log

SECOND = 1_000_000_000
FOLD, HEALTH, BOREAL = "fold", "health", "borealtc"
GROUNDS = ("asphalt", "flooring", "ice")
WITHOUT_TRACKS = "wetexplorer"
EVERY, SILENT = 10.0, 2.0
"""The IMU is silent for the last seconds of each such span [s]."""
LEAST_SPEED = 0.1
"""Speed of a track below which a span is left out [m/s]."""


def jobs(variants: tuple[str, ...], without: tuple[str, ...]) -> Iterator[Job]:
    """Jobs: the folds, the logs, and the runs of BorealTC by ground."""
    if not data_folder():
        return
    for k, _ in enumerate(accuracy.folds()):
        yield Job("real", FOLD, k, variants, without)
    for ground in GROUNDS:
        for k, _ in enumerate(tables(ground)):
            yield Job("real", f"{BOREAL} {ground}", k, variants, without)
    for name, robot in LOGS.items():
        if robot != WITHOUT_TRACKS:
            yield Job("real", f"{HEALTH} {name}", 0, variants, without)


def score(job: Job) -> Any:
    """Scores of a fold, or the health of a log."""
    kind, _, name = job.cell.partition(" ")
    folder = Path(data_folder())
    with rules_disabled(job.without):
        if kind == FOLD:
            fold = accuracy.folds()[job.run]
            scores = accuracy.score(accuracy.Job(folder, fold, job.variants, less_known=False))
            return [_plain(one) for one in scores]
        if kind == HEALTH:
            robot = load_robot(LOGS[name])
            log = read_log(folder / name, robot)
        else:
            log, robot = boreal(tables(name)[job.run])
        found = {variant: health_of(log, robot, variant) for variant in job.variants}
        if kind == BOREAL:
            for variant in job.variants:
                found[variant]["turns"] = predicted_turns(log, robot, variant)
        return found


def _plain(one: accuracy.Score) -> dict[str, Any]:
    """A score as JSON can hold it."""
    segments = {
        str(horizon): [part.tolist() for part in parts] for horizon, parts in one.segments.items()
    }
    nees = {str(horizon): values.tolist() for horizon, values in one.nees.items()}
    return {"row": one.row, "log": one.log, "who": one.who, "segments": segments, "nees": nees}


def _score(one: dict[str, Any]) -> accuracy.Score:
    """The score that `_plain` was made of."""
    segments = {
        float(horizon): tuple(np.array(part) for part in parts)
        for horizon, parts in one["segments"].items()
    }
    nees = {float(horizon): np.array(values) for horizon, values in one["nees"].items()}
    return accuracy.Score(one["row"], one["log"], one["who"], segments, nees)  # type: ignore[arg-type]


def tables(ground: str) -> list[Path]:
    """Runs of BorealTC on a ground."""
    return sorted((Path(data_folder()) / BOREAL).glob(f"{ground}_*.parquet"))


@cache
def boreal_robot() -> Robot:
    """The Husky of BorealTC: the shipped one with an IMU that is mounted square."""
    robot = load_robot("husky")
    noise = robot.imu.gyro_noise_density, robot.imu.accelerometer_noise_density
    imu = Imu(gyro_noise_density=noise[0], accelerometer_noise_density=noise[1])
    return msgspec.structs.replace(robot, name=BOREAL, imu=imu)


def boreal(path: Path) -> tuple[Log, Robot]:
    """Log of a run of BorealTC."""
    table = pq.read_table(path).to_pydict()
    columns = {name: np.array(values, dtype=float) for name, values in table.items()}
    stamps = 1_700_000_000 * SECOND + np.round(columns["time_s"] * SECOND).astype(np.int64)
    moved = np.isfinite(columns["left_m_s"]) & np.isfinite(columns["right_m_s"])
    sensed = np.isfinite(columns["gyro_z"]) & np.isfinite(columns["acc_z"])
    speeds = np.stack([columns["left_m_s"], columns["right_m_s"]], axis=1)
    rates, forces = (
        np.stack([columns[f"{name}_{axis}"] for axis in "xyz"], axis=1) for name in ("gyro", "acc")
    )
    return Log(
        name=path.stem,
        tracks=TrackSpeedSeries(stamps[moved], speeds[moved]),
        imu=ImuSeries(stamps[sensed], rates[sensed], forces[sensed]),
    ), boreal_robot()


def health_of(log: Log, robot: Robot, variant: str) -> dict[str, Any]:
    """Exclusions and flags of a variant in a log whose sensors are taken to be healthy."""
    estimator = PoseEstimator(robot, variant, settings=Settings(history=0.0))
    for measurement in log.measurements():
        estimator.feed(measurement)
    health = estimator.health
    rules, gates = excluded(health)
    return {
        "rules": rules,
        "gates": gates,
        "flags": flags(health),
        "hours": log.duration / 3600.0,
        "readings": 0 if log.imu is None else len(log.imu.stamps),
    }


def predicted_turns(log: Log, robot: Robot, variant: str) -> list[tuple[float, float]]:
    """Turning over `SILENT` that the tracks predict less that of the gyro, and the latter [rad]."""
    imu = log.imu
    if imu is None or imu.linear_acceleration is None:
        raise ValueError(f"{log.name} has no IMU")
    since = (imu.stamps - log.start) / SECOND % EVERY
    heard = since < EVERY - SILENT
    part = replace(
        log,
        imu=ImuSeries(
            imu.stamps[heard], imu.angular_velocity[heard], imu.linear_acceleration[heard]
        ),
    )
    estimator = PoseEstimator(robot, variant, settings=Settings(history=0.0))
    begin, found = (log.start, 0.0), []
    silent = False
    for measurement in part.measurements():
        now = (measurement.stamp - log.start) / SECOND % EVERY >= EVERY - SILENT
        if silent and not now and estimator.stamp is not None:
            turned = float(estimator.pose[2]) - begin[1]
            measured = turn_of_gyro(imu, begin[0], estimator.stamp, estimator.biases)
            at = (log.tracks.stamps >= begin[0]) & (log.tracks.stamps <= estimator.stamp)
            fast = at.any() and np.abs(log.tracks.speeds[at]).max(axis=1).mean() > LEAST_SPEED
            if fast and estimator.stamp - begin[0] > 0.5 * SILENT * SECOND:
                found.append((turned - measured, measured))
        silent = now
        estimator.feed(measurement)
        if not silent and estimator.stamp is not None:
            begin = estimator.stamp, float(estimator.pose[2])
    return found


def turn_of_gyro(imu: ImuSeries, begin: int, end: int, biases: dict[str, float]) -> float:
    """Turning between two stamps by an IMU that is mounted square [rad]."""
    grid = np.linspace(begin, end, 201)
    rates = np.interp(grid, imu.stamps, imu.angular_velocity[:, 2])
    bias = next((value for name, value in biases.items() if "gyro" in name and "bias" in name), 0.0)
    return float(np.mean(rates - bias) * (end - begin) / SECOND)


def summary(results: list[tuple[Job, Any]]) -> dict[str, Any]:
    """Figures by "drift | row of accuracy.py", "borealtc ground" and "health log"; then by variant."""
    scores = [_score(one) for job, some in results if job.cell == FOLD for one in some]
    found: dict[str, Any] = {}
    runs: dict[str, list[Any]] = {}
    for job, result in results:
        if job.cell != FOLD:
            runs.setdefault(job.cell, []).append(result)
    if scores:
        for row, by_variant in accuracy.results_of(scores).items():
            found[f"drift | {row}"] = {
                variant: _drift(figures["30s"]) for variant, figures in by_variant.items()
            }
    for cell, of_cell in runs.items():
        found[cell] = {
            variant: _health([one[variant] for one in of_cell]) for variant in of_cell[0]
        }
    return found


def _drift(figures: dict[str, float]) -> dict[str, float | None]:
    """Figures of 30 s, named as those of healthy drives."""
    names = {"percent": "drift", "low": "drift_low", "high": "drift_high", "nees": "nees"}
    names |= {"ratio_of_gyro": "ratio", "low_of_gyro": "ratio_low", "high_of_gyro": "ratio_high"}
    found = {name: figures.get(key) for key, name in names.items()}
    return found | {"nees": figures["nees"] / 3.0}


def _health(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Exclusions, flags and predicted turning of some logs."""
    readings = sum(one["readings"] for one in runs)
    total = {key: sum(one["flags"][key] for one in runs) for key in runs[0]["flags"]}
    found: dict[str, Any] = {
        "runs": len(runs),
        "hours": sum(one["hours"] for one in runs),
        "rules_percent": 100.0 * sum(sum(one["rules"].values()) for one in runs) / readings,
        "gates_percent": 100.0 * sum(sum(one["gates"].values()) for one in runs) / readings,
        "rules": sorted({key for one in runs for key in one["rules"]}),
        "flags": {key: value for key, value in total.items() if value},
    }
    if "turns" in runs[0]:
        squares: list[Floats] = [np.array(one["turns"]).reshape(-1, 2) ** 2 for one in runs]
        counts = np.array([len(one) for one in squares], dtype=float)
        for k, name in enumerate(("turn_error", "turn")):
            sums = np.array([one[:, k].sum() for one in squares])
            of = interval_of_ratio(sums, counts)
            keys = (name, f"{name}_low", f"{name}_high")
            found |= {
                key: float(np.degrees(np.sqrt(one)) / SILENT)
                for key, one in zip(keys, of, strict=True)
            }
    return found
