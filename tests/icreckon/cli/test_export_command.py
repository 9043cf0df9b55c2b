"""`icreckon export` as a user calls it: the folder, its build with CMake, and bad input."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from command_line import icreckon, succeeds
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.embedded.c_filter import filter_in_c
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.robot.variants import Variant
from same_runs import ROBOT

WORDS = ("export", "--robot", "auriga-alpha")


@pytest.mark.parametrize("words", [["--precision", "double"], ["--compact"]])
def test_a_folder_that_builds_and_passes_its_self_test(words: list[str], tmp_path: Path) -> None:
    done = succeeds(*WORDS, *words, "--out", "filter", cwd=tmp_path)
    assert "next: cmake -S filter" in done.stderr
    names = {one.name for one in (tmp_path / "filter").iterdir()}
    assert {"icreckon_filter.c", "icreckon_filter.hpp", "test_vectors.csv", "README.md"} <= names
    for name in ("cmake", "cc"):
        if shutil.which(name) is None:
            pytest.skip(f"no {name} here: install it to build exported filters")
    build = ["cmake", "-S", "filter", "-B", "build", "-DCMAKE_BUILD_TYPE=Debug"]
    for command in (build, ["cmake", "--build", "build"], ["ctest", "--test-dir", "build"]):
        ran = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300,
            env={**os.environ, "CXX": "no-compiler-of-C++-is-needed"},
        )  # fmt: skip
        assert ran.returncode == 0, ran.stdout + ran.stderr
    lines = "tracks,1000000000,0.3,0.5\nimu,1010000000,0,0,0.2,0,0,9.81\nnonsense\n"
    ran = subprocess.run(
        ["build/icreckon_example"],
        cwd=tmp_path,
        input=lines,
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.startswith("stamp,x,y,yaw")
    assert "not read: nonsense" in ran.stderr


def test_an_existing_folder_is_overwritten_on_request_only(tmp_path: Path) -> None:
    succeeds(*WORDS, "--variant", "gyro", cwd=tmp_path)
    again = icreckon(*WORDS, "--variant", "gyro", cwd=tmp_path)
    assert again.returncode != 0
    assert "--overwrite" in again.stderr
    succeeds(*WORDS, "--variant", "gyro", "--overwrite", cwd=tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    assert icreckon(*WORDS, "--out", "mine", "--overwrite", cwd=tmp_path).returncode != 0
    assert (tmp_path / "mine" / "thesis.tex").exists()


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
    done = icreckon(*words, cwd=tmp_path)
    assert done.returncode != 0
    assert why in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "icreckon_filter").exists()


def test_a_motion_model_of_the_user_is_refused() -> None:
    class Own(LaggedIndexMotion):
        """Model that has no traced form."""

    variant = Variant("own", "constant", online=True, motion=lambda robot: Own(robot.constants))
    with pytest.raises(EstimatorError, match="'own' has no form in C"):
        filter_in_c(ROBOT, variant, bits=32, imu_rate=100.0)
