"""Page of the scoreboard and its two pictures, from the file of results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from _digests import ROOT
from _scoreboard_cells import VARIANTS
from _scoreboard_drives import DRIVES, GRADES, GROUNDS, ROBOTS
from _scoreboard_put import FAULTS

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.colors import BoundaryNorm, ListedColormap, TwoSlopeNorm

PAGE = ROOT / "docs" / "explanation" / "proof" / "scoreboard.md"
FACTORS = {"robot": ROBOTS, "ground": tuple(GROUNDS), "drive": DRIVES, "IMU grade": GRADES}
OTHERS = VARIANTS[1:]
SHOWN = VARIANTS[-1]
TEMPLATE = Path(__file__).with_name("_scoreboard_page.md")


def write_page(results: dict[str, Any]) -> None:
    """Write the page and its pictures.

    Args:
        results: content of the file of results.
    """
    parts = {part: results.get(part, {}).get("cells", {}) for part in results}
    healthy, faults = parts.get("healthy", {}), parts.get("faults", {})
    draw_healthy(healthy, PAGE.with_name("scoreboard-healthy.png"))
    draw_faults(faults, PAGE.with_name("scoreboard-faults.png"))
    runs = next(iter(healthy.values()))[SHOWN]["runs"]
    design = "all pairs of levels" if len(healthy) > 200 else "the subset of `--quick` alone"
    text = TEMPLATE.read_text(encoding="utf-8").format(
        short="\n".join(f"- {line}" for line in in_short(parts)),
        variant=SHOWN,
        cells=len(healthy),
        runs=runs,
        design=design,
        levels=_mark(results, "healthy") + levels_table(healthy),
        fault_runs=next(iter(faults.values()))[SHOWN]["runs"],
        faults=_mark(results, "faults") + faults_table(faults),
        real=_mark(results, "real") + real_table(parts.get("real", {})),
        cost=_mark(results, "cost") + cost_table(parts.get("cost", {})),
    )
    PAGE.write_text(text, encoding="utf-8")


def _mark(results: dict[str, Any], part: str) -> str:
    of = results.get(part, {}).get("of", "nothing")
    return f"<!-- figures: python benchmarks/scoreboard.py --parts {part}; of: {of} -->\n\n"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def ratio_of(cells: Iterable[dict[str, Any]], variant: str) -> tuple[float, float, float]:
    """Geometric mean of the ratios to `gyro` over cells, and its bootstrap interval."""
    logs = np.log([one[variant]["drift"] / one["gyro"]["drift"] for one in cells])
    picks = np.random.default_rng(0).integers(0, len(logs), (2000, len(logs)))
    low, high = np.percentile(logs[picks].mean(axis=1), (2.5, 97.5))
    return math.exp(logs.mean()), math.exp(low), math.exp(high)


def _told(value: float, low: float, high: float) -> str:
    if low == high:
        return f"{value:.2f}"
    return f"{value:.2f} ({low:.2f} to {high:.2f})"


def in_short(parts: dict[str, Any]) -> list[str]:
    """Main figures, a line each."""
    healthy, faults = parts["healthy"], parts["faults"]
    lines = []
    for variant in OTHERS:
        worse = sum(one[variant]["drift"] > one["gyro"]["drift"] for one in healthy.values())
        told = _told(*ratio_of(healthy.values(), variant))
        lines.append(
            f"Drift of **`{variant}`** over that of wheels and gyro, mean over {len(healthy)} healthy "
            f"cells: {told}. It is larger in {worse} of them."
        )
    rules = sum(one[SHOWN]["rules_percent"] > 0.0 for one in healthy.values())
    flagged = sum(bool(one[SHOWN]["flags"]) for one in healthy.values())
    lines.append(
        f"Rules exclude healthy readings in {rules} of {len(healthy)} cells, and `health` has a flag "
        f"in {flagged} of them (`{SHOWN}`)."
    )
    counts = {key: sum(one[SHOWN][key] for one in faults.values()) for key in _KEYS}
    total = sum(one[SHOWN]["runs"] for one in faults.values())
    lines.append(
        f"Of {total} runs with a fault {counts['covered']} end within own 3 sigma, {counts['alike']} "
        f"more within twice the error without it, {counts['neither']} do neither (`{SHOWN}`)."
    )
    return lines


_KEYS = ("covered", "alike", "neither")


def levels_table(cells: dict[str, Any]) -> str:
    """Figures by level of each factor."""
    head = ["factor", "level", "`gyro` drift, %"]
    head += [f"`{name}` over `gyro`" for name in OTHERS]
    head += [f"NEES `{SHOWN}`", "flags an hour"]
    rows = [_level_row("all", "", list(cells.values()))]
    for k, (factor, levels) in enumerate(FACTORS.items()):
        for level in levels:
            some = [one for name, one in cells.items() if name.split(" | ")[k] == level]
            if some:
                rows.append(_level_row(factor, level, some))
    return _table(head, rows)


def _level_row(factor: str, level: str, cells: list[dict[str, Any]]) -> list[str]:
    own = [one[SHOWN] for one in cells]
    drift = np.exp(np.mean(np.log([one["gyro"]["drift"] for one in cells])))
    nees = [one["nees"] for one in own]
    return [
        factor,
        level,
        f"{drift:.2f}",
        *(_told(*ratio_of(cells, name)) for name in OTHERS),
        f"{np.median(nees):.1f}, {max(nees):.1f}",
        _flags(own),
    ]


def _flags(own: list[dict[str, Any]]) -> str:
    hours = sum(one["hours"] for one in own)
    total: dict[str, float] = {}
    for one in own:
        for name, count in one["flags"].items():
            total[name] = total.get(name, 0.0) + count
    return ", ".join(f"{name} {count / hours:.0f}" for name, count in sorted(total.items()))


def faults_table(cells: dict[str, Any]) -> str:
    """Figures of each fault over all places."""
    head = ["fault", "runs", "position at its end, m", "own sigma, m"]
    counted = ("covered", "neither", "flagged")
    head += ["yaw at its end, °", "own sigma, °", *counted, "after, s"]
    rows = []
    for fault in FAULTS:
        own = [one[SHOWN] for name, one in cells.items() if name.split(" | ")[0] == fault]
        if not own:
            continue

        def rms(key: str, own: list[dict[str, Any]] = own) -> float:
            return math.sqrt(sum(one["end"][key] ** 2 * one["runs"] for one in own) / _runs(own))

        def most(key: str, own: list[dict[str, Any]] = own) -> str:
            return f"{rms(key):.2f} ({max(one['end'][f'{key}_most'] for one in own):.2f})"

        delays = [one["delay"] for one in own if one.get("delay") is not None]
        row = [fault, str(_runs(own)), most("position"), f"{rms('position_sigma'):.2f}"]
        row += [most("yaw_deg"), f"{rms('yaw_deg_sigma'):.1f}"]
        row += [str(sum(one[key] for one in own)) for key in counted]
        rows.append([*row, f"{np.median(delays):.1f}" if delays else ""])
    return _table(head, rows)


def _runs(own: list[dict[str, Any]]) -> int:
    return sum(one["runs"] for one in own)


def real_table(cells: dict[str, Any]) -> str:
    """Table of exclusions and flags; drift is on the page of real logs."""
    head = ["logs", "runs", "hours", *(f"`{v}` turning error, °/s" for v in ("gyro", SHOWN))]
    head += ["turning, °/s", "by rules, %", "by gates, %", "flags an hour"]
    rows = []
    for name, cell in cells.items():
        if name.startswith("drift | "):
            continue
        one, turned = cell[SHOWN], ["", "", ""]
        if "turn_error" in one:
            keys = ("turn_error", "turn_error_low", "turn_error_high")
            errors = [_told(*(cell[v][key] for key in keys)) for v in ("gyro", SHOWN)]
            turned = [*errors, f"{one['turn']:.1f}"]
        if not any((*turned, _flags([one]))):
            continue
        row = [name.removeprefix("health "), str(one["runs"]), f"{one['hours']:.2f}", *turned]
        row += [f"{one['rules_percent']:.2f}", f"{one['gates_percent']:.2f}"]
        rows.append([*row, _flags([one])])
    return _table(head, rows)


def cost_table(cells: dict[str, Any]) -> str:
    """Table of times, lines and numbers."""
    forms: dict[str, Callable[[float], str]] = {
        "of_filterpy": lambda x: f"{x:.2g} times filterpy's step",
        "us": lambda x: f"{x:.1f} µs",
        "steps_per_second": lambda x: f"{x / 1e6:.1f} million steps per CPU second",
        "seconds": lambda x: f"{x:.1f} s",
        "lines": lambda x: f"{x:,.0f} lines",
        "count": lambda x: f"{x:.0f}",
    }
    rows = [
        [what, name, ", ".join(forms[key](one[key]) for key in forms if key in one)]
        for what, cell in cells.items()
        for name, one in cell.items()
        if what not in ("faults", "lines") or name == "all"
    ]
    return _table(["what", "of", "figure"], rows)


def draw_healthy(cells: dict[str, Any], path: Path) -> None:
    """Heat map of the drift over that of `gyro`, by ground and robot; worse than `gyro` is red."""
    figure, all_axes = plt.subplots(1, len(OTHERS), figsize=(14, 7.5), layout="constrained")
    norm = TwoSlopeNorm(0.0, math.log(0.2), math.log(2.0))
    picture: Any = None
    for variant, axes in zip(OTHERS, all_axes, strict=True):
        ratios = np.full((len(GROUNDS), len(ROBOTS)), np.nan)
        for row, ground in enumerate(GROUNDS):
            for column, robot in enumerate(ROBOTS):
                some = [
                    one for name, one in cells.items() if name.split(" | ")[:2] == [robot, ground]
                ]
                if some:
                    ratios[row, column] = ratio_of(some, variant)[0]
                    text = f"{ratios[row, column]:.2f}"
                    dark = not math.log(0.45) < math.log(ratios[row, column]) < math.log(1.6)
                    color = "white" if dark else "black"
                    axes.text(column, row, text, ha="center", va="center", fontsize=10, color=color)
        picture = axes.imshow(np.log(ratios), cmap="RdBu_r", norm=norm, aspect="auto")
        axes.set_facecolor("0.85")
        axes.set_xticks(range(len(ROBOTS)), ROBOTS, rotation=30, ha="right")
        axes.set_yticks(range(len(GROUNDS)), list(GROUNDS))
        axes.set_xlabel("robot")
        worse = int((ratios > 1.0).sum())
        axes.set_title(f"{variant}: worse than gyro in {worse} of {np.isfinite(ratios).sum()}")
    all_axes[0].set_ylabel("ground")
    bar = figure.colorbar(picture, ax=all_axes, shrink=0.9, pad=0.01, extend="both")
    ticks = (0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0)
    bar.set_ticks([math.log(tick) for tick in ticks], labels=[f"{tick:g}" for tick in ticks])
    bar.set_label("drift after 30 s over that of gyro [-]; red: worse than gyro")
    figure.suptitle("Healthy drives: drift over that of wheels and gyro, same runs (grey: not run)")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_faults(cells: dict[str, Any], path: Path) -> None:
    """Picture of the faults by place and variant; the number is that of runs that are neither."""
    known = {name.split(" | ")[0] for name in cells}
    faults = [name for name in FAULTS if name in known]
    places = list(dict.fromkeys(name.split(" | ")[1] for name in cells))
    columns = [(place, variant) for place in places for variant in VARIANTS]
    shown = np.full((len(faults), len(columns)), np.nan)
    width = 4.0 + 0.62 * len(columns)
    figure, axes = plt.subplots(figsize=(width, 2.6 + 0.27 * len(faults)), layout="constrained")
    for row, fault in enumerate(faults):
        for column, (place, variant) in enumerate(columns):
            one = cells.get(f"{fault} | {place}", {}).get(variant)
            if one is None:
                continue
            shown[row, column] = 2 if one["neither"] else 1 if one["alike"] else 0
            if one["neither"]:
                text = f"{one['neither']}/{one['runs']}"
                axes.text(column, row, text, ha="center", va="center", fontsize=8, color="white")
    colors = ListedColormap(["#7fbf7b", "#f5d76e", "#c0392b"])
    picture = axes.imshow(
        shown, cmap=colors, norm=BoundaryNorm((-0.5, 0.5, 1.5, 2.5), 3), aspect="auto"
    )
    axes.set_facecolor("0.9")
    axes.hlines(np.arange(len(faults) - 1) + 0.5, -0.5, len(columns) - 0.5, "white", linewidth=0.8)
    axes.set_yticks(range(len(faults)), faults, fontsize=9)
    axes.set_xticks(range(len(columns)), [one[1] for one in columns], rotation=60, ha="right")
    for k, place in enumerate(places):
        axes.axvline(len(VARIANTS) * (k + 1) - 0.5, color="white", linewidth=3)
        middle = len(VARIANTS) * k + 0.5 * (len(VARIANTS) - 1)
        short = place if len(place) < 20 else f"{place[:13]} log"
        axes.text(middle, -0.8, short.replace("_", " "), ha="center", va="bottom", fontsize=10)
    axes.set_xlabel("variant, by robot (simulated) or real log")
    bar = figure.colorbar(picture, ax=axes, ticks=(0, 1, 2), shrink=0.5, pad=0.02)
    bar.ax.set_yticklabels(
        [
            "all runs within\nown 3 sigma",
            "others within twice\nthe error without",
            "neither\n(runs)",
        ]
    )
    figure.savefig(path, dpi=110)
    plt.close(figure)
