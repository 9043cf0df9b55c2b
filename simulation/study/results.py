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

    @property
    def baseline(self) -> Floats:
        """Values (cells, runs, statistics) of the filter with which others are compared."""
        labels = self.plan.labels
        return np.asarray(self.values[labels.index(self.plan.study.compared_with)])

    def column(self, statistic: str) -> int:
        """Index of a statistic along the last axis of the values, by its name."""
        return [kind.name for kind in self.statistics].index(statistic)


def cell_summaries(runs: Runs) -> list[list[list[Summary]]]:
    """Summaries by cell, filter and statistic."""
    return [_summaries(runs, (cell.index,)) for cell in runs.plan.cells]


def groups_of(plan: Plan, axis: Axis) -> list[Results]:
    """Cells by their value of an axis; of a Latin hypercube, `GROUPS` of neighbours.

    A group has a name, a value as its place on the axis, and the indices of its cells.
    """
    cell_values = [cell.values[axis.name] for cell in plan.cells]
    groups = []
    if not axis.sampled:
        for value in axis.values:
            cells = [index for index, own in enumerate(cell_values) if own == value]
            groups.append({"name": shown(value), "value": value, "cells": cells})
        return groups
    for part in np.array_split(np.array(axis.values, dtype=float), min(GROUPS, len(axis.values))):
        low, high = float(part[0]), float(part[-1])
        middle = float(np.sqrt(low * high) if axis.scale == "log" else 0.5 * (low + high))
        cells = [index for index, own in enumerate(cell_values) if low <= float(own) <= high]
        groups.append({"name": f"{low:.3g} to {high:.3g}", "value": middle, "cells": cells})
    return groups


