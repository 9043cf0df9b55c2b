"""Text and tables of a study, made from its results only."""

from collections.abc import Sequence
from operator import itemgetter
from typing import Any, NamedTuple

from icreckon.estimator.base.checks import is_finite
from icreckon.report.printable import change, change_range
from icreckon.simulation.study.results import FINAL_ERROR, Results, shown

MOST_CELLS = 24  # most cells of a table by cell; with more, tables are by axis
NEES = "nees_pose_end"
# NEES from which a filter is much too sure, the mark next to it, and keys that change the sensors' noise.
MUCH_NEES, MARK = 6.0, "*"
NOISE_KEYS = ("noise", "gyro", "accelerometer", "encoders")
NOT_SET = ("resolution", "range")  # of them, `filters_know_noise` does not set those
ERROR = "ERROR"  # first word of failure messages
# Most failures and reasons in the text; `results.json` lists all.
MOST_FAILURES, MOST_REASONS = 12, 3
LONGEST_REASON = 60  # longest reason in a table [characters]; the list of failures has it in full
NO_VALUE = "none to score"  # text for a statistic that a run lacks, as a drift without an outage


class TextTable(NamedTuple):
    """Table with title, headings and rows; the first `texts` columns are text."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int


class _Place(NamedTuple):
    """Cell, or group of cells, for which a table has a row of each variant."""

    values: tuple[str, ...]  # its value on each axis, as text
    variants: dict[str, Any]  # summaries of its statistics by label
    cells: list[int]  # indices of its cells


def headline(results: Results) -> str:
    """Summarise the results in a few sentences."""
    drift, baseline, overall = results["drift"], results["baseline"], results["overall"]
    count = len(results["cells"])
    runs = f"{count} {'cell' if count == 1 else 'cells'} of {results['runs']} runs each"
    if overall[baseline][FINAL_ERROR]["n"] == 0:
        return f"{ERROR}: over {runs}, {baseline} has no result; there is nothing to compare with."
    if overall[baseline][drift]["n"] == 0:
        return f"Over {runs}, nowhere long enough without fixes to score the drift of {baseline}."
    after_horizon = statistic_of(results, drift)["title"].removeprefix("drift ")
    drifts = [cell["variants"][baseline][drift]["mean"] for cell in results["cells"]]
    known = [mean for mean in drifts if is_finite(mean)]
    drift_text, spread = "the drift", ""
    if len(known) > 1:
        drift_text = "the median drift"
        spread = f", {_number(min(known))} to {_number(max(known))} by cell"
    percent = _number(results["typical"][baseline]["median_percent"])
    distance = f"distance {after_horizon}{spread}"
    sentences = [f"Over {runs}, {drift_text} of {baseline} is {percent} % of {distance}."]
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
    """Drift of a variant against the baseline: in a typical cell, wins and losses."""
    baseline, typical = results["baseline"], results["typical"][name]
    text = f"{name} drifts {change(typical['ratio'])} than {baseline}"
    if is_finite(typical["ratio_low"]) and is_finite(typical["ratio_high"]):
        text += _significance(typical)
    text += _wins_and_losses(results, name)
    low, high = typical["end_ratio_low"], typical["end_ratio_high"]
    if is_finite(low) and any(map(_is_contradicted, results["typical"].values())):
        end_error = f"{change(typical['end_ratio'])}{change_range((low, high), '')}"
        text += f". Its error at the end is {end_error}"
    return f"{text}."


def _significance(ratios: dict[str, Any]) -> str:
    """Interval of a ratio in brackets, with a remark if it holds 1."""
    low, high = ratios["ratio_low"], ratios["ratio_high"]
    return change_range((low, high), "; not significant" if low <= 1.0 <= high else "")


def _is_contradicted(typical: dict[str, Any]) -> bool:
    """Return True if the error at the end of a variant contradicts its drift."""
    ratio, low, high = typical["ratio"], typical["end_ratio_low"], typical["end_ratio_high"]
    return is_finite(low) and (ratio < 1.0 < low or high < 1.0 < ratio)


def _wins_and_losses(results: Results, name: str) -> str:
    """Cells in which a variant drifts significantly less and more than the baseline.

    Names those of the largest win and loss. Empty for fewer than two cells with an interval.
    """
    ratios = [(cell["variants"][name][results["drift"]], cell) for cell in results["cells"]]
    keys = ("ratio", "ratio_low", "ratio_high")
    known = [(drift, cell) for drift, cell in ratios if all(is_finite(drift[key]) for key in keys)]
    if len(known) < 2:
        return ""
    wins = [(drift["ratio"], cell) for drift, cell in known if drift["ratio_high"] < 1.0]
    losses = [(drift["ratio"], cell) for drift, cell in known if drift["ratio_low"] > 1.0]
    text = f", significantly less in {len(wins)} and more in {len(losses)} of {len(known)} cells"
    # The largest of either; none if there is none.
    extremes = sorted(wins, key=itemgetter(0))[:1]
    extremes += sorted(losses, key=itemgetter(0), reverse=True)[:1]
    places = [f"{change(ratio)} at {_values_text(cell)}" for ratio, cell in extremes]
    return f"{text}: {', '.join(places)}" if places else text


def _values_text(cell: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {shown(value)}" for key, value in cell["values"].items())


def failures(results: Results) -> list[str]:
    """Describe failed runs, one line for each cell and variant; empty if none failed."""
    failed = results["failed"]
    if not failed["runs"]:
        return []
    count = f"{failed['runs']} of {failed['of']} runs failed"
    lines = [f"{ERROR}: {count}. They are in no table and no figure."]
    lines += [_failure_text(failure) for failure in failed["cells"][:MOST_FAILURES]]
    more = len(failed["cells"]) - MOST_FAILURES
    if more > 0:
        lines.append(f"{more} more cells and variants with failed runs: see results.json.")
    return lines


def same_results(results: Results) -> list[str]:
    """Describe variants and cells with equal results; empty if all differ."""
    same = "gave the same results to rounding: what they differ in has no effect"
    lines = [f"{_listed(labels)} {same} here." for labels in results["alike"]["variants"]]
    cell_groups = results["alike"]["cells"]
    for cells in cell_groups[:MOST_FAILURES]:
        names = [_cell_text(results["cells"][cell]) for cell in cells[:MOST_FAILURES]]
        if len(cells) > len(names):
            names.append(f"{len(cells) - len(names)} more")
        lines.append(f"{_listed(names)} {same}.")
    more = len(cell_groups) - MOST_FAILURES
    if more > 0:
        lines.append(f"{more} more groups of such cells: see results.json.")
    return lines


def _cell_text(cell: dict[str, Any]) -> str:
    """Name of a cell with its values; empty for the one cell without a sweep."""
    values = _values_text(cell)
    return f"cell {cell['cell']} ({values})" if values else ""


def _failure_text(failure: dict[str, Any]) -> str:
    """Cell and variant of failed runs, their number, and the most frequent reasons."""
    place = f"{_cell_text(failure)}, " if failure["values"] else ""
    reasons = []
    for reason in failure["reasons"][:MOST_REASONS]:
        more = f" and {reason['runs'] - 1} more" if reason["runs"] > 1 else ""
        reasons.append(f"{reason['reason']} (run {reason['first_run']}{more})")
    if len(failure["reasons"]) > MOST_REASONS:
        reasons.append(f"{len(failure['reasons']) - MOST_REASONS} other reasons")
    failed, runs = failure["runs"], failure["of"]
    extent = f"no result, all {runs}" if failed == runs else f"{failed} of {runs}"
    return f"{place}{failure['variant']}: {extent} runs failed: {'; '.join(reasons)}"


def notes(results: Results, *, narrow: bool = False) -> list[str]:
    """Explain the numbers in the tables; arguments as for `summary_tables`."""
    runs, motions = results["runs"], results["true_motions"]
    shared = "" if motions == runs else f" of {motions} true motions"
    method = "Student's t, over true motions"
    intervals = f"in brackets 95 % intervals of the mean ({method}; on a log scale)"
    if narrow:
        intervals = f"×/÷ the factor of the 95 % interval of the mean ({method})"
    percentile = "" if narrow else ", and 95th percentile of the runs"
    return [
        *_levels(results),
        f"{runs} runs{shared} in each cell, paired over cells and variants; {intervals}.",
        f"Ratios are to {results['baseline']}, of means over the same runs. Final errors: "
        f"median{percentile}. NEES of the pose at the end: 3 is ideal, more is too sure.",
        *_large_nees_note(results),
    ]


def _levels(results: Results) -> list[str]:
    """Compare the values of each axis with its first, by the best variant."""
    typical, lines = results["typical"], []
    known = [name for name in typical if is_finite(typical[name]["ratio"])]
    best = min(known, key=lambda name: float(typical[name]["ratio"]), default="")
    for axis, effect in swept(results):
        # Ratios of the drift to that at the first value of the axis, by value.
        ratios = {
            group["name"]: group["to_first"][best]
            for group in effect["groups"]
            if is_finite(group.get("to_first", {}).get(best, {}).get("ratio_low"))
        }
        if len(ratios) < 2:
            continue
        first, *others = ratios
        parts = [
            f"{change(ratios[name]['ratio'])} at {name}{_significance(ratios[name])}"
            for name in others
        ]
        lines.append(f"{axis['name']}, drift of {best} compared with {first}: {'; '.join(parts)}.")
    return lines


def _large_nees_note(results: Results) -> list[str]:
    """Note on a large NEES and what may be its cause; empty without one."""
    variants = [scores for cell in results["cells"] for scores in cell["variants"].values()]
    nees = [scores[NEES]["mean"] for scores in variants]
    if max(filter(is_finite, nees), default=0.0) < MUCH_NEES:
        return []
    study = results["configuration"]
    sweep = study.get("sweep") or {}
    keys = [*(sweep.get("grid") or {}), *((sweep.get("latin") or {}).get("ranges") or {})]
    for changes_by_case in (sweep.get("cases") or {}).values():
        for changes in changes_by_case.values():
            # A case that also sets the filter's own IMU noise does not count.
            if not any("filter.imu" in key for key in changes):
                keys += changes
    noisy = sorted(
        {key for key in keys if key.split(".")[0] in NOISE_KEYS and not key.endswith(NOT_SET)}
    )
    text = f"{MARK}: errors exceed by far what the robot file states."
    if noisy and not study.get("filters_know_noise"):
        text += (
            f" The filters assume its noise, whatever {', '.join(noisy)} is: where that is larger, "
            "`filters_know_noise = true` in the study file tells them."
        )
    return [f"{text} Slopes, ground and wrong parameters are causes, too."]


def summary_tables(results: Results, *, narrow: bool = False) -> list[TextTable]:
    """Make tables by cell, or by axis if there are many cells.

    `results` are those of `study_results`. Narrow tables omit columns, and give intervals as factors, to
    fit 80 characters.
    """
    cells = results["cells"]
    axes = tuple(axis["name"] for axis, _ in swept(results))
    if len(cells) <= MOST_CELLS and not any(axis["sampled"] for axis in results["axes"]):
        places = []
        for cell in cells:
            values = tuple(shown(cell["values"][axis]) for axis in axes)
            places.append(_Place(values, cell["variants"], [cell["cell"]]))
        return [_table(results, "by cell" if axes else "", axes, places, narrow)]
    tables = []
    for _, effect in swept(results):
        groups = effect["groups"]
        places = [_Place((group["name"],), group["variants"], group["cells"]) for group in groups]
        title = f"by {effect['axis']}, over all else that is swept"
        tables.append(_table(results, title, (effect["axis"],), places, narrow))
    return tables


def swept(results: Results) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Axes with more than one value, each with its effect."""
    pairs = zip(results["axes"], results["effects"], strict=True)
    return [(axis, effect) for axis, effect in pairs if len(effect["groups"]) > 1]


