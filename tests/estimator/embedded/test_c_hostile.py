"""Exported filters under sanitizers: random and hostile measurements; warnings of the compilers."""

import subprocess
from functools import cache
from pathlib import Path

import pytest

from c_filters import compiler
from conftest import thorough
from icreckon.estimator.embedded.c_filter import Exported, filter_in_c
from icreckon.estimator.robot.variants import VARIANTS
from same_runs import ROBOT

HOSTILE = Path(__file__).parent / "hostile.c"
SANITIZED = "-O1", "-g0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"
WARNINGS = "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror", "-O0"


@cache
def exported(variant: str, bits: int) -> Exported:
    return filter_in_c(ROBOT, VARIANTS[variant], bits=bits, imu_rate=100.0)


def written(folder: Path, variant: str, bits: int) -> Path:
    exported(variant, bits).write(folder)
    return folder


def survives(folder: Path, seconds: float, seed: int, cc: str = "gcc") -> None:
    program = folder / "hostile"
    if not program.exists():
        sources = [str(HOSTILE), str(folder / "icreckon_filter.c")]
        command = [compiler(cc), "-std=c99", *SANITIZED, f"-I{folder}", *sources, "-lm"]
        subprocess.run([*command, "-o", str(program)], check=True, timeout=300)
    done = subprocess.run(
        [program, str(seconds), str(seed)], capture_output=True, text=True, check=False, timeout=900
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert done.stderr == ""


ALL = [(one, bits, "gcc") for one in ("gyro", "full-linear", "inertia-online") for bits in (64, 32)]
# Clang takes twice as long.
OTHERS = [("gyro", 32, "clang"), ("full-linear", 64, "clang"), ("inertia-online", 32, "clang")]
# The largest filter as microcontrollers run it, by the usual compiler; the others with `-m thorough`.
USUAL = "inertia-online", 32, "gcc"
FORMS = [one if one == USUAL else thorough(*one) for one in ALL + OTHERS]


@pytest.mark.slow
@pytest.mark.parametrize(("variant", "bits", "cc"), FORMS)
def test_ten_hostile_minutes(variant: str, bits: int, cc: str, tmp_path: Path) -> None:
    """Random inputs of another seed for each form."""
    seed = ALL.index((variant, bits, cc)) if cc == "gcc" else len(ALL)
    survives(written(tmp_path, variant, bits), 600.0, seed, cc)


@pytest.mark.parametrize(
    ("cc", "language"),
    [
        ("gcc", ("-std=c99",)),
        ("g++", ("-std=c++17", "-x", "c++")),
        pytest.param("clang", ("-std=c99",), marks=pytest.mark.slow),
        pytest.param("clang++", ("-std=c++17", "-x", "c++"), marks=pytest.mark.slow),
    ],
)
def test_compilers_do_not_warn(cc: str, language: tuple[str, ...], tmp_path: Path) -> None:
    folder = written(tmp_path, "inertia-online", 32)
    user = folder / "user.cpp"
    user.write_text('#include "icreckon_filter.hpp"\nicreckon::Filter filter(1.0f, 2.0f, 0.5f);\n')
    sources = ["icreckon_filter.c", "extras/example.c", "extras/selftest.c"]
    for source in (*sources, *(["user.cpp"] if "++" in cc else [])):
        command = [compiler(cc), *language, *WARNINGS, "-I.", "-c", source, "-o", "unused.o"]
        subprocess.run(command, check=True, cwd=folder, timeout=300)
