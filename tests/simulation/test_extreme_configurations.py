"""Every number of robot, scenario and study files at its limits: refused by its name, or harmless."""

import tomllib
import warnings
from collections.abc import Iterator
from pathlib import Path as File
from typing import Any

import msgspec
import numpy as np
import pytest

from bag_messages import VEHICLE
from extreme_numbers import EXTREMES, Path, number_paths, shown, with_number
from icreckon.estimator.base.checks import LARGEST_NUMBER, LEAST_POSITIVE
from icreckon.estimator.base.config import convert
from icreckon.estimator.base.errors import EstimatorError, IcreckonError
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.run import run
from icreckon.estimator.streaming.warm_up import READY
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.mapping.topics import TopicMap
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.drives.trajectories import trajectory_names, trajectory_options
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import Study

VALUES = (
    *EXTREMES,
    *(sign * size for size in (LARGEST_NUMBER, 100.0) for sign in (1.0, -1.0)),
    LEAST_POSITIVE,
    10**30,
)
VARIANT = "inertia-online"
ROBOT = tomllib.loads((ROBOTS_FOLDER / "auriga-alpha.toml").read_text(encoding="utf-8"))
ROBOT |= {"constant_icr": {"x_ICRl": -1.0, "x_ICRr": 1.0}}
ROBOT.pop("log", None)
SCENARIO = {
    "duration": 2.5,
    "imu_rate": 50.0,
    "track_rate": 20.0,
    "truth_rate": 20.0,
    "terrain": {"rolling_deg": 1.0, "kerb_height": 0.05},
    "patches": [{"friction": 0.5, "x": [0.0, 1.0], "y": [0.0, 1.0], "time": [0.0, 1.0]}],
    "payloads": [{"time": [1.0, 2.0], "mass": 5.0}],
    "outages": [[1.0, 2.0]],
    "encoders": {"dropouts_per_hour": 3000.0, "dropout_duration": 0.1},
    "gyro": {"bias_instability": 1e-4},
    "fixes": {"outlier_share": 0.1, "outlier_sigma": 1.0, "wander_sigma": 1.0, "wander_time": 10.0},
}
STUDY = {
    "name": "s",
    "horizons": [1.0],
    "sweep": {"latin": {"points": 2, "ranges": {"gyro.noise_density": [1e-4, 1e-3]}}},
}
LOGGED: dict[str, Any] = {
    "columns": {
        "time": "t",
        "tracks": {"left": ["l"], "right": ["r"]},
        "imu": {"angular_velocity": ["h"]},
        "fixes": {"x": "x", "y": "y", "position_sigma": 1.0},
        "heading": {"yaw": "h", "sigma": 0.1},
        "truth": {"x": "x", "y": "y"},
    }
}
# Fields whose errors have another name.
NAMED = {
    "duration": "the run of",
    "outages": "an outage",
    "horizons": "a horizon",
    "points": "points of a latin",
}


def refused(problem: IcreckonError, words: str) -> None:
    """Check an error: one line that holds some words."""
    assert words in str(problem)
    assert "\n" not in str(problem)


def accepted(
    data: dict[str, Any], path: Path, kind: Any, error: type[IcreckonError]
) -> Iterator[tuple[float, Any]]:
    """Each value that is accepted at a path, with the configuration; all others name the field."""
    (*_, leaf) = (key for key in path if isinstance(key, str))
    for value in VALUES:
        try:
            yield value, convert(with_number(data, path, value), kind, "file", error)
        except error as problem:
            refused(problem, "file: ")
            if leaf not in str(problem):
                refused(problem, NAMED.get(leaf, leaf))


@pytest.fixture(scope="module")
def log() -> Log:
    scenario = Scenario(duration=2.0, seed=3, imu_rate=50.0, track_rate=20.0)
    return simulate(scenario, load_robot("auriga-alpha"))


def check_run(log: Log, robot: Robot, variant: str, settings: Settings | None = None) -> None:
    found = run(log, robot, variant, settings=settings).trajectory
    assert np.isfinite(found.poses).all()
    assert np.isfinite(found.pose_covariances).all()


ROBOT_PATHS = [path for path in number_paths(Robot, name=VARIANT) if path != ("format",)]