def shown(value: Value) -> str:
    """Format a value of an axis for people."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return f"{value:g}" if is_number else str(value)


def study_results(runs: Runs, manifest: Results, cells: Sequence[list[list[Summary]]]) -> Results:
    """Results of a study, ready for JSON, with its manifest and `cell_summaries`."""
    plan = runs.plan
    failures = failures_of(runs.reasons, plan.labels)
    return {
        "format": manifest["format"],
        "command": COMMAND,
        "name": plan.study.name,
        "description": plan.study.description,
        **{key: manifest[key] for key in ("configuration", "robot", "remarks")},
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
        "overall": _by_variant(runs, _summaries(runs, range(len(plan.cells)))),
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
    drift, first = _reported_drift(runs), None
    for group in groups:
        variants = group["variants"] = _by_variant(runs, _summaries(runs, group["cells"]))
        if first is None and any(summaries[drift]["n"] for summaries in variants.values()):
            first = group
    if first is not None and not axis.sampled:
        for group in groups:
            group["to_first"] = _drift_ratios(runs, group["cells"], first["cells"])
    return groups


def _drift_ratios(runs: Runs, cells: Sequence[int], first_cells: Sequence[int]) -> Results:
    """Ratio of the reported drift in cells to that in as many others, by variant."""
    column = runs.column(_reported_drift(runs))
    ratios = {}
    for label, values in zip(runs.plan.labels, runs.values, strict=True):
        drifts, first_drifts = values[list(cells), :, column], values[list(first_cells), :, column]
        means, first_means = _paired_means(drifts[..., None], first_drifts[..., None])
        known = np.isfinite(means[:, 0])
        ratio = ratio_interval(means[known, 0], first_means[known, 0], runs.motions[known])
        ratios[label] = dict(zip(("ratio", "ratio_low", "ratio_high"), ratio, strict=True))
    return ratios


def _paired_means(values: Floats, others: Floats) -> tuple[Floats, Floats]:
    """Means (runs, statistics) over the cells in which a run has both values.

    Both are (cells, runs, statistics). Without this pairing, easy cells would be compared with hard ones.
    """
    has_both = np.isfinite(values) & np.isfinite(others)
    paired, paired_others = (np.where(has_both, part, np.nan) for part in (values, others))
    return over_cells(paired), over_cells(paired_others)


def _summaries(runs: Runs, cells: Sequence[int]) -> list[list[Summary]]:
    """Summaries by filter and statistic of the means over some cells, run by run."""
    baseline, motions = runs.baseline[list(cells)], runs.motions
    summaries = []
    for values in runs.values[:, list(cells)]:
        paired, paired_baseline = _paired_means(values, baseline)
        columns = zip(over_cells(values).T, paired_baseline.T, paired.T, strict=True)
        summaries.append([summarise(mean, base, motions, pair) for mean, base, pair in columns])
    return summaries


def _by_variant(runs: Runs, summaries: list[list[Summary]]) -> dict[str, Any]:
    """Summaries as plain data: label of the filter -> name of the statistic -> data."""
    by_variant = {}
    for label, row in zip(runs.plan.labels, summaries, strict=True):
        pairs = zip(runs.statistics, row, strict=True)
        by_variant[label] = {statistic.name: asdict(summary) for statistic, summary in pairs}
    return by_variant


def _reported_drift(runs: Runs) -> str:
    """Drift over a horizon that most cells have: the longest, or the usual one."""
    horizons = runs.plan.study.horizons
    usual = USUAL_HORIZON if horizons == HORIZONS else max(horizons)

    def cells_with_drift(horizon: float) -> int:
        """Number of cells in which any run of any filter has the drift."""
        drifts = runs.values[..., runs.column(DRIFT.format(horizon))]
        return int(np.isfinite(drifts).any(axis=(0, 2)).sum())

    nearest_first = sorted(horizons, key=lambda horizon: (abs(horizon - usual), horizon))
    return DRIFT.format(max(nearest_first, key=cells_with_drift))


def _typical(runs: Runs) -> dict[str, Any]:
    """Drift and final error of a typical cell by variant; all cells weigh the same.

    `median_percent` is the median over cells of mean drifts; `ratio` of drifts and `end_ratio` of final
    errors as of `_typical_ratios`.
    """
    drifts = runs.values[..., runs.column(_reported_drift(runs))]
    ratios = _typical_ratios(runs, _reported_drift(runs))
    end_ratios = _typical_ratios(runs, FINAL_ERROR)
    by_label: dict[str, Any] = {}
    for number, (label, drift) in enumerate(zip(runs.plan.labels, drifts, strict=True)):
        finite_drifts = [cell[np.isfinite(cell)] for cell in drift]
        means = [float(finite.mean()) for finite in finite_drifts if len(finite)]
        by_label[label] = {"median_percent": float(np.median(means)) if means else np.nan}
        for name, (ratio, low, high) in (
            ("ratio", ratios[number]),
            ("end_ratio", end_ratios[number]),
        ):
            by_label[label] |= {name: ratio, f"{name}_low": low, f"{name}_high": high}
    return by_label


def _typical_ratios(runs: Runs, statistic: str) -> list[tuple[float, float, float]]:
    """Geometric mean over cells of a statistic's ratio to the baseline, by variant.

    Each has the ends of its 95 % interval, by leaving out true motions one by one.
    """
    motions, column = runs.motions, runs.column(statistic)
    baseline = runs.baseline[..., column]

    def log_ratio(values: Floats, counted: Any) -> float:
        """Mean over cells of the log of the ratio, over `counted` runs (mask, or True)."""
        has_both = np.isfinite(values) & np.isfinite(baseline) & counted
        value_sum = np.where(has_both, values, 0.0).sum(axis=1)
        baseline_sum = np.where(has_both, baseline, 0.0).sum(axis=1)
        has_ratio = np.asarray((value_sum > 0.0) & (baseline_sum > 0.0))
        if not has_ratio.any():
            return math.nan
        return float(np.log(value_sum[has_ratio] / baseline_sum[has_ratio]).mean())

    ratios = []
    for values in runs.values[..., column]:
        without_one = [log_ratio(values, motions != motion) for motion in np.unique(motions)]
        mean, half_width = log_ratio(values, True), jackknife_half_width(np.array(without_one))
        low, high = mean - half_width, mean + half_width
        ratios.append((math.exp(mean), math.exp(low), math.exp(high)))
    return ratios


def _final_errors(runs: Runs) -> list[Results]:
    """Percentiles of the final position error over all cells, by variant that has one."""
    percentiles = {}
    final_errors = runs.values[..., runs.column(FINAL_ERROR)]
    for label, values in zip(runs.plan.labels, final_errors, strict=True):
        errors = values[np.isfinite(values)]
        if len(errors):
            exact = np.percentile(errors, PERCENTILES).tolist()
            percentiles[label] = [float(f"{value:.{SHOWN_DIGITS}g}") for value in exact]
    return [{"axis": "", "group": "all runs", "percentiles": percentiles}]


def alike(values: Floats, axis: int) -> list[list[int]]:
    """Group filters (axis 0) or cells (axis 1) with equal statistics, to `ROUNDING`.

    Groups have two or more indices; values (filters, cells, runs, statistics) are NaN if missing.
    """
    items = np.moveaxis(values, axis, 0)
    # Equal items have equal sums: only neighbours in their order need to be compared.
    sums = np.nansum(items.reshape(len(items), -1), axis=1)
    groups: list[list[int]] = []
    for index in np.argsort(sums, kind="stable").tolist():
        item = items[index]
        if np.isnan(item).all():
            continue
        last = items[groups[-1][0]] if groups else None
        if last is not None and np.allclose(item, last, ROUNDING, 0.0, equal_nan=True):
            groups[-1].append(index)
        else:
            groups.append([index])
    return sorted(sorted(group) for group in groups if len(group) > 1)
