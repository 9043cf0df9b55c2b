"""Results of a study as plain data: the content of `results.json`.

Pages, figures and tables are made from it.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.scores import HORIZONS
from icreckon.simulation.study.cells import Axis, Plan, Value
from icreckon.simulation.study.failures import failures_of
from icreckon.simulation.study.statistics import DRIFT, Statistic, statistics
from icreckon.simulation.study.summary import (
    GROUPS,
    Summary,
    jackknife_half_width,
    over_cells,
    ratio_interval,
    summarise,
)

Results = dict[str, Any]

COMMAND = "study"
USUAL_HORIZON = 30.0  # preferred horizon at which drift is reported [s]
FINAL_ERROR = "final_position_error_m"
PERCENTILES = tuple(range(101))  # percentiles that represent the distribution of the final error
ROUNDING = 1e-9  # relative difference up to which statistics of a run count as equal
SHOWN_DIGITS = 5  # digits of numbers used only in figures


@dataclass(frozen=True)
class Runs:
    """All statistics of all runs."""

    plan: Plan  # the study
    values: Floats  # (filters, cells, runs, statistics); NaN for failed runs
    reasons: Any  # (filters, cells, runs) reasons of failed runs, as text; empty for others

    @property
    def motions(self) -> Any:
        """Index (runs,) of the true motion of each run."""
        return np.arange(self.values.shape[2]) % self.plan.study.true_motions

    @property
    def statistics(self) -> tuple[Statistic, ...]:
        """Statistics along the last axis of the values."""
        return statistics(self.plan.study.horizons)


def cell_summaries(runs: Runs) -> list[list[list[Summary]]]:
    """Summaries by cell, filter and statistic."""
    return [_summaries(runs, (cell.index,)) for cell in runs.plan.cells]


def groups_of(plan: Plan, axis: Axis) -> list[Results]:
    """Cells by their value of an axis; of a Latin hypercube, `GROUPS` of neighbours.

    A group has a name, a value as its place on the axis, and the indices of its cells.
    """
    value_of = {cell.index: cell.values[axis.name] for cell in plan.cells}
    groups = []
    if not axis.sampled:
        for value in axis.values:
            cells = [index for index, own in value_of.items() if own == value]
            groups.append({"name": shown(value), "value": value, "cells": cells})
        return groups
    for part in np.array_split(np.array(axis.values, dtype=float), min(GROUPS, len(axis.values))):
        low, high = float(part[0]), float(part[-1])
        middle = float(np.sqrt(low * high) if axis.scale == "log" else 0.5 * (low + high))
        cells = [index for index, own in value_of.items() if low <= float(own) <= high]
        groups.append({"name": f"{low:.3g} to {high:.3g}", "value": middle, "cells": cells})
    return groups


def shown(value: Value) -> str:
    """Format a value of an axis for people."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return f"{value:g}" if is_number else str(value)


def study_results(runs: Runs, manifest: Results, cells: Sequence[list[list[Summary]]]) -> Results:
    """Results of a study, ready for JSON, with its manifest and `cell_summaries`."""
    plan = runs.plan
    everything = tuple(cell.index for cell in plan.cells)
    failures = failures_of(runs.reasons, plan.labels)
    return {
        "format": manifest["format"],
        "command": COMMAND,
        "name": plan.study.name,
        "description": plan.study.description,
        "configuration": manifest["configuration"],
        "seed": plan.study.seed,
        "versions": manifest["versions"],
        "engine": manifest["engine"],
        "runs": plan.study.runs,
        "true_motions": plan.study.true_motions,
        "baseline": plan.study.compared_with,
        "variants": list(plan.labels),
        "statistics": [statistic._asdict() for statistic in runs.statistics],
        "failed": {
            "runs": sum(failure["runs"] for failure in failures),
            "of": math.prod(runs.values.shape[:3]),
            "cells": [case | {"values": plan.cells[case["cell"]].values} for case in failures],
        },
        "alike": {
            "variants": [[plan.labels[k] for k in group] for group in alike(runs.values, 0)],
            "cells": alike(runs.values, 1),
        },
        "drift": _reported_drift(runs),
        "axes": manifest["axes"],
        "overall": _by_variant(runs, _summaries(runs, everything)),
        "typical": _typical(runs),
        "cells": [
            {"cell": cell.index, "values": cell.values, "variants": _by_variant(runs, summaries)}
            for cell, summaries in zip(plan.cells, cells, strict=True)
        ],
        "effects": [{"axis": axis.name, "groups": _groups(runs, axis)} for axis in plan.axes],
        "final_errors": _final_errors(runs),
    }


