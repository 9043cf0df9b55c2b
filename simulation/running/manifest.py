"""Identity of a study: its digest, and the manifest next to its results."""

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

from icreckon.estimator.base.plain_data import json_types, package_versions
from icreckon.simulation.contact.of_robot import robot_remarks
from icreckon.simulation.running.engines import Engine
from icreckon.simulation.study.cells import Plan
from icreckon.simulation.study.statistics import statistics

FORMAT = 1
# Packages whose versions may change the last bits of a result, and packages that write it.
COMPUTING = ("icreckon", "numpy", "scipy", "numba", "filterpy")
WRITING = ("msgspec", "matplotlib", "pyarrow")
SEEDING = "numpy.random.SeedSequence([seed, index of the run, or of its true motion]).spawn(...)"

Plain = dict[str, Any]


@cache
def computing_versions() -> Plain:
    """Installed versions of the packages that compute."""
    return package_versions(COMPUTING)


def manifest(plan: Plan, engine: Engine) -> Plain:
    """Configuration, seeds and versions of a study, the same on every machine."""
    study, first = plan.study, plan.cells[0]
    return {
        "format": FORMAT,
        "name": study.name,
        "digest": digest(plan, engine),
        "configuration": json_types(study),
        "robot": json_types(first.robot),
        # Cells differ in what is swept: remarks on the first one stand for all.
        "remarks": robot_remarks(first.robot, first.scenario.truth),
        "engine": engine.name,
        "block_runs": engine.block_runs,
        "runs": study.runs,
        "truths": study.truths,
        "baseline": study.compared_with,
        "seeds": {"study": study.seed, "streams": SEEDING},
        "statistics": [statistic.name for statistic in statistics(study.horizons)],
        "axes": [
            {"name": axis.name, "scale": axis.scale, "sampled": axis.sampled} for axis in plan.axes
        ],
        "cells": [cell.values for cell in plan.cells],
        "variants": list(plan.labels),
        "versions": computing_versions() | package_versions(WRITING),
    }


def digest(plan: Plan, engine: Engine) -> str:
    """Digest of all that the runs of a study depend on.

    Their number, names for people, and the baseline of comparisons do not count.
    """
    cells = [json_types(cell) for cell in plan.cells]
    for data in cells:
        del data["index"], data["values"]  # places in the sweep
    recordings = {}
    for name in filter(None, {cell.scenario.trajectory_file for cell in plan.cells}):
        file = Path(name)
        content = hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else "missing"
        recordings[str(file)] = content
    identity = {
        "format": FORMAT,
        "engine": engine.name,
        "block_runs": engine.block_runs,
        "statistics": [statistic.name for statistic in statistics(plan.study.horizons)],
        "versions": computing_versions(),
        "cells": cells,
        "recordings": recordings,
    }
    text = json.dumps(identity, sort_keys=True)
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def differences(old: Plain, new: Plain, table: str = "") -> list[str]:
    """Differences of two manifests, as "key: there OLD, here NEW"."""
    changes = []
    for key in sorted({*old, *new}):
        path = f"{table}.{key}" if table else key
        was, now = old.get(key), new.get(key)
        if was == now or key == "digest":
            continue
        if isinstance(was, dict) and isinstance(now, dict):
            changes += differences(was, now, path)
        else:
            changes.append(f"{path}: there {_short(was)}, here {_short(now)}")
    return changes


def as_json(data: Any) -> str:
    """Plain data as JSON; NaN and infinity become null."""
    return json.dumps(json_types(data), indent=1, allow_nan=False) + "\n"


def _short(value: Any) -> str:
    """JSON of a value, at most 60 characters of it."""
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
