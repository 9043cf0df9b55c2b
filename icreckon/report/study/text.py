"""Text and tables of a study, made from its results only."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from icreckon.report.printable import change, change_range
from icreckon.simulation.study.results import FINAL_ERROR, Results, shown

# Most cells of a table by cell; with more, tables are by axis.
MOST_CELLS = 24
NEES = "nees_pose_end"
# NEES from which a filter is much too sure, the mark next to it, and keys that change the sensors' noise.
MUCH_NEES, MARK = 6.0, "*"
NOISE_KEYS = ("noise", "gyro", "accelerometer", "encoders")
# First word of failure messages.
ERROR = "ERROR"
# Most failures and reasons in the text; `results.json` lists all.
MOST_FAILURES, MOST_REASONS = 12, 3
# Longest reason in a table [characters]; the list of failures has it in full.
LONGEST_REASON = 60
# Text for a statistic that runs with a result need not have, as a drift without an outage.
NO_VALUE = "none to score"


@dataclass(frozen=True)
class TextTable:
    """Table with title, headings and rows; the first `texts` columns are text."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int


def headline(results: Results) -> str:
    """Summarise the results in a few sentences."""
    drift, baseline, overall = results["drift"], results["baseline"], results["overall"]
    count = len(results["cells"])
    runs = f"{count} {'cell' if count == 1 else 'cells'} of {results['runs']} runs each"
    summary = overall[baseline][drift]
    if overall[baseline][FINAL_ERROR]["n"] == 0:
        return f"{ERROR}: over {runs}, {baseline} has no result; there is nothing to compare with."
    if summary["n"] == 0:
        return f"Over {runs}, nowhere long enough without fixes to score the drift of {baseline}."
    after, typical = title_of(results, drift).removeprefix("drift "), results["typical"]
    cells = [cell["variants"][baseline][drift]["mean"] for cell in results["cells"]]
    known = [mean for mean in cells if _finite(mean)]
    spread = f", {_number(min(known))} to {_number(max(known))} by cell" if len(known) > 1 else ""
    middle = "the median drift of" if len(known) > 1 else "the drift of"
    percent = _number(typical[baseline]["median_percent"])
    sentences = [f"Over {runs}, {middle} {baseline} is {percent} % of distance {after}{spread}."]
    sentences += [
        _comparison(results, name)
        for name in results["variants"]
        if name != baseline and overall[name][drift]["pairs"]
    ]
    failed = results["failed"]
    if failed["runs"]:
        sentences.append(f"{ERROR}: {failed['runs']} of {failed['of']} runs failed.")
    return " ".join(sentences)


def _comparison(results: Results, name: str) -> str:
    """Drift of a variant in a typical cell, and where it wins and loses."""
    drift, baseline = results["drift"], results["baseline"]
    typical = results["typical"][name]
    low, high = typical["ratio_low"], typical["ratio_high"]
    text = f"{name} drifts {change(typical['ratio'])} than {baseline}"
    if _finite(low) and _finite(high):
        text += change_range((low, high), "; not significant" if low <= 1.0 <= high else "")
    ratios = [(cell["variants"][name][drift], _values_of(cell)) for cell in results["cells"]]
    ratios = [one for one in ratios if _finite(one[0]["ratio"]) and _finite(one[0]["ratio_low"])]
    if len(ratios) > 1:
        wins = [one for one in ratios if one[0]["ratio_high"] < 1.0]
        losses = [one for one in ratios if one[0]["ratio_low"] > 1.0]
        text += (
            f", significantly less in {len(wins)} and more in {len(losses)} of {len(ratios)} cells"
        )
        ends = [
            which(found, key=lambda one: one[0]["ratio"])
            for found, which in ((wins, min), (losses, max))
            if found
        ]
        if ends:
            text += ": " + ", ".join(f"{change(one['ratio'])} at {place}" for one, place in ends)
    end = results["overall"][name][FINAL_ERROR]
    end_contradicts_drift = _finite(end["ratio_low"]) and (
        (typical["ratio"] < 1.0 < end["ratio_low"]) or (end["ratio_high"] < 1.0 < typical["ratio"])
    )
    if end_contradicts_drift:
        text += f". Its error at the end is {change(end['ratio'])} ({_between(end, 'ratio')} times)"
    return f"{text}."


