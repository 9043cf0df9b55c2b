"""Tables of a study as Parquet: one row for each summary, one for each run."""

import io
from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from icreckon.simulation.study.cells import Plan
from icreckon.simulation.study.results import Runs
from icreckon.simulation.study.summary import COLUMNS, Summary


def results_parquet(runs: Runs, cells: Sequence[list[list[Summary]]]) -> bytes:
    """Table of `results.cell_summaries`: one row for each cell, variant and statistic."""
    plan, kinds = runs.plan, runs.statistics
    rows = [astuple(summary) for filters in cells for summaries in filters for summary in summaries]
    columns = _key_columns(plan, len(kinds))
    repeats = len(plan.cells) * len(plan.labels)
    columns["statistic"] = np.array([kind.name for kind in kinds] * repeats, dtype=object)
    columns["unit"] = np.array([kind.unit for kind in kinds] * repeats, dtype=object)
    for name, values in zip(COLUMNS, np.array(rows).T, strict=True):
        is_whole = Summary.__dataclass_fields__[name].type is int
        columns[name] = values.astype(np.int64) if is_whole else values.astype(np.float64)
    return _parquet(columns)


def runs_parquet(runs: Runs) -> bytes:
    """Table of runs: one row for each cell, variant and run, one column per statistic."""
    plan = runs.plan
    filters, cells, count, _ = runs.values.shape
    columns = _key_columns(plan, count)
    columns["run"] = np.tile(np.arange(count, dtype=np.int64), cells * filters)
    # The arrays of the runs begin with filters, the rows of the table with cells.
    reasons = runs.reasons.swapaxes(0, 1).reshape(-1)
    columns["failed"] = np.where(reasons == "", None, reasons)
    columns["true_motion"] = np.tile(runs.motions.astype(np.int64), cells * filters)
    rows = runs.values.swapaxes(0, 1).reshape(cells * filters * count, -1)
    for kind, values in zip(runs.statistics, rows.T, strict=True):
        columns[kind.name] = values
    return _parquet(columns)


def _key_columns(plan: Plan, rows: int) -> dict[str, Any]:
    """Columns of cell, axes and variant, for a number of rows of each variant."""
    cell_of_row = np.repeat(np.arange(len(plan.cells)), len(plan.labels) * rows)
    columns: dict[str, Any] = {"cell": cell_of_row.astype(np.int32)}
    for axis in plan.axes:
        values = [cell.values[axis.name] for cell in plan.cells]
        if axis.scale == "names":
            column = np.array([str(value) for value in values], dtype=object)
        else:
            column = np.array(values, dtype=np.float64)
        # The prefix keeps axes apart from the other columns.
        columns[f"axis:{axis.name}"] = column[cell_of_row]
    labels = np.repeat(np.array(plan.labels, dtype=object), rows)
    return columns | {"variant": np.tile(labels, len(plan.cells))}


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