def statistic_of(results: Results, name: str) -> dict[str, Any]:
    """Title and unit of a statistic, by these keys."""
    return next(statistic for statistic in results["statistics"] if statistic["name"] == name)


def _table(
    results: Results, title: str, axes: tuple[str, ...], places: Sequence[_Place], narrow: bool
) -> TextTable:
    """Table with a row for each place and variant; the first row of a place names it."""
    drift = f"{statistic_of(results, results['drift'])['title']}, %"
    if narrow:
        numbers = [drift.replace(" after", "\nafter"), "ratio", "median\nfinal\nerror, m", "NEES"]
    else:
        ratio = f"ratio to {results['baseline']}"
        numbers = [drift, ratio, "median final error, m", "95th percentile, m", "NEES at the end"]
    rows = []
    for place in places:
        values = place.values
        for label in place.variants:
            texts = _variant_texts(results, place, label, narrow)
            # An error stands in place of all numbers.
            blanks = [""] * (1 + len(numbers) - len(texts))
            rows.append((*values, *texts, *blanks))
            values = ("",) * len(axes)
    last_parts = [axis.rpartition(".")[2] for axis in axes]
    # Shortened to the part after the last dot, unless two become equal.
    is_shortened = narrow and len(set(last_parts)) == len(axes)
    head = (*(last_parts if is_shortened else axes), "variant", *numbers)
    return TextTable(title, head, tuple(rows), len(axes) + 1)


