"""Tables of the pages with figures of a command: all are marked, none is older than the filter."""

from pathlib import Path

import pytest
from _tables import PAGES, Table, all_tables, current, put, renewed, tables
from all_tables import renew_all

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


def test_a_table_is_replaced_from_the_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE, encoding="utf-8")
    monkeypatch.setattr("_tables.ROOT", tmp_path)
    (table,) = tables(page)
    assert (table.command, table.of) == (COMMAND, "00000000")
    assert table.is_stale
    put(table, renewed(table, OUTPUT))
    (after,) = tables(page)
    assert after.rows == (("none", "`gyro`", "0.15"), ("none", "`constant-online`", "0.25"))
    assert after.of == current(COMMAND)
    assert not after.is_stale


def table(
    *rows: tuple[str, ...], head: tuple[str, ...] = ("fault", "variant", "error, m")
) -> Table:
    return Table(PAGES[0], 0, head, rows, COMMAND)


def test_a_table_that_is_not_in_the_output_stays() -> None:
    assert renewed(table(("none", "`none`", "1")), OUTPUT) is None
    assert (
        renewed(table(("none", "`gyro`", "1"), head=("fault", "variant", "other")), OUTPUT) is None
    )


def test_rows_that_the_output_does_not_tell_apart_stay() -> None:
    assert renewed(table(("none", "1"), head=("fault", "error, m")), OUTPUT) is None
    assert renewed(table(("all", "1"), head=("fault", "error, m")), OUTPUT) == [("all", "0.99")]


def test_a_command_that_fails_is_reported_and_does_not_stop_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page, folder = tmp_path / "page.md", tmp_path / "benchmarks"
    folder.mkdir()
    (folder / "bad.py").write_text("import sys\nsys.exit('no such robot')\n", encoding="utf-8")
    (folder / "good.py").write_text(f"print({OUTPUT!r})\n", encoding="utf-8")
    both = PAGE + PAGE
    page.write_text(
        both.replace("demo_runs.py", "bad.py", 1).replace("demo_runs.py", "good.py"),
        encoding="utf-8",
    )
    for name, value in (("ROOT", tmp_path), ("KEPT", tmp_path / "kept")):
        monkeypatch.setattr(f"all_tables.{name}", value)
    monkeypatch.setattr("_tables.ROOT", tmp_path)
    assert renew_all(tables(page), "") == 1
    bad, good = tables(page)
    assert (bad.is_stale, good.is_stale) == (True, False)
    assert good.rows[0] == ("none", "`gyro`", "0.15")
    assert "bad.py: failed with exit code 1: no such robot" in capsys.readouterr().out
    # The output is kept: the command does not run again.
    (folder / "bad.py").unlink()
    monkeypatch.setattr("all_tables.run", None)
    assert renew_all([good], "") == 0


def test_the_table_of_faults_is_that_of_the_filter() -> None:
    page = (ROOT / "docs/explanation/proof/faults.md").read_text(encoding="utf-8")
    rows = [f"| {one.name} | {one.indication} | {one.effect} | `{one.rule}` |" for one in FAULTS]
    assert "| --- | --- | --- | --- |\n" + "\n".join(rows) + "\n\n" in page
    assert all((ROOT / "estimator" / one.rule).is_file() for one in FAULTS)
