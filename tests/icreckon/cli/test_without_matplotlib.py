"""Commands without matplotlib: one line, and all results that need none."""

import sys
import warnings
from pathlib import Path

import pytest

from command_line import Done, icreckon
from conftest import simulated
from icreckon.report.pages import unless_missing

LINE = "no figures: matplotlib cannot be imported"
STUDY = """
name = "small"
runs = 2
variants = ["gyro", "constant-online"]
[scenario]
duration = 20.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a bag that has a truth, and a study."""
    path = tmp_path_factory.mktemp("plain")
    simulated(path / "drive", 60.0, trajectory="aggressive", truth="kinematic", fix_rate=0.0)
    (path / "small.toml").write_text(STUDY, encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def _without_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither matplotlib nor what has imported it can be imported."""
    for name in list(sys.modules):
        if name.partition(".")[0] in ("matplotlib", "mpl_toolkits"):
            monkeypatch.setitem(sys.modules, name, None)
        elif name.startswith("icreckon.report."):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)


def run(*words: str, cwd: Path) -> tuple[Done, set[str]]:
    """A command that ends well, and its warnings."""
    with warnings.catch_warnings(record=True, action="always") as told:
        done = icreckon(*words, cwd=cwd, drawn=True)
    assert done.returncode == 0, done.stderr
    return done, {str(one.message) for one in told}


@pytest.mark.parametrize(
    ("words", "files"),
    [
        (
            ("replay", "drive", "--robot", "auriga-alpha", "--variants", "gyro,constant-online"),
            {"results.json", "page.html", "gyro.tum", "odometry.mcap"},
        ),
        (("paper",), {"results.json", "page.html", "motions.csv"}),
        (("study", "small.toml", "--workers", "1"), {"results.json", "page.html"}),
    ],
    ids=lambda words: words[0] if isinstance(words, tuple) else "",
)
def test_results_are_there_without_figures(words, files, folder):
    done, (told,) = run(*words, "--out", words[0], cwd=folder)
    assert told.startswith(LINE)
    there = {path.name for path in (folder / words[0]).iterdir()}
    assert files <= there
    assert not any(name.endswith(".png") for name in there)
    assert "| " in done.stdout or "│" in done.stdout


def test_a_check_needs_no_figures(folder: Path) -> None:
    _, told = run("check", "drive", "--robot", "auriga-alpha", cwd=folder)
    assert not told


def test_another_module_that_is_missing_is_no_matter_of_figures() -> None:
    with pytest.raises(ImportError, match="nowhere"), unless_missing():
        raise ImportError("nowhere", name="nowhere")
