"""Tables of the pages with figures of a command: all are marked, none is older than the filter."""

from pathlib import Path

import pytest
from _tables import all_tables, current, put, renewed, tables

from icreckon.estimator.filter.fault_table import FAULTS
from readme import ROOT

COMMAND = "python benchmarks/demo_runs.py"
# Heads of tables without figures of a command of their own.
OTHERS = {
    ("log", "source"),
    ("where", "what happens"),
    ("page", "answers"),
    ("fault", "indicated by", "effect", "rule"),
}
PAGE = """# Page

<!-- figures: python benchmarks/demo_runs.py; of: 00000000 -->

| fault | variant | error, m |
| --- | --- | --- |
| none | `gyro` | 0.10 |
| none | `constant-online` | 0.20 |
"""
OUTPUT = """2 runs

| fault | own sigma [m] |
| --- | --- |
| none | 0.77 |

| fault | variant | own sigma, m | error [m] |
| --- | --- | --- | --- |
| none | constant-online | 0.50 | 0.25 |
| none | gyro | 0.50 | 0.15 |
| all | gyro | 0.50 | 0.99 |
"""


def test_each_table_has_its_command() -> None:
    bare = [one.name for one in all_tables() if one.command is None and one.head not in OTHERS]
    assert not bare, "\n".join(bare)


def test_no_table_is_older_than_the_filter() -> None:
    stale = [f"{one.name}: {one.command}" for one in all_tables() if one.is_stale]
    assert not stale, "\n".join(stale)


@pytest.mark.parametrize(
    "output", [OUTPUT, OUTPUT.replace("| fault | variant |", "| variant | fault |")]
)
def test_a_table_is_replaced_from_the_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, output: str
) -> None:
    """Also where the page has the columns in an order of its own."""
    if output != OUTPUT:
        output = output.replace("| none | constant-online |", "| constant-online | none |")
        output = output.replace("| none | gyro |", "| gyro | none |").replace(
            "| all | gyro |", "| gyro | all |"
        )
    page = tmp_path / "page.md"
    page.write_text(PAGE, encoding="utf-8")
    monkeypatch.setattr("_tables.ROOT", tmp_path)
    (table,) = tables(page)
    assert (table.command, table.of) == (COMMAND, "00000000")
    assert table.is_stale
    put(table, renewed(table, output))
    (after,) = tables(page)
    assert after.rows == (("none", "`gyro`", "0.15"), ("none", "`constant-online`", "0.25"))
    assert after.of == current(COMMAND)
    assert not after.is_stale


def test_the_table_of_faults_is_that_of_the_filter() -> None:
    page = (ROOT / "docs/explanation/proof/faults.md").read_text(encoding="utf-8")
    rows = [f"| {one.name} | {one.indication} | {one.effect} | `{one.rule}` |" for one in FAULTS]
    assert "| --- | --- | --- | --- |\n" + "\n".join(rows) + "\n\n" in page
    assert all((ROOT / "estimator" / one.rule).is_file() for one in FAULTS)