def _variant_texts(results: Results, place: _Place, label: str, narrow: bool) -> list[str]:
    """Label and numbers of a variant at a place; label and error if it has no result."""
    summaries = place.variants[label]
    failed = [failure for failure in results["failed"]["cells"] if failure["variant"] == label]
    failed = [failure for failure in failed if failure["cell"] in place.cells]
    if summaries[FINAL_ERROR]["n"] == 0:
        return [label, f"{ERROR}: {_first_reason(failed) if failed else 'no result'}"]
    name = label
    if failed:
        count = sum(failure["runs"] for failure in failed)
        runs = results["runs"] * len(place.cells)
        name = f"{label}\n({count} of {runs} runs failed: {_first_reason(failed)})"
    drift, final_error, nees = (summaries[key] for key in (results["drift"], FINAL_ERROR, NEES))
    with_interval = _with_factor if narrow else _with_interval
    ratio = "1" if label == results["baseline"] else with_interval(drift, "ratio")
    errors = [_number(final_error[key]) for key in (("median",) if narrow else ("median", "p95"))]
    nees_text = _number(nees["mean"]) if narrow else _with_interval(nees, "mean")
    if is_finite(nees["mean"]) and nees["mean"] >= MUCH_NEES:
        nees_text += f" {MARK}"
    return [name, with_interval(drift, "mean"), ratio, *errors, nees_text]


