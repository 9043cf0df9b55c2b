"""`icreckon export` as a user calls it: the folder, its build with CMake, and bad input."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from command_line import fails, succeeds
from icreckon import EstimatorError, PoseEstimator, Scenario, load_robot, simulate
from icreckon.estimator.embedded.c_filter import filter_in_c
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.robot.variants import Variant
from same_runs import ROBOT

WORDS = ("export", "--robot", "auriga-alpha")


OWN_PROJECT = """cmake_minimum_required(VERSION 3.16)
project(own LANGUAGES C)
add_subdirectory(filter)
add_executable(main main.c)
target_link_libraries(main icreckon_filter::icreckon_filter)
"""


def built(cwd: Path, source: str, to: str) -> None:
    for command in (["-S", source, "-B", to, "-DCMAKE_BUILD_TYPE=Debug"], ["--build", to]):
        ran = subprocess.run(
            ["cmake", *command], cwd=cwd, capture_output=True, text=True, check=False, timeout=300,
            env={**os.environ, "CXX": "no-compiler-of-C++-is-needed"},
        )  # fmt: skip
        assert ran.returncode == 0, ran.stdout + ran.stderr


def example(cwd: Path, lines: str) -> subprocess.CompletedProcess[str]:
    """Run the exported program over lines of measurements."""
    command = ["build/icreckon_example"]
    return subprocess.run(command, cwd=cwd, input=lines, capture_output=True, text=True, check=True)


def test_a_folder_that_builds_and_passes_its_self_test(tmp_path: Path) -> None:
    done = succeeds(*WORDS, "--variant", "gyro", "--out", "filter", cwd=tmp_path)
    assert "next: cmake -S filter" in done.stderr
    names = {one.name for one in (tmp_path / "filter").iterdir()}
    assert {"icreckon_filter.c", "icreckon_filter.hpp", "extras", "README.md"} <= names
    for name in ("cmake", "cc"):
        if shutil.which(name) is None:
            pytest.skip(f"no {name} here: install it to build exported filters")
    # Arduino compiles all sources beside the header.
    assert [one.name for one in (tmp_path / "filter").glob("*.c")] == ["icreckon_filter.c"]
    built(tmp_path, "filter", "build")
    ran = subprocess.run(["ctest", "--test-dir", "build"], cwd=tmp_path, check=False)
    assert ran.returncode == 0
    (tmp_path / "CMakeLists.txt").write_text(OWN_PROJECT)
    (tmp_path / "main.c").write_text("int main(void) { return 0; }\n")
    built(tmp_path, ".", "own")
    assert not list((tmp_path / "own").rglob("icreckon_example*"))
    lines = "tracks,1000000000,0.3,0.5\nimu,1010000000,0,0,0.2,0,0,9.81\nnonsense\n"
    ran = example(tmp_path, lines)
    assert ran.stdout.startswith("stamp,x,y,yaw")
    assert "not read: nonsense" in ran.stderr


def test_an_existing_folder_is_overwritten_on_request_only(tmp_path: Path) -> None:
    succeeds(*WORDS, "--variant", "gyro", cwd=tmp_path)
    assert "--overwrite" in fails(*WORDS, "--variant", "gyro", cwd=tmp_path)
    succeeds(*WORDS, "--variant", "gyro", "--overwrite", cwd=tmp_path)
    (tmp_path / "icreckon_filter" / "main.c").write_text("int main;")
    succeeds(*WORDS, "--variant", "gyro", "--overwrite", cwd=tmp_path)
    assert (tmp_path / "icreckon_filter" / "main.c").read_text() == "int main;"
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "icreckon_filter.h").write_text("written by icreckon")
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    fails(*WORDS, "--out", "mine", "--overwrite", cwd=tmp_path)
    assert (tmp_path / "mine" / "thesis.tex").exists()


def test_the_example_takes_latencies_off_and_puts_samples_in_order(tmp_path: Path) -> None:
    """Lines in the order of arrival give the poses of the Python filter."""
    robot, late = load_robot("husky"), 360_000_000
    done = succeeds("export", "--robot", "husky", "--precision", "double", cwd=tmp_path)
    assert "track speeds lag by 0.36 s" in done.stderr
    if shutil.which("cmake") is None or shutil.which("cc") is None:
        pytest.skip("no cmake or cc here: install them to build exported filters")
    built(tmp_path, "icreckon_filter", "build")
    estimator, lines, poses = PoseEstimator(robot, "inertia-online"), [], []
    for measurement in simulate(Scenario(duration=5.0), robot).measurements():
        match measurement:
            case TrackSpeeds(stamp=stamp, left=left, right=right):
                lines.append((stamp + late, f"tracks,{stamp + late},{left!r},{right!r}\n"))
            case ImuSample(stamp=stamp, angular_velocity=rates, linear_acceleration=force):
                values = ",".join(map(repr, (*rates, *(force or ()))))
                lines.append((stamp, f"imu,{stamp},{values}\n"))
            case _:
                continue
        estimator.feed(measurement)
        if isinstance(measurement, TrackSpeeds):
            poses.append(estimator.pose)
    ran = example(tmp_path, "".join(line for _, line in sorted(lines)))
    assert ran.stderr == ""
    found = np.loadtxt(ran.stdout.splitlines(), delimiter=",", skiprows=1)[:, 1:4]
    np.testing.assert_allclose(found, poses, atol=2e-6)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("export",), "--robot is required"),
        ((*WORDS, "--precision", "flaot"), "float"),
        ((*WORDS, "--variant", "inertia-onlin"), "inertia-online"),
        ((*WORDS, "--imu-rate", "0"), "rate of the IMU"),
        ((*WORDS, "--imu-rate", "nan"), "rate of the IMU"),
        (("export", "--robot", "no-such.toml"), "no-such.toml"),
    ],
)
def test_bad_input_is_named(words: tuple[str, ...], why: str, tmp_path: Path) -> None:
    assert why in fails(*words, cwd=tmp_path)
    assert not (tmp_path / "icreckon_filter").exists()


def test_a_motion_model_of_the_user_is_refused() -> None:
    class Own(LaggedIndexMotion):
        """Model that has no traced form."""

    variant = Variant("own", "constant", online=True, motion=lambda robot: Own(robot.constants))
    with pytest.raises(EstimatorError, match="'own' has no form in C"):
        filter_in_c(ROBOT, variant, bits=32, imu_rate=100.0)