def _groups(runs: Runs, axis: Axis) -> list[Results]:
    """Summaries of the cells that share a value of an axis.

    Unless the axis is sampled, `to_first` has by variant the ratio of the reported drift to that at the
    first value that has one, with its interval: runs are paired, and so are cells.
    """
    groups = groups_of(runs.plan, axis)
    for group in groups:
        group["variants"] = _by_variant(runs, _summaries(runs, group["cells"]))
    drift = _reported_drift(runs)
    has_drift = [any(one[drift]["n"] for one in group["variants"].values()) for group in groups]
    if not axis.sampled and any(has_drift):
        first = groups[has_drift.index(True)]
        for group in groups:
            group["to_first"] = _ratios(runs, group["cells"], first["cells"])
    return groups


def _ratios(runs: Runs, cells: Sequence[int], others: Sequence[int]) -> Results:
    """Ratios of the reported drift in cells to that in as many others, by variant."""
    names = [statistic.name for statistic in runs.statistics]
    drifts = runs.values[..., [names.index(_reported_drift(runs))]]
    found = {}
    for label, drift in zip(runs.plan.labels, drifts, strict=True):
        own, other = drift[list(cells)], drift[list(others)]
        in_both = np.isfinite(own) & np.isfinite(other)
        means = [over_cells(np.where(in_both, each, np.nan))[:, 0] for each in (own, other)]
        known = np.isfinite(means[0])
        ratio = ratio_interval(means[0][known], means[1][known], runs.motions[known])
        found[label] = dict(zip(("ratio", "ratio_low", "ratio_high"), ratio, strict=True))
    return found


def _summaries(runs: Runs, cells: Sequence[int]) -> list[list[Summary]]:
    """Summaries by filter and statistic of the means over some cells, run by run."""
    picked = runs.values[:, list(cells)]
    baseline = picked[list(runs.plan.labels).index(runs.plan.study.compared_with)]
    motions, by_filter = runs.motions, []
    for values in picked:
        means = over_cells(values)
        # Only cells where neither failed: otherwise easy cells are compared with hard ones.
        in_both = np.isfinite(values) & np.isfinite(baseline)
        paired = over_cells(np.where(in_both, values, np.nan))
        paired_baseline = over_cells(np.where(in_both, baseline, np.nan))
        columns = zip(means.T, paired_baseline.T, paired.T, strict=True)
        by_filter.append([summarise(mean, base, motions, pair) for mean, base, pair in columns])
    return by_filter


def _by_variant(runs: Runs, summaries: list[list[Summary]]) -> dict[str, Any]:
    """Summaries as plain data: label of the filter -> name of the statistic -> data."""
    names = [statistic.name for statistic in runs.statistics]
    rows = [[asdict(summary) for summary in of_filter] for of_filter in summaries]
    by_name = [dict(zip(names, row, strict=True)) for row in rows]
    return dict(zip(runs.plan.labels, by_name, strict=True))


def _reported_drift(runs: Runs) -> str:
    """Drift over a horizon that most cells have: the longest, or the usual one."""
    names, horizons = [statistic.name for statistic in runs.statistics], runs.plan.study.horizons
    usual = USUAL_HORIZON if horizons == HORIZONS else max(horizons)
    horizons = tuple(sorted(horizons, key=lambda s: (abs(s - usual), s)))
    columns = [names.index(DRIFT.format(horizon)) for horizon in horizons]
    # Cells in which any run of any filter has the drift.
    has_drift = (np.isfinite(runs.values[..., column]).any(axis=(0, 2)) for column in columns)
    cell_counts = [int(cells.sum()) for cells in has_drift]
    return names[columns[int(np.argmax(cell_counts))]]