def _first_reason(failed: Sequence[dict[str, Any]]) -> str:
    """Most frequent reason of failed runs, shortened."""
    reasons = [reason for failure in failed for reason in failure["reasons"]]
    text = str(max(reasons, key=lambda reason: int(reason["runs"]))["reason"])
    if len(text) > LONGEST_REASON:
        text = f"{text[:LONGEST_REASON]}…"
    return text + (", and others" if len(reasons) > 1 else "")


def _with_interval(summary: dict[str, Any], key: str) -> str:
    """Format the "mean" or the "ratio" of a summary, with its 95 % interval."""
    value, low, high = (summary[f"{key}{end}"] for end in ("", "_low", "_high"))
    if not is_finite(value):
        return NO_VALUE
    if not (is_finite(low) and is_finite(high)):
        return f"{_number(value)} (one true motion)"  # whose runs show no spread of the means
    decimals = _number_format(value)
    return f"{_number(value)} ({low:{decimals}} to {high:{decimals}})"


def _with_factor(summary: dict[str, Any], key: str) -> str:
    """Format a mean and the factor of its interval, which is even on a log scale."""
    value, high = summary[key], summary[f"{key}_high"]
    if not (is_finite(value) and is_finite(high) and value > 0.0):
        return _number(value) if is_finite(value) else NO_VALUE
    return f"{_number(value)} ×/÷ {high / value:.2f}"


def _number(value: float | None) -> str:
    return f"{value:{_number_format(value)}}" if value is not None and is_finite(value) else "-"


def _number_format(value: float) -> str:
    """Number format: two decimals, more for small values and fewer for large ones."""
    size = abs(value)
    if size >= 1e4 or 0.0 < size < 5e-4:
        return ".1e"
    return f".{0 if size >= 100.0 else 1 if size >= 10.0 else 2 if size >= 0.1 else 4}f"


def _listed(parts: list[str]) -> str:
    return ", ".join(parts) if len(parts) < 2 else f"{', '.join(parts[:-1])} and {parts[-1]}"
