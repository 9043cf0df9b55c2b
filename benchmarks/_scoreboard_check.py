"""Cells of the scoreboard that are worse than in a file, beyond their noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

LARGER = 1.1
"""Drift that counts as worse, if it also exceeds the interval of the file [-]."""
RULES_POINTS, GATES_POINTS = 0.1, 0.5
"""Further exclusions that count as worse [% of the IMU samples]."""
NEES_BOUND, NEES_LARGER = 2.0, 1.5
ALL_LARGER = 0.01
"""Drift over all cells that counts as worse, beyond its interval [-]."""

FAULT_LARGER, FLOOR_M, FLOOR_DEG = 1.25, 0.05, 0.5
"""Error with a fault that counts as worse, if it also exceeds that of each run in the file."""
REAL_LARGER, SLOWER = 1.05, 1.5
"""Drift on real logs, and time of a step over filterpy's, that count as worse [-]; the latter differs
between processors."""
SIGMA_LARGER = 2.0
"""Own standard deviation with a fault that counts as worse: caution has a price [-]."""


def worse(results: dict[str, Any], baseline: dict[str, Any]) -> list[str]:
    """Cells that are worse than in the baseline, a line each."""
    found: list[str] = []
    for part, cells in results.items():
        before = baseline.get(part, {}).get("cells", {})
        shared = {name: (cells[name], before[name]) for name in cells if name in before}
        if cells and not shared:
            found.append(f"{part}: the file has none of these cells")
        for name, (now, then) in shared.items():
            found += [f"{part}: {name}: {what}" for what in COMPARISONS[part](now, then)]
        if part == "healthy":
            found += [f"{part}: {line}" for line in _over_all(shared)]
    return found


def worse_drive(now: dict[str, Any], then: dict[str, Any]) -> Iterator[str]:
    """What is worse in a healthy cell."""
    for variant in sorted(now.keys() & then.keys()):
        new, old = now[variant], then[variant]
        if new["drift"] > max(old["drift_high"], LARGER * old["drift"]):
            yield f"{variant}: drift {old['drift']:.2f} -> {new['drift']:.2f} %"
        yield from (f"{variant}: {line}" for line in _more_excluded(new, old))
        if new["nees"] > max(NEES_BOUND, NEES_LARGER * old["nees"]):
            yield f"{variant}: NEES {old['nees']:.1f} -> {new['nees']:.1f}"
        yield from (f"{variant}: {line}" for line in more_flags(new["flags"], old["flags"]))


def _more_excluded(new: dict[str, Any], old: dict[str, Any]) -> Iterator[str]:
    for key, points in (("rules_percent", RULES_POINTS), ("gates_percent", GATES_POINTS)):
        if new[key] > old[key] + points:
            names = f" ({', '.join(new['rules'])})" if key == "rules_percent" else ""
            what = f"excluded by {key.partition('_')[0]}"
            yield f"{what} {old[key]:.2f} -> {new[key]:.2f} %{names}"


def more_flags(new: dict[str, float], old: dict[str, float]) -> Iterator[str]:
    """Flags in health that are more than chance gives: two standard deviations of a count."""
    for flag, count in new.items():
        before = old.get(flag, 0.0)
        if count > before + 2.0 * math.sqrt(before + 1.0):
            yield f"{flag} {before:.0f} -> {count:.0f} times"


def _over_all(shared: dict[str, tuple[dict[str, Any], dict[str, Any]]]) -> Iterator[str]:
    """Variants whose drift over all cells is larger, beyond the interval over the cells."""
    variants = {name for now, then in shared.values() for name in now.keys() & then.keys()}
    for variant in sorted(variants):
        logs = np.log(
            [
                now[variant]["drift"] / then[variant]["drift"]
                for now, then in shared.values()
                if variant in now and variant in then
            ]
        )
        half = 2.0 * float(np.std(logs)) / math.sqrt(len(logs))
        if float(logs.mean()) - half > ALL_LARGER:
            percent = 100.0 * math.expm1(float(logs.mean()))
            yield f"all cells, {variant}: drift {percent:.1f} % larger in the mean"


def worse_fault(now: dict[str, Any], then: dict[str, Any]) -> Iterator[str]:
    """What is worse in a cell of a fault."""
    for variant in sorted(now.keys() & then.keys()):
        new, old = now[variant], then[variant]
        if new["neither"] > old["neither"]:
            yield f"{variant}: {old['neither']} -> {new['neither']} of {new['runs']} runs not covered"
        for at in ("end", "later"):
            for key, floor in (("position", FLOOR_M), ("yaw_deg", FLOOR_DEG)):
                sigma, before = new[at][f"{key}_sigma"], old[at][f"{key}_sigma"]
                if sigma > SIGMA_LARGER * before + floor:
                    yield f"{variant}: own sigma of {key} at its {at} {before:.2f} -> {sigma:.2f}"
                most = max(FAULT_LARGER * old[at][key], old[at][key] + floor)
                if new[at][key] > most and new[at][key] > old[at][f"{key}_most"]:
                    unit = "m" if key == "position" else "deg"
                    what = f"{old[at][key]:.2f} -> {new[at][key]:.2f} {unit}"
                    yield f"{variant}: {key.partition('_')[0]} at its {at} {what}"


def worse_log(now: dict[str, Any], then: dict[str, Any]) -> Iterator[str]:
    """What is worse in real logs: drift, or health of sensors that are taken to be healthy."""
    for variant in sorted(now.keys() & then.keys()):
        new, old = now[variant], then[variant]
        if "drift" in old and new["drift"] > max(old["drift_high"], REAL_LARGER * old["drift"]):
            yield f"{variant}: drift {old['drift']:.2f} -> {new['drift']:.2f} %"
        if "turn_error" in old and new["turn_error"] > max(
            old["turn_error_high"], REAL_LARGER * old["turn_error"]
        ):
            change = f"{old['turn_error']:.2f} -> {new['turn_error']:.2f} deg/s"
            yield f"{variant}: turning predicted by the tracks {change}"
        if "flags" in old:
            yield from (f"{variant}: {line}" for line in _more_excluded(new, old))
            yield from (f"{variant}: {line}" for line in more_flags(new["flags"], old["flags"]))


def worse_cost(now: dict[str, Any], then: dict[str, Any]) -> Iterator[str]:
    """What takes longer than in the file, against filterpy in the same run."""
    for name in sorted(now.keys() & then.keys()):
        new, old = now[name].get("of_filterpy"), then[name].get("of_filterpy")
        if new and old and new > SLOWER * old:
            yield f"{name}: {old:.2f} -> {new:.2f} times filterpy's step"


COMPARISONS = {"healthy": worse_drive, "faults": worse_fault, "real": worse_log, "cost": worse_cost}
