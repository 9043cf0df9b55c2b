"""Tables of the pages with figures of a command: all are marked, none is older than the filter."""

from _tables import all_tables

from icreckon.estimator.filter.fault_table import FAULTS
from readme import ROOT

# Heads of tables without figures of a command of their own.
OTHERS = {
    ("log", "source"),
    ("where", "what happens"),
    ("page", "answers"),
    ("fault", "indicated by", "effect", "rule"),
}


def test_each_table_has_its_command() -> None:
    bare = [one.name for one in all_tables() if one.command is None and one.head not in OTHERS]
    assert not bare, "\n".join(bare)


def test_no_table_is_older_than_the_filter() -> None:
    stale = [f"{one.name}: {one.command}" for one in all_tables() if one.is_stale]
    assert not stale, "\n".join(stale)


def test_the_table_of_faults_is_that_of_the_filter() -> None:
    page = (ROOT / "docs/explanation/proof/faults.md").read_text(encoding="utf-8")
    rows = [f"| {one.name} | {one.indication} | {one.effect} | `{one.rule}` |" for one in FAULTS]
    assert "| --- | --- | --- | --- |\n" + "\n".join(rows) + "\n\n" in page
    assert all((ROOT / "estimator" / one.rule).is_file() for one in FAULTS)
