"""Cost of the filter: time of a step over filterpy's, of the first use, lines and numbers of the code."""

from __future__ import annotations

import ast
import math
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from _digests import ROOT

REPEAT, STEPS, STEPS_OF_LANES = 7, 2000, 40
"""Paired repetitions; steps of filterpy, and calls of the lanes, in each."""
VARIANT = "inertia-online"
PACKAGES = ("estimator", "simulation", "replay", "icreckon")
FAULTS = ROOT / "estimator" / "faults"


def cost(*, quick: bool) -> dict[str, Any]:
    """Times as ratios to filterpy, lines, and numbers in `estimator/faults`.

    Args:
        quick: leave out the first use of an empty cache.
    """
    found: dict[str, Any] = {"streamed pair": streamed()}
    found["lanes"] = lanes()
    if not quick:
        found["first use"] = first_use()
    found["lines"] = {name: {"lines": lines(ROOT / name)} for name in PACKAGES}
    found["lines"]["all"] = {"lines": sum(one["lines"] for one in found["lines"].values())}
    found["faults"] = {"numbers in estimator/faults": {"count": numbers(FAULTS)}}
    return found


def streamed() -> dict[str, Any]:
    """Time of a streamed pair (track speeds and IMU) by variant, over that of filterpy's EKF."""
    from _scoreboard_cells import VARIANTS
    from step_time import filter_microseconds, plain_microseconds

    from icreckon.estimator.robot.robot_file import load_robot
    from icreckon.simulation.scenario import Scenario
    from icreckon.simulation.simulate import simulate

    robot = load_robot("auriga-alpha")
    scenario = Scenario(duration=30.0, track_rate=50.0, imu_rate=50.0, fix_rate=0.0, seed=1)
    log = simulate(scenario, robot)
    found = {}
    for name in VARIANTS:
        best, ratio = paired(
            partial(plain_microseconds, STEPS), partial(filter_microseconds, log, robot, name)
        )
        found[name] = {"us": best, "of_filterpy": ratio}
    return found


def paired(plain: Callable[[], float], ours: Callable[[], float]) -> tuple[float, float]:
    """Best time of ours, and its best ratio to filterpy's, taken in turn.

    Each time is compared with the shorter of filterpy's just before and after it. These are processor
    times, so other work on the machine changes them by a few per cent (caches, clock), and the best of
    several ratios less.

    Args:
        plain: function that returns filterpy's time.
        ours: function that returns the time to compare, in the same unit.
    """
    best = ratio = math.inf
    before = plain()
    for _ in range(REPEAT):
        time, after = ours(), plain()
        best, ratio = min(best, time), min(ratio, time / min(before, after))
        before = after
    return best, ratio


def lanes() -> dict[str, Any]:
    """Steps per CPU second side by side; empty where engines.py does not fit the engine any more."""
    from step_time import plain_microseconds

    try:
        from engines import Drive

        drive = Drive(VARIANT)
        best, ratio = paired(
            lambda: 1e-6 * plain_microseconds(STEPS),
            lambda: min(drive.seconds() for _ in range(STEPS_OF_LANES)),
        )
    except (ImportError, AttributeError, TypeError, ValueError, KeyError) as problem:
        return {VARIANT: {"not_measured": f"{type(problem).__name__}: {problem}"}}
    return {VARIANT: {"steps_per_second": 1.0 / best, "of_filterpy": ratio}}


def first_use() -> dict[str, Any]:
    """Time of the first feed with an empty cache of kernels, and in a later process [s]."""
    from step_time import first_seconds

    with tempfile.TemporaryDirectory() as cache:
        cold, warm = first_seconds(cache), first_seconds(cache)
    return {"empty cache": {"seconds": cold}, "later": {"seconds": warm}}


def lines(folder: Path) -> int:
    """Lines of the Python files of a package, those behind links not counted."""
    return sum(
        path.read_text(encoding="utf-8").count("\n")
        for path in folder.rglob("*.py")
        if not any(one.is_symlink() for one in path.parents if one.is_relative_to(folder))
    )


def numbers(folder: Path) -> int:
    """Numeric constants that are assigned at the level of a module, of all modules of a folder."""
    count = 0
    for path in folder.glob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                count += sum(
                    isinstance(one, ast.Constant) and type(one.value) in (int, float)
                    for one in ast.walk(node.value)
                )
    return count