@pytest.mark.parametrize("path", ROBOT_PATHS, ids=shown)
def test_robot_files(log: Log, path: Path) -> None:
    for _, robot in accepted(ROBOT, path, Robot, EstimatorError):
        check_run(log, robot, VARIANT)


@pytest.mark.parametrize("path", [*number_paths(Settings)], ids=shown)
def test_settings(log: Log, path: Path) -> None:
    robot = convert(ROBOT, Robot, "file", EstimatorError)
    data = {"wander": {"sigma": 1.0, "time": 10.0}}
    for _, settings in accepted(data, path, Settings, EstimatorError):
        # The first filter of a process is warmed up.
        READY.clear()
        check_run(log, robot, VARIANT, settings)


def check_scenario(scenario: Scenario) -> None:
    try:
        log = simulate(scenario, load_robot("auriga-alpha"))
    except SimulationError as problem:
        refused(problem, "")
        return
    assert np.isfinite(log.tracks.speeds).all()
    assert np.isfinite(log.imu.angular_velocity).all()
    assert np.isfinite(log.imu.linear_acceleration).all()
    assert np.isfinite(log.truth.poses.poses).all()


SCENARIO_PATHS = [path for path in number_paths(Scenario) if path[0] != "trajectory_options"]


@pytest.mark.parametrize("path", SCENARIO_PATHS, ids=shown)
def test_scenario_files(path: Path) -> None:
    for _, scenario in accepted(SCENARIO, path, Scenario, SimulationError):
        check_scenario(scenario)


@pytest.mark.parametrize("name", trajectory_names())
def test_options_of_trajectories(tmp_path: File, name: str) -> None:
    data = {**SCENARIO, "trajectory": name}
    if name == "recorded":
        data["trajectory_file"] = str(tmp_path / "drive.csv")
        (tmp_path / "drive.csv").write_text("t,left,right\n0,0,0\n1,0.5,0.4\n2,0.1,0.5\n")
    for option in trajectory_options(name):
        path = ("trajectory_options", option)
        for _, scenario in accepted(data, path, Scenario, SimulationError):
            check_scenario(scenario)


STUDY_PATHS = [path for path in number_paths(Study) if path[0] != "scenario"]
RANGE = ("sweep", "latin", "ranges", "gyro.noise_density")


@pytest.mark.parametrize("path", [*STUDY_PATHS, (*RANGE, 0), (*RANGE, 1)], ids=shown)
def test_study_files(path: Path) -> None:
    for _, study in accepted(STUDY, path, Study, SimulationError):
        try:
            assert expand(study).cells
        except SimulationError as problem:
            refused(problem, "noise_density")


@pytest.mark.parametrize("path", [*number_paths(TopicMap)], ids=shown)
def test_the_logs_of_robot_files(tmp_path: File, path: Path) -> None:
    """Tables are read, of which the topics have the same fields."""
    table = tmp_path / "log.csv"
    rows = [f"{0.1 * k:.1f},{k % 7},{k % 5},{0.1 * k},0,{k}" for k in range(200)]
    table.write_text("\n".join(["t,l,r,x,y,h", *rows]), encoding="utf-8")
    data = msgspec.to_builtins(LOGGED)
    for part in ("tracks", "imu", "fixes", "heading", "truth"):
        if path[0] == part:
            sides = {"left": ["l"], "right": ["r"]} if part == "tracks" else {}
            data[part] = {"topic": "/a", **sides}
    if path[-1] in ("counts_per_turn", "wrap"):
        tracks = data["columns"]["tracks"] if path[0] == "columns" else data["tracks"]
        tracks |= {"unit": "counts", "counts_per_turn": 100.0}
    if path[-1] in ("wander_sigma", "wander_time"):
        fixes = data["columns"]["fixes"] if path[0] == "columns" else data["fixes"]
        fixes |= {"wander_sigma": 1.0, "wander_time": 1.0}
    for _, mapping in accepted(data, path, TopicMap, ReplayError):
        log = msgspec.to_builtins(mapping)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                read = read_log(table, Robot("test", VEHICLE, log={"columns": log["columns"]}))
            except ReplayError as problem:
                refused(problem, str(table))
                continue
        assert np.isfinite(read.tracks.speeds).all()
        assert read.fixes is None or np.isfinite(read.fixes.poses[:, :2]).all()
