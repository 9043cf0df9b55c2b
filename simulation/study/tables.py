"""Tables of a study as Parquet: one row for each summary, one for each run."""

import io
from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from icreckon.simulation.study.cells import Axis, Plan
from icreckon.simulation.study.results import Runs
from icreckon.simulation.study.summary import COLUMNS, Summary

# Names of axis columns; the prefix keeps them apart from the others.
AXIS = "axis:{}"


def results_parquet(runs: Runs, cells: Sequence[list[list[Summary]]]) -> bytes:
    """Table of summaries: one row for each cell, variant and statistic.

    Args:
        runs: all statistics.
        cells: `icreckon.simulation.study.results.cell_summaries` of the runs.
    """
    plan, kinds = runs.plan, runs.statistics
    filters, count = len(plan.labels), len(kinds)
    at = np.repeat(np.arange(len(plan.cells)), filters * count)
    rows = np.array([astuple(one) for cell in cells for found in cell for one in found])
    columns: dict[str, Any] = {"cell": at.astype(np.int32)} | _axis_columns(plan, at)
    labels = np.repeat(np.array(plan.labels, dtype=object), count)
    columns["variant"] = np.tile(labels, len(plan.cells))
    for name in ("name", "unit"):
        column = np.array([getattr(one, name) for one in kinds], dtype=object)
        key = "statistic" if name == "name" else name
        columns[key] = np.tile(column, len(plan.cells) * filters)
    for name, values in zip(COLUMNS, rows.T, strict=True):
        whole = Summary.__dataclass_fields__[name].type is int
        columns[name] = values.astype(np.int64) if whole else values.astype(np.float64)
    return _parquet(columns)


def runs_parquet(runs: Runs) -> bytes:
    """Table of runs: one row for each cell, variant and run, one column per statistic."""
    plan = runs.plan
    filters, cells, count, _ = runs.values.shape
    at = np.repeat(np.arange(cells), filters * count)
    columns: dict[str, Any] = {"cell": at.astype(np.int32)} | _axis_columns(plan, at)
    labels = np.repeat(np.array(plan.labels, dtype=object), count)
    columns["variant"] = np.tile(labels, cells)
    columns["run"] = np.tile(np.arange(count, dtype=np.int64), cells * filters)
    if runs.reasons is not None:
        ordered = runs.reasons.transpose(1, 0, 2).reshape(-1)
        columns["failed"] = np.where(ordered == "", None, ordered)
    columns["true_motion"] = np.tile(runs.motions.astype(np.int64), cells * filters)
    ordered = runs.values.transpose(1, 0, 2, 3).reshape(cells * filters * count, -1)
    for one, values in zip(runs.statistics, ordered.T, strict=True):
        columns[one.name] = values
    return _parquet(columns)


def _axis_columns(plan: Plan, at: Any) -> dict[str, Any]:
    """Value of each axis in the cells of given rows."""
    return {AXIS.format(axis.name): _axis_values(plan, axis)[at] for axis in plan.axes}


def _axis_values(plan: Plan, axis: Axis) -> Any:
    values = [cell.values[axis.name] for cell in plan.cells]
    if axis.scale == "names":
        return np.array([str(value) for value in values], dtype=object)
    return np.array(values, dtype=np.float64)


def _parquet(columns: dict[str, Any]) -> bytes:
    """Encode a Parquet file; NaN becomes null."""
    import pyarrow as pa
    from pyarrow import parquet

    arrays = {
        name: pa.array(values.tolist(), type=pa.string())
        if values.dtype == object
        else pa.array(values, from_pandas=True)
        for name, values in columns.items()
    }
    sink = io.BytesIO()
    parquet.write_table(pa.table(arrays), sink, compression="zstd", compression_level=3)
    return sink.getvalue()
