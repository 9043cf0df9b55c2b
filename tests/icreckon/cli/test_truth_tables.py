"""Truth in tables: one lag for all commands, or none with a reason; yaw that is none is not scored."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from command_line import succeeds
from conftest import thorough
from icreckon import Log, PoseSeries, Scenario, simulate
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, load_robot
from small_robot import COLUMNS

ALPHA = load_robot("auriga-alpha")
VARIANT = "constant-online"


@pytest.fixture(scope="module")
def log() -> Log:
    how = {"trajectory": "aggressive", "fix_rate": 0.0, "truth": "kinematic"}
    return simulate(Scenario(duration=90.0, seed=5, **how), ALPHA)


def late(log: Log, seconds: float, yaw: str = "true") -> Log:
    """The log with a truth at 10 Hz that is late, with noise, and perhaps with a yaw that is none."""
    rng = np.random.default_rng(4)
    stamps, poses = log.truth.poses.stamps, log.truth.poses.poses
    every = max(1, round(1e8 / np.median(np.diff(stamps))))
    stamps, poses = stamps[::every], poses[::every].copy()
    poses += rng.normal(0.0, [0.01, 0.01, 0.003], poses.shape)
    if yaw == "random":
        poses[:, 2] = rng.uniform(-np.pi, np.pi, len(poses))
    elif yaw != "true":
        poses[:, 2] = float(yaw)
    moved = PoseSeries(stamps + round(seconds * 1e9), poses)
    return replace(log, truth=replace(log.truth, poses=moved))


def table(log: Log, path: Path) -> tuple[str, ...]:
    """Write a log as a table, a row for each sample; the words that name it for a command."""
    parts = (
        (log.tracks.stamps, ("left", "right"), log.tracks.speeds),
        (log.imu.stamps, ("gx", "gy", "gz"), log.imu.angular_velocity),
        (log.imu.stamps, ("ax", "ay", "az"), log.imu.linear_acceleration),
        (log.truth.poses.stamps, ("truth_x", "truth_y", "truth_yaw"), log.truth.poses.poses),
    )
    stamps = np.unique(np.concatenate([own for own, _, _ in parts]))
    columns = {"t": pa.array(stamps)}
    for own, names, values in parts:
        rows = np.full((len(stamps), len(names)), np.nan)
        rows[np.searchsorted(stamps, own)] = values
        for name, column in zip(names, rows.T, strict=True):
            columns[name] = pa.array(column, from_pandas=True)
    if path.suffix == ".csv":
        pyarrow.csv.write_csv(pa.table(columns), path)
    else:
        pyarrow.parquet.write_table(pa.table(columns), path)
    robot = path.with_suffix(".toml")
    text = (ROBOTS_FOLDER / "auriga-alpha.toml").read_text(encoding="utf-8")
    columns = COLUMNS.replace('time_unit = "s"', 'time_unit = "ns"')
    robot.write_text(text[: text.index("[log.fixes]")] + columns, encoding="utf-8")
    return str(path), "--robot", str(robot)


def replayed(words: tuple[str, ...], cwd: Path):
    done = succeeds("replay", *words, "--variants", VARIANT, "--json", cwd=cwd)
    return json.loads(done.stdout)


def inspected(words: tuple[str, ...], cwd: Path) -> str:
    done = succeeds("inspect", words[0], cwd=cwd)
    return " ".join(done.stdout.split())


@pytest.mark.parametrize("yaw", [thorough("true"), "0.0"], ids=["headings", "positions"])
def test_all_commands_find_the_same_lag(log: Log, yaw: str, tmp_path: Path) -> None:
    words = table(late(log, 0.35, yaw), tmp_path / "run.parquet")
    truth = replayed(words, tmp_path)["truth"]
    done = succeeds("calibrate", *words, "--models", "constant", "--json", cwd=tmp_path)
    (of_log,) = json.loads(done.stdout)["logs"]
    text = inspected(words, tmp_path).split("truth: stamps lag ")[1].split(" by ", 1)[1]
    # Positions are late against the tracks, too, which the body follows 0.045 s later.
    lag = 0.35 if yaw == "true" else 0.395
    for seconds, sigma in (
        (truth["lag_s"], truth["lag_sigma_s"]),
        (of_log["truth_lag_s"], of_log["truth_lag_sigma_s"]),
        (float(text.split()[0]), float(text.split("(± ")[1].split(")")[0])),
    ):
        assert sigma < 0.05
        assert seconds == pytest.approx(lag, abs=0.015)