def _values_of(cell: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {shown(value)}" for key, value in cell["values"].items())


def failures(results: Results) -> list[str]:
    """Describe failed runs, one line for each cell and variant; empty if none failed."""
    failed = results["failed"]
    if not failed["runs"]:
        return []
    lines = [
        f"{ERROR}: {failed['runs']} of {failed['of']} runs failed. They are in no table and no figure."
    ]
    lines += [_failure(one) for one in failed["cells"][:MOST_FAILURES]]
    more = len(failed["cells"]) - MOST_FAILURES
    if more > 0:
        lines.append(f"{more} more cells and variants with failed runs: see results.json.")
    return lines


def same_results(results: Results) -> list[str]:
    """Describe variants and cells with equal results; empty if all differ."""
    lines = [
        f"{_listed(labels)} gave the same results to rounding: what they differ in has no effect here."
        for labels in results["alike"]["variants"]
    ]
    groups = results["alike"]["cells"]
    for group in groups[:MOST_FAILURES]:
        named = [_cell_text(results["cells"][cell]) for cell in group[:MOST_FAILURES]]
        more = len(group) - len(named)
        named += [f"{more} more"] if more else []
        lines.append(
            f"{_listed(named)} gave the same results to rounding: what they differ in has no effect."
        )
    if len(groups) > MOST_FAILURES:
        lines.append(f"{len(groups) - MOST_FAILURES} more groups of such cells: see results.json.")
    return lines


def _cell_text(cell: dict[str, Any]) -> str:
    values = _values_of(cell)
    return f"cell {cell['cell']} ({values})" if values else ""


def _failure(one: dict[str, Any]) -> str:
    where = f"{_cell_text(one)}, " if one["values"] else ""
    reasons = [
        f"{reason['reason']} (run {reason['first_run']}"
        + (f" and {reason['runs'] - 1} more)" if reason["runs"] > 1 else ")")
        for reason in one["reasons"][:MOST_REASONS]
    ]
    more = len(one["reasons"]) - MOST_REASONS
    reasons += [f"{more} other reasons"] if more > 0 else []
    what = f"{one['runs']} of {one['of']} runs failed"
    if one["runs"] == one["of"]:
        what = f"no result, all {one['of']} runs failed"
    return f"{where}{one['variant']}: {what}: {'; '.join(reasons)}"


def notes(results: Results, *, narrow: bool = False) -> list[str]:
    """Explain the numbers in the tables; arguments as for `summary_tables`."""
    runs, motions = results["runs"], results["true_motions"]
    shared = "" if motions == runs else f" of {motions} true motions"
    how = "Student's t, over true motions"
    intervals = (
        f"×/÷ the factor of the 95 % interval of the mean ({how})"
        if narrow
        else f"in brackets 95 % intervals of the mean ({how}; on a log scale)"
    )
    percentile = "" if narrow else ", and 95th percentile of the runs"
    return [
        f"{runs} runs{shared} in each cell, paired over cells and variants; {intervals}.",
        f"Ratios are to {results['baseline']}, of means over the same runs. Final errors: "
        f"median{percentile}. NEES of the pose at the end: 3 is ideal, more is too sure.",
        *_unknown_noise(results),
    ]


def _unknown_noise(results: Results) -> list[str]:
    """Explain a large NEES of filters without the swept noise; empty otherwise."""
    study = results["configuration"]
    sweep = study.get("sweep") or {}
    cases = [keys for named in (sweep.get("cases") or {}).values() for keys in named.values()]
    swept = [*(sweep.get("grid") or {}), *((sweep.get("latin") or {}).get("ranges") or {})]
    swept += [key for keys in cases for key in keys if not any("filter.imu" in one for one in keys)]
    noisy = sorted({key for key in swept if key.split(".")[0] in NOISE_KEYS})
    nees = [one[NEES]["mean"] for cell in results["cells"] for one in cell["variants"].values()]
    largest = max(filter(_finite, nees), default=0.0)
    if study.get("filters_know_noise") or not noisy or largest < MUCH_NEES:
        return []
    return [
        f"{MARK}: the filters assume the noise of the robot file, whatever {', '.join(noisy)} is, and "
        "are too sure where it is larger; `filters_know_noise = true` in the study file tells them."
    ]


def summary_tables(results: Results, *, narrow: bool = False) -> list[TextTable]:
    """Make tables by cell, or by axis if there are many cells.

    `results` are those of `study_results`. Narrow tables omit columns, and give intervals as factors, to
    fit 80 characters.
    """
    cells = results["cells"]
    axes = [axis["name"] for axis, _ in swept(results)]
    if len(cells) <= MOST_CELLS and not any(axis["sampled"] for axis in results["axes"]):
        places = [
            (tuple(shown(cell["values"][axis]) for axis in axes), cell["variants"], (cell["cell"],))
            for cell in cells
        ]
        return [_table(results, "by cell" if axes else "", tuple(axes), places, narrow)]
    tables = []
    for _, effect in swept(results):
        places = [
            ((group["name"],), group["variants"], tuple(group["cells"]))
            for group in effect["groups"]
        ]
        title = f"by {effect['axis']}, over all else that is swept"
        tables.append(_table(results, title, (effect["axis"],), places, narrow))
    return tables


def swept(results: Results) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Axes with more than one value, each with its effect."""
    pairs = zip(results["axes"], results["effects"], strict=True)
    return [(axis, effect) for axis, effect in pairs if len(effect["groups"]) > 1]


def title_of(results: Results, statistic: str) -> str:
    """Title of a statistic."""
    return str(_statistic(results, statistic)["title"])


def unit_of(results: Results, statistic: str) -> str:
    """Unit of a statistic."""
    return str(_statistic(results, statistic)["unit"])


def _statistic(results: Results, name: str) -> dict[str, Any]:
    return next(one for one in results["statistics"] if one["name"] == name)


def _table(
    results: Results,
    title: str,
    axes: tuple[str, ...],
    places: Sequence[tuple[tuple[str, ...], dict[str, Any], tuple[int, ...]]],
    narrow: bool,
) -> TextTable:
    drift = results["drift"]
    drifts = f"{title_of(results, drift)}, %"
    if narrow:
        numbers = [drifts.replace(" after", "\nafter"), "ratio", "final\nerror, m", "NEES"]
    else:
        ratios = f"ratio to {results['baseline']}"
        numbers = [drifts, ratios, "final error, m", "95th percentile, m", "NEES at the end"]
    head = [*(_last_parts(axes) if narrow else axes), "variant", *numbers]
    interval = _with_factor if narrow else _with_interval
    rows, noise_is_unknown = [], bool(_unknown_noise(results))
    for values, variants, inside in places:
        for number, (name, one) in enumerate(variants.items()):
            summary = one[drift]
            place = values if number == 0 else ("",) * len(values)
            failed = [
                found
                for found in results["failed"]["cells"]
                if found["variant"] == name and found["cell"] in inside
            ]
            if one[FINAL_ERROR]["n"] == 0:
                blank = len(head) - len(place) - 2
                reason = _first_reason(failed) if failed else "no result"
                rows.append((*place, name, f"{ERROR}: {reason}", *[""] * blank))
                continue
            is_baseline = name == results["baseline"]
            if failed:
                count, of = sum(found["runs"] for found in failed), results["runs"] * len(inside)
                name = f"{name}\n({count} of {of} runs failed: {_first_reason(failed)})"
            row = [*place, name, interval(summary, "mean")]
            row += ["1" if is_baseline else interval(summary, "ratio")]
            row += [_number(one[FINAL_ERROR]["median"])]
            row += [] if narrow else [_number(one[FINAL_ERROR]["p95"])]
            nees = _number(one[NEES]["mean"]) if narrow else _with_interval(one[NEES], "mean")
            is_large = _finite(one[NEES]["mean"]) and one[NEES]["mean"] >= MUCH_NEES
            row += [f"{nees} {MARK}" if noise_is_unknown and is_large else nees]
            rows.append(tuple(row))
    return TextTable(title, tuple(head), tuple(rows), len(axes) + 1)


def _last_parts(axes: tuple[str, ...]) -> tuple[str, ...]:
    """Shorten names to the part after their last dot, unless two become equal."""
    last = tuple(axis.rsplit(".", 1)[-1] for axis in axes)
    return last if len(set(last)) == len(last) else axes


def _first_reason(failed: Sequence[dict[str, Any]]) -> str:
    """Most frequent reason of failed runs, shortened."""
    reasons = [reason for one in failed for reason in one["reasons"]]
    text = str(max(reasons, key=lambda one: int(one["runs"]))["reason"])
    if len(text) > LONGEST_REASON:
        text = f"{text[:LONGEST_REASON]}…"
    return text + (", and others" if len(reasons) > 1 else "")


def _with_interval(summary: dict[str, Any], key: str) -> str:
    if not _finite(summary[key]):
        return NO_VALUE
    return f"{_number(summary[key])} ({_between(summary, key)})"


def _with_factor(summary: dict[str, Any], key: str) -> str:
    """Format a mean and the factor of its interval, which is even on a log scale."""
    value, high = summary[key], summary[f"{key}_high"]
    if not (_finite(value) and _finite(high) and value > 0.0):
        return _number(value) if _finite(value) else NO_VALUE
    return f"{_number(value)} ×/÷ {high / value:.2f}"


def _between(summary: dict[str, Any], key: str) -> str:
    """Format an interval with the decimals of its estimate."""
    low, high = summary[f"{key}_low"], summary[f"{key}_high"]
    if not (_finite(low) and _finite(high)):
        return "one true motion"
    form = _form(summary[key])
    return f"{low:{form}} to {high:{form}}"


def _number(value: float | None) -> str:
    return f"{value:{_form(value)}}" if value is not None and _finite(value) else "-"


def _finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def _form(value: float) -> str:
    """Number format: two decimals, more for small values and fewer for large ones."""
    size = abs(value)
    if size >= 1e4 or 0.0 < size < 5e-4:
        return ".1e"
    return f".{0 if size >= 100.0 else 1 if size >= 10.0 else 2 if size >= 0.1 else 4}f"


def _listed(parts: list[str]) -> str:
    return ", ".join(parts) if len(parts) < 2 else f"{', '.join(parts[:-1])} and {parts[-1]}"
