"""The commands on a fresh machine: from an empty compile cache, in the README's order, and at once."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from command_line import results_in
from icreckon.simulation.study.plan import study_names

TAKE_LONGEST = tuple(
    f"icreckon.estimator.{name}."
    for name in (
        "engine.lane_functions.feed_samples",
        "engine.lane_functions.take_sample",
        "engine.work.work_through",
        "batch.front_end.fill_inputs",
    )
)
"""Kernels that take half of the time of compiling what a replay needs."""


def icreckon(cache: Path, folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [Path(sys.executable).parent / "icreckon", *arguments],
        cwd=folder,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def finished(*processes: subprocess.Popen[str]) -> None:
    ended = [(process.communicate(timeout=900)[0], process.returncode) for process in processes]
    assert all(code == 0 for _, code in ended), ended


def all_numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [number for one in value.values() for number in all_numbers(one)]
    if isinstance(value, list):
        return [number for one in value for number in all_numbers(one)]
    return [value] if type(value) in (int, float) else []


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that `icreckon prepare` alone has filled."""
    cache, folder = tmp_path_factory.mktemp("prepared"), tmp_path_factory.mktemp("drive")
    finished(icreckon(cache, folder, "prepare"))
    assert len(set(cache.rglob("*.kernel"))) > 40
    return cache


@pytest.mark.slow
@pytest.mark.thorough
def test_shipped_studies_run_through_and_compile_nothing(prepared, tmp_path):
    kernels = set(prepared.rglob("*.kernel"))
    for name in study_names():
        finished(icreckon(prepared, tmp_path, "study", name, "--runs", "1", "--out", name))
    assert set(prepared.rglob("*.kernel")) == kernels
    for name in study_names():
        numbers = all_numbers(results_in(tmp_path / name)["overall"])
        assert len(numbers) > 100, name
        assert all(math.isfinite(number) and abs(number) < 1e9 for number in numbers), name


@pytest.mark.slow
@pytest.mark.thorough
def test_replays_at_once_say_what_one_after_prepare_says(prepared, tmp_path, tmp_path_factory):
    """Two commands that compile the same kernels at once share a cache that lacks them, and fills."""
    shared = tmp_path_factory.mktemp("shared")
    shutil.copytree(prepared, shared, dirs_exist_ok=True)
    for kernel in shared.rglob("*.kernel"):
        if not kernel.name.startswith(TAKE_LONGEST):
            kernel.unlink()
    before = set(shared.rglob("*.kernel"))
    simulated = ("--duration", "60", "--fix-rate", "1", "--set", "truth=kinematic")
    finished(icreckon(prepared, tmp_path, "simulate", "--out", "log", *simulated))
    command = ("replay", "log", "--robot", "auriga-alpha", "--formats", "none")

    def replay(cache: Path, out: str) -> subprocess.Popen[str]:
        return icreckon(cache, tmp_path, *command, "--variants", "gyro", "--out", out)

    finished(replay(shared, "one"), replay(shared, "other"))
    added = {kernel.name for kernel in set(shared.rglob("*.kernel")) - before}
    assert len(added) > 10
    assert added <= {kernel.name for kernel in prepared.rglob("*.kernel")}
    kernels = set(prepared.rglob("*.kernel"))
    finished(replay(prepared, "prepared"))
    assert set(prepared.rglob("*.kernel")) == kernels
    expected = results_in(tmp_path / "prepared")["variants"]
    for out in ("one", "other"):
        assert results_in(tmp_path / out)["variants"] == expected