def _typical(runs: Runs) -> dict[str, Any]:
    """Drift and final error of a typical cell by variant; all cells weigh the same.

    `median_percent` is the median over cells of mean drifts; `ratio` of drifts and `end_ratio` of final
    errors as of `_typical_ratios`.
    """
    names = [statistic.name for statistic in runs.statistics]
    drifts, errors = (
        runs.values[..., names.index(of)] for of in (_reported_drift(runs), FINAL_ERROR)
    )
    ratios, end_ratios = _typical_ratios(runs, drifts), _typical_ratios(runs, errors)
    by_label = {}
    for number, (label, drift) in enumerate(zip(runs.plan.labels, drifts, strict=True)):
        finite_drifts = [cell[np.isfinite(cell)] for cell in drift]
        means = [float(drifts.mean()) for drifts in finite_drifts if len(drifts)]
        by_label[label] = {"median_percent": float(np.median(means)) if means else np.nan}
        for name, found in (("ratio", ratios), ("end_ratio", end_ratios)):
            ends = (name, f"{name}_low", f"{name}_high")
            by_label[label] |= zip(ends, found[number], strict=True)
    return by_label


def _typical_ratios(runs: Runs, values: Floats) -> list[tuple[float, float, float]]:
    """Geometric means over cells of the ratios to the baseline, of each variant.

    Each has the ends of its 95 % interval, by leaving out true motions one by one. `values` are
    (filters, cells, runs).
    """
    motions = runs.motions
    baseline = values[list(runs.plan.labels).index(runs.plan.study.compared_with)]

    def log_ratio(value: Floats, counted: Any) -> float:
        """Mean over cells of the log of the ratio, over `counted` runs (mask, or True)."""
        in_both = np.isfinite(value) & np.isfinite(baseline) & counted
        value_sum = np.where(in_both, value, 0.0).sum(axis=1)
        baseline_sum = np.where(in_both, baseline, 0.0).sum(axis=1)
        has_ratio = np.asarray((value_sum > 0.0) & (baseline_sum > 0.0))
        if not has_ratio.any():
            return math.nan
        return float(np.log(value_sum[has_ratio] / baseline_sum[has_ratio]).mean())

    found = []
    for value in values:
        without_one = [log_ratio(value, motions != motion) for motion in np.unique(motions)]
        mean, half_width = log_ratio(value, True), jackknife_half_width(np.array(without_one))
        low, high = mean - half_width, mean + half_width
        found.append((math.exp(mean), math.exp(low), math.exp(high)))
    return found


def _final_errors(runs: Runs) -> list[Results]:
    """Percentiles of the final position error over all cells, by variant that has one."""
    column, found = [statistic.name for statistic in runs.statistics].index(FINAL_ERROR), {}
    for label, values in zip(runs.plan.labels, runs.values[..., column], strict=True):
        errors = values[np.isfinite(values)]
        if len(errors):
            exact = np.percentile(errors, PERCENTILES).tolist()
            found[label] = [float(f"{value:.{SHOWN_DIGITS}g}") for value in exact]
    return [{"axis": "", "group": "all runs", "percentiles": found}]


def alike(values: Floats, axis: int) -> list[list[int]]:
    """Group filters (axis 0) or cells (axis 1) with equal statistics, to rounding.

    Groups have two or more indices; values (filters, cells, runs, statistics) are NaN if missing.
    """
    items = np.moveaxis(values, axis, 0)
    known = np.isfinite(items)
    # Equal items have equal sums: only neighbours in their order need to be compared.
    sums = np.where(known, items, 0.0).reshape(len(items), -1).sum(axis=1)
    groups: list[list[int]] = []
    for index in np.argsort(sums, kind="stable").tolist():
        if not known[index].any():
            continue
        if groups and _same(items[groups[-1][0]], items[index]):
            groups[-1].append(index)
        else:
            groups.append([index])
    return sorted(sorted(group) for group in groups if len(group) > 1)


def _same(first: Any, other: Any) -> bool:
    """Return True if values are equal to `ROUNDING`, and missing in the same places."""
    if not np.array_equal(np.isfinite(first), np.isfinite(other)):
        return False
    larger = np.maximum(np.abs(first), np.abs(other))
    # Comparisons with NaN are False: missing values do not differ.
    return not (np.abs(first - other) > ROUNDING * larger).any()
