"""`icreckon paper` from end to end."""

import base64
import io
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from rich.console import Console

from command_line import results_in, succeeds
from icreckon.report.paper.tables import paper_tables
from icreckon.simulation.paper.published import PUBLISHED, READ_OFF
from icreckon.simulation.paper.reproduction import CONTACT

FIGURES = {"figure.png", *(f"figure-{number}.png" for number in (3, 5, 6, 7, 8))}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report, made once."""
    folder = tmp_path_factory.mktemp("paper")
    done = succeeds("paper", cwd=folder, drawn=True)
    for number in (*PUBLISHED, *READ_OFF):
        assert number.name in done.stdout
        assert number.printed in done.stdout
    assert "Table II" in done.stdout
    assert "contradict each other" in done.stdout
    assert "page.html" in done.stderr
    return folder / "icreckon-paper"


@pytest.fixture(scope="module")
def results(report: Path) -> dict[str, object]:
    return results_in(report)


def test_it_leaves_everything_it_promises(report: Path) -> None:
    assert {path.name for path in report.iterdir()} == FIGURES | {
        *(".icreckon-files", "results.json", "page.html", "motions.csv")
    }
    assert [path.name for path in report.parent.iterdir()] == ["icreckon-paper"]
    for name in FIGURES:
        picture = matplotlib.image.imread(report / name)
        assert min(picture.shape[:2]) > 450, name
        assert len(np.unique(picture[::2, ::2, 0])) > 20, name


def test_tables_fit_80_characters(results: dict[str, object]) -> None:
    console = Console(width=80, file=io.StringIO())
    console.print(paper_tables(results, narrow=True))
    shown = console.file.getvalue()
    assert "…" not in shown
    assert max(map(len, shown.splitlines())) <= 80
    for value in (4.4424, 38.3464, 63.7394, 15.962, 82.1718, 143.285):
        assert f" {value:.1f} " in shown


def test_the_page_has_all_numbers_and_figures(report: Path, results: dict) -> None:
    page = (report / "page.html").read_text(encoding="utf-8")
    for row in results["published"]:
        cells = f'<td class="text">{row["name"]}</td><td>{row["printed"]}</td>'
        assert cells in page.replace("<wbr>", "")
    for name in FIGURES:
        assert base64.b64encode((report / name).read_bytes()).decode() in page
    assert page.index("printed numbers") < page.index("<img") < page.index("<table")
    assert "http" not in page.replace('http-equiv="Content-Security-Policy"', "")


def test_motions_are_those_of_the_figures(report: Path, results: dict) -> None:
    """Mean ICRs of the table's motions, read as documented, are the reproduced ones."""
    table = np.genfromtxt(report / "motions.csv", delimiter=",", names=True)
    assert len(table) == results["map"]["pairs"]
    kept = table["F_N"] <= results["configuration"]["largest_inertia_N"]
    by_name = {row["name"]: row["reproduced"] for row in results["published"]}
    for name in ("x_ICRl", "x_ICRr", "y_ICR"):
        mean = np.nanmean(table[f"{name}_m"][kept])
        assert mean == pytest.approx(by_name[f"mean_{name}"], abs=1e-6)
    straight = table["V_l_m_s"] == table["V_r_m_s"]
    assert np.isnan(table["eta"][straight]).all()
    assert np.isfinite(table["eta"][~straight]).all()


def test_results_say_what_was_done_and_hold_every_published_number(results: dict) -> None:
    assert (results["format"], results["command"]) == (1, "paper")
    assert results["configuration"]["contact"]["soil"]["friction"] == CONTACT.soil.friction
    assert results["versions"]["numpy"] == np.__version__
    assert results["map"]["pairs"] == 441
    assert results["map"]["largest_residual"] < 1e-10
    rows = results["published"]
    assert [row["name"] for row in rows] == [number.name for number in (*PUBLISHED, *READ_OFF)]
    printed = [row for row in rows if not row["read_off"]]
    counts = results["counts"]
    assert counts["printed"] == len(printed) == 17
    for level in (5, 10, 20):
        close = sum(abs(row["difference_percent"]) <= level for row in printed)
        assert counts[f"within_{level}_percent"] == close
