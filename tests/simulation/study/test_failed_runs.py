"""A study whose runs fail says so, and failed runs enter no sum, table, figure or page."""

import json
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import typer
from pyarrow import parquet

import study_stub
from command_line import results_in
from icreckon import SimulationError, run_study
from icreckon.cli.study import command
from icreckon.estimator.batch.runs import Worked
from icreckon.report.study.text import failures, headline, summary_tables
from icreckon.simulation.running import batch_engine as study_batch
from icreckon.simulation.running import engines
from icreckon.simulation.study.cells import Cell, Filter
from icreckon.simulation.study.failures import RunScores
from icreckon.simulation.study.statistics import statistics

STUDY = msgspec.structs.replace(study_stub.STUDY, runs=4, truths=2)
NAMES = [one.name for one in statistics(STUDY.horizons)]


@pytest.fixture(autouse=True)
def _stub(monkeypatch: pytest.MonkeyPatch) -> None:
    study_stub.install(monkeypatch)


Change = Callable[[Cell, list[str], int, RunScores], None]


def let_blocks(monkeypatch: pytest.MonkeyPatch, change: Change) -> None:
    """Let a function change the stub's scores of a cell and filters, from a run on."""
    honest = study_stub.block

    def block(cell: Cell, filters: list[Filter], first_run: int, count: int) -> RunScores:
        scores = honest(cell, filters, first_run, count)
        change(cell, [spec.label for spec in filters], first_run, scores)
        return scores

    monkeypatch.setattr(study_stub, "block", block)


def spoil(monkeypatch: pytest.MonkeyPatch, cell: int, label: str, **changes: float) -> None:
    """Let the stub return these statistics for run 2 of a cell and filter."""

    def change(of: Cell, labels: list[str], first_run: int, scores: RunScores) -> None:
        if of.index == cell and label in labels and first_run == 0:
            for name, value in changes.items():
                scores.values[labels.index(label), 2, NAMES.index(name)] = value

    let_blocks(monkeypatch, change)


def test_a_lost_filter_is_a_failed_run(tmp_path, monkeypatch):
    honest = study_batch.work_through_runs

    def losing(*given: Any, **named: Any) -> list[Worked]:
        """Set the first filter's pose in the lane of run 1 to NaN from 7 s on."""
        worked = honest(*given, **named)
        worked[0].estimates[round(7.0 * 50.0) :, 0, 1] = np.nan
        return worked

    monkeypatch.setattr(study_batch, "work_through_runs", losing)
    monkeypatch.setattr(engines, "ENGINES", [engines.BATCH])
    study = msgspec.structs.replace(STUDY, sweep=None)
    results = run_study(study, tmp_path / "a", workers=1)
    assert (results["failed"]["runs"], results["failed"]["of"]) == (1, 8)
    (failed,) = results["failed"]["cells"]
    reason = "estimate is not finite from 7.0 s on"
    assert failed["variant"] == "constant-online"
    assert failed["reasons"] == [{"reason": reason, "runs": 1, "first_run": 1}]
    rows = parquet.read_table(tmp_path / "a" / "runs.parquet").to_pylist()
    (lost,) = (row for row in rows if row["failed"])
    assert (lost["variant"], lost["run"], lost["failed"]) == ("constant-online", 1, reason)
    assert {lost[name] for name in NAMES} == {None}
    for name in ("final_position_error_m", "nis_gyro_mean", "rejected_total"):
        counts = [results["overall"][label][name]["n"] for label in STUDY.variants]
        assert counts == [3, 4]
    assert failures(results)[1] == f"constant-online: 1 of 4 runs failed: {reason} (run 1)"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"nis_gyro_mean": -3e53}, "nis_gyro_mean is negative (-3e+53)"),
        ({"final_position_error_m": np.nan}, "final_position_error_m is not finite"),
        ({"rmse_v_x_m_s": 1e5}, "rmse_v_x_m_s is impossibly large (1e+05)"),
    ],
)
def test_a_run_with_an_impossible_value_is_excluded_as_a_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, float], reason: str
) -> None:
    spoil(monkeypatch, 1, "constant-online", **changes)
    results = run_study(STUDY, tmp_path / "a", workers=1)
    (failed,) = results["failed"]["cells"]
    assert (failed["cell"], failed["values"]) == (1, {"gyro.factor": 10.0})
    assert failed["reasons"] == [{"reason": reason, "runs": 1, "first_run": 2}]
    told = "".join("".join(row) for table in summary_tables(results) for row in table.rows)
    assert f"constant-online\n(1 of 4 runs failed: {reason})" in told
    for name in set(NAMES) - {"rejected_gyro"}:
        assert results["cells"][1]["variants"]["constant-online"][name]["n"] == 3, name
        assert results["cells"][0]["variants"]["constant-online"][name]["n"] == 4, name
    for one in results["overall"].values():
        for summary in one.values():
            assert not abs(summary["mean"]) > 1e3


