"""Cost of the filter: time of a step over filterpy's, of the first use, lines and numbers of the code."""

from __future__ import annotations

import ast
import math
import tempfile
from pathlib import Path
from typing import Any

from _digests import ROOT

REPEAT, STEPS = 5, 3000
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
    plain, best = math.inf, dict.fromkeys(VARIANTS, math.inf)
    for _ in range(REPEAT):
        plain = min(plain, plain_microseconds(STEPS))
        for name in VARIANTS:
            best[name] = min(best[name], filter_microseconds(log, robot, name))
    return {name: {"us": one, "of_filterpy": one / plain} for name, one in best.items()}


def lanes() -> dict[str, Any]:
    """Steps per CPU second side by side; empty where engines.py does not fit the engine any more."""
    from step_time import plain_microseconds

    try:
        from engines import Drive

        drive = Drive(VARIANT)
        ours = min(drive.seconds() for _ in range(40 * REPEAT))
    except (ImportError, AttributeError, TypeError, ValueError, KeyError) as problem:
        return {VARIANT: {"not_measured": f"{type(problem).__name__}: {problem}"}}
    plain = 1e-6 * min(plain_microseconds(STEPS) for _ in range(REPEAT))
    return {VARIANT: {"steps_per_second": 1.0 / ours, "of_filterpy": ours / plain}}


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
