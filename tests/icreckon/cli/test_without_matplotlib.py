"""Commands without matplotlib: one line, and all results that need none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from conftest import thorough
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.export.log_bag import write_log
from icreckon.report.drawing import unless_missing
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

BLOCKED = "import sys; sys.modules['matplotlib'] = None; from icreckon.cli.main import main; main()"
LINE = "icreckon: no figures: matplotlib cannot be imported"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a bag that has a truth."""
    path = tmp_path_factory.mktemp("plain")
    robot = load_robot("auriga-alpha")
    scenario = Scenario(duration=90.0, trajectory="aggressive", truth="kinematic", fix_rate=0.0)
    write_log(simulate(scenario, robot), path / "drive", "mcap", robot)
    return path


def without_matplotlib(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", BLOCKED, *words]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=cwd, timeout=300, check=False
    )


@pytest.mark.parametrize(
    ("words", "files"),
    [
        (
            ("replay", "drive", "--robot", "auriga-alpha", "--variants", "gyro,constant-online"),
            {"results.json", "page.html", "gyro.tum", "odometry.mcap"},
        ),
        thorough(
            ("calibrate", "drive", "--robot", "auriga-alpha", "--models", "constant,inertia"),
            {"results.json", "page.html"},
        ),
        (("paper",), {"results.json", "page.html", "contact.toml"}),
    ],
)
def test_results_are_there_without_figures(
    words: tuple[str, ...], files: set[str], folder: Path
) -> None:
    done = without_matplotlib(*words, "--out", words[0], cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count(LINE) == 1
    assert "internal error" not in done.stderr
    there = {path.name for path in (folder / words[0]).iterdir()}
    assert files <= there
    assert not any(name.endswith(".png") for name in there)
    assert "| " in done.stdout or "│" in done.stdout


def test_a_check_needs_no_figures(folder: Path) -> None:
    done = without_matplotlib("check", "drive", "--robot", "auriga-alpha", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "Nothing in the log contradicts the robot file." in done.stdout
    assert "matplotlib" not in done.stderr


def test_a_study_has_its_tables(tmp_path: Path) -> None:
    text = (
        'name = "small"\nruns = 2\nvariants = ["gyro", "constant-online"]\nengine = "streaming"\n'
        "[scenario]\nduration = 20.0\n"
    )
    (tmp_path / "small.toml").write_text(text, encoding="utf-8")
    done = without_matplotlib("study", "small.toml", "--workers", "1", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert LINE in done.stderr
    assert (tmp_path / "out" / "page.html").stat().st_size > 1000


def test_another_module_that_is_missing_is_no_matter_of_figures() -> None:
    with pytest.raises(ImportError, match="nowhere"), unless_missing():
        raise ImportError("nowhere", name="nowhere")