def test_a_cell_without_a_result_is_an_error_and_all_others_are_there(tmp_path, monkeypatch):
    def change(of: Cell, labels: list[str], *_: object) -> None:
        if of.index == 1 and "inertia-online" in labels:
            raise np.linalg.LinAlgError("Singular matrix")

    let_blocks(monkeypatch, change)
    results = run_study(STUDY, tmp_path / "a", workers=1)
    assert results["cells"][1]["variants"]["constant-online"]["nis_gyro_mean"]["n"] == 4
    told = [
        "ERROR: 4 of 16 runs failed. They are in no table and no figure.",
        "cell 1 (gyro.factor = 10), inertia-online: no result, all 4 runs failed: "
        "LinAlgError: Singular matrix (run 0 and 3 more)",
    ]
    assert failures(results) == told
    assert headline(results).endswith("ERROR: 4 of 16 runs failed.")
    (table,) = summary_tables(results)
    error = "ERROR: LinAlgError: Singular matrix"
    (row,) = [row for row in table.rows if "ERROR" in "".join(row)]
    assert row[:3] == ("", "inertia-online", error)
    page = (tmp_path / "a" / "page.html").read_text(encoding="utf-8")
    assert page.index(told[0]) < page.index(told[1]) < page.index('class="headline"')
    assert f'<td class="error" colspan="5">{error}</td>' in page


def test_variants_are_compared_over_the_cells_that_both_have(tmp_path, monkeypatch):
    """Drift is 1 and 2 in the easy cell, 10 and 20 in the hard one, where the better one fails."""

    def change(of: Cell, labels: list[str], _: int, found: RunScores) -> None:
        for label, values, reasons in zip(labels, *found, strict=True):
            better = label == "inertia-online"
            drift = (1.0 if better else 2.0) * (10.0 if of.index else 1.0)
            values[:, NAMES.index("drift_percent_5s")] = drift
            if better and of.index:
                reasons[:] = "lost"

    let_blocks(monkeypatch, change)
    results = run_study(STUDY, tmp_path / "a", workers=1)
    summary = results["overall"]["inertia-online"]["drift_percent_5s"]
    assert summary["ratio"] == pytest.approx(0.5, rel=1e-12)
    assert summary["difference"] == pytest.approx(-1.0, rel=1e-12)


def test_a_study_without_any_result_still_has_a_page(tmp_path, monkeypatch):
    def change(*_: object) -> None:
        raise SimulationError("the vehicle tips over")

    let_blocks(monkeypatch, change)
    results = run_study(STUDY, tmp_path / "a", workers=1)
    assert results["failed"]["runs"] == results["failed"]["of"] == 16
    assert headline(results).startswith("ERROR: over 2 cells of 4 runs each, constant-online has")
    assert "the vehicle tips over" in (tmp_path / "a" / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("fails", [True, False])
def test_the_command_writes_everything_and_exits_with_1_if_a_run_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], fails: bool
) -> None:
    if fails:
        spoil(monkeypatch, 0, "constant-online", nis_gyro_mean=-1.0)
    monkeypatch.setattr("icreckon.cli.study.load_study", lambda _: STUDY)
    options: dict[str, Any] = dict.fromkeys(("runs",))
    options |= dict.fromkeys(("list_studies", "wide", "overwrite"), False)
    options |= {"study": "tiny", "out": tmp_path / "a", "workers": 1, "as_json": True}
    with pytest.raises(typer.Exit) if fails else nullcontext() as left:
        command(**options)
    assert left is None or left.value.exit_code == 1
    shown = capsys.readouterr()
    assert json.loads(shown.out) == results_in(tmp_path / "a")
    assert json.loads(shown.out)["failed"]["runs"] == int(fails)
    assert ("ERROR: 1 of 16 runs failed" in shown.err) == fails
    assert (tmp_path / "a" / "page.html").exists()


def test_a_failed_run_stays_failed_when_the_study_goes_on(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        spoil(patch, 0, "constant-online", nis_gyro_mean=-1.0)
        first = run_study(STUDY, tmp_path / "a", workers=1)
    again = run_study(STUDY, tmp_path / "a", workers=1)
    assert again["failed"] == first["failed"]
    assert again["failed"]["runs"] == 1
