"""What several tests need: where the sample logs are, and small logs made on the spot."""

import os
import shutil
import subprocess
import sys
import sysconfig
import time
import venv
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# Before numpy is imported: threads of BLAS for matrices of this size only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import settings

from icreckon import Log, Robot, Scenario, load_robot, read_log, simulate, write_log
from icreckon.estimator.log.series import (
    FixSeries,
    ImuSeries,
    PoseSeries,
    TrackSpeedSeries,
    Truth,
    TwistSeries,
)
from icreckon.replay.inspection.inspect import Inspection, inspect

REPOSITORY = Path(__file__).parent.parent

# Test workers set it; results are as wide as their tables without it.
os.environ.pop("COLUMNS", None)

# Properties are tried with the same examples in every run; HYPOTHESIS_PROFILE=default draws new ones.
settings.register_profile("same-examples", derandomize=True, database=None, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same-examples"))
LONG = (
    "test_live_ros.py", "test_live_settings.py", "test_how_to.py", "test_pages.py", "test_fresh_cache.py",
    "test_c_hostile.py", "test_readme.py", "test_calibrate_command.py", "test_ros2.py",
    "test_sample_logs.py", "test_cortex_m.py", "test_c_day.py", "test_c_agreement.py",
    "test_agreement.py", "test_calibrate.py", "test_compiled.py", "test_study_engines.py",
    "test_stopping.py", "test_study_command.py", "test_cli.py", "test_scattering_fixes.py",
    "test_considered.py", "test_embedding.py", "test_robot_check.py", "test_two_at_once.py",
    "test_worlds.py", "test_paper_command.py", "test_position_truth.py",
)  # fmt: skip
"""Files that take longest. They begin first, so that no worker is left with one at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files of `LONG` first."""
    order = {name: place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: order.get(item.path.name, len(LONG)))


@pytest.fixture(scope="session")
def chromium() -> str:
    """Command of a browser; tests that need one are skipped without."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if found := shutil.which(name):
            return found
    pytest.skip("no chromium to open pages in (Debian: apt-get install chromium)")


def thorough(*values: object) -> Any:
    """Values of a parametrised test that are tried with `-m thorough` only."""
    return pytest.param(*values, marks=pytest.mark.thorough)


def sample_log(folder: Path, name: str) -> Path:
    """A sample log by its name, or a visible skip where it is absent."""
    path = folder / name
    if not path.exists():
        pytest.skip(f"no sample log {path}")
    return path


@cache
def _read(path: Path, robot_name: str) -> Log:
    return read_log(path, load_robot(robot_name))


def sample(folder: Path, name: str, robot_name: str) -> Log:
    """A sample log as it is read with a shipped robot file, read once for all tests."""
    return _read(sample_log(folder, name), robot_name)


@cache
def inspected(path: Path) -> Inspection:
    """What `icreckon inspect` finds in a log, worked out once for all tests."""
    return inspect(path)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of the sample logs: $ICRECKON_DATA, or ../shared/data beside the repository."""
    folder = Path(os.environ.get("ICRECKON_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no sample logs at {folder}; set ICRECKON_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("auriga-alpha")


def simulated(path: Path, seconds: float, **scenario: Any) -> Path:
    """A bag of a simulated drive of auriga-alpha."""
    robot = load_robot("auriga-alpha")
    log = simulate(Scenario(duration=seconds, **scenario), robot)
    return write_log(log, path, "mcap", robot)


@pytest.fixture(scope="session")
def evo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of evo's programs: on the path, or in a virtual environment for all workers."""
    found = shutil.which("evo_traj")
    if found is not None:
        return Path(found).parent
    folder, problem = once(tmp_path_factory, "evo", _install_evo)
    if problem:
        pytest.skip(f"evo is not on the path, and pip cannot install it: {problem.strip()[-200:]}")
    return folder / "venv" / "bin"


def _install_evo(folder: Path) -> str:
    """Install evo; return why that fails, empty if it works."""
    # It sees the packages of the tests, so that pip adds only what these lack.
    venv.create(folder / "venv", with_pip=False)
    (packages,) = (folder / "venv" / "lib").glob("*/site-packages")
    (packages / "tests.pth").write_text(sysconfig.get_paths()["purelib"], encoding="utf-8")
    command = [sys.executable, "-m", "pip", "--python", folder / "venv" / "bin" / "python"]
    command += ["install", "-q", "evo"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stderr if done.returncode else ""


@pytest.fixture(scope="session")
def ros(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment of processes of ROS 2: a domain of their own, tf2_msgs built where missing."""
    if find_spec("rclpy") is None:
        pytest.skip("no ROS 2: pip install -e '.[ros2-test]', or source a ROS 2")
    environment = os.environ | {
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path_factory.mktemp("ros") / "log"),
        "PYTHONUNBUFFERED": "1",
    }
    if find_spec("tf2_msgs") is None:
        if not (shutil.which("gcc") and shutil.which("g++")):
            pytest.skip("no compiler to build tf2_msgs with, which the ROS 2 wheels lack")
        folder, problem = once(tmp_path_factory, "tf2_msgs", _build_tf2_msgs)
        assert not problem
        before = environment.get("PYTHONPATH")
        environment["PYTHONPATH"] = os.pathsep.join([str(folder), *([before] if before else [])])
    return environment


def _build_tf2_msgs(folder: Path) -> str:
    """Build the messages; return why that fails, empty if it works."""
    command = [sys.executable, REPOSITORY / "tests" / "ros2_tf2_msgs.py", folder]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stderr if done.returncode else ""


def once(
    tmp_path_factory: pytest.TempPathFactory, name: str, make: Callable[[Path], str]
) -> tuple[Path, str]:
    """A folder that one worker makes for all, and why that failed, empty if it worked."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent
    folder, result = root / name, root / f"{name}.problem"
    try:
        folder.mkdir()
    except FileExistsError:
        # Another worker makes it.
        deadline = time.monotonic() + 300.0
        while not result.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
    else:
        unfinished = result.with_suffix(".part")
        unfinished.write_text(make(folder), encoding="utf-8")
        unfinished.replace(result)
    return folder, result.read_text(encoding="utf-8")


def holed(log: Log, begin: int, end: int, tracks_end: int | None = None) -> Log:
    """A log without track speeds and IMU samples between two stamps [ns]."""
    tracks, imu = log.tracks, log.imu
    kept = (tracks.stamps < begin) | (tracks.stamps > (tracks_end or end))
    kept_imu = (imu.stamps < begin) | (imu.stamps > end)
    readings = (imu.stamps, imu.angular_velocity, imu.linear_acceleration)
    return replace(
        log,
        tracks=TrackSpeedSeries(tracks.stamps[kept], tracks.speeds[kept]),
        imu=ImuSeries(*(one[kept_imu] for one in readings)),
    )


def make_log(seconds: float = 4.0, seed: int = 1, start: int = 1_700_000_000_123_456_789) -> Log:
    """A log with every stream, of random numbers."""
    rng = np.random.default_rng(seed)

    def stamps(rate: float, offset: int = 0) -> np.ndarray:
        count = int(seconds * rate)
        jitter = rng.integers(0, 1000, count)
        return start + offset + (np.arange(count) * (10**9 / rate)).astype(np.int64) + jitter

    tracks, imu, fixes, truth = stamps(50), stamps(100, 3), stamps(5, 7), stamps(20, 11)
    poses = rng.normal(size=(len(fixes), 3))
    variances = rng.uniform(0.01, 1.0, (len(fixes), 2))
    poses[::3, 2] = np.nan
    variances[::3, 1] = 1e6
    return Log(
        name="made",
        tracks=TrackSpeedSeries(tracks, rng.normal(size=(len(tracks), 2))),
        imu=ImuSeries(
            imu, rng.normal(size=(len(imu), 3)), rng.normal([0.0, 0.0, 9.81], 1.0, (len(imu), 3))
        ),
        fixes=FixSeries(fixes, poses, variances),
        truth=Truth(
            PoseSeries(truth, rng.normal(size=(len(truth), 3))),
            TwistSeries(truth, rng.normal(size=(len(truth), 3))),
            TrackSpeedSeries(truth, rng.normal(size=(len(truth), 2))),
            source="random",
        ),
    )
