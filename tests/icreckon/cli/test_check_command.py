"""`icreckon check` and what a replay notes of a robot file that does not fit its log."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from command_line import fails, icreckon, results_in, succeeds
from conftest import simulated
from icreckon import Scenario, simulate, write_log
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, changed_robot, load_robot

ALPHA = load_robot("auriga-alpha")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a bag, the file of its robot, and one in which the radius is a diameter."""
    path = tmp_path_factory.mktemp("check")
    simulated(path / "drive", 70.0, seed=2, trajectory="random", fix_rate=1.0)
    text = (ROBOTS_FOLDER / "auriga-alpha.toml").read_text(encoding="utf-8")
    (path / "right.toml").write_text(text, encoding="utf-8")
    assert "sprocket_radius = 0.1 " in text
    wrong = text.replace("sprocket_radius = 0.1 ", "sprocket_radius = 0.2 ")
    (path / "wrong.toml").write_text(wrong, encoding="utf-8")
    return path


def test_a_file_that_fits(folder: Path):
    done = succeeds("check", "drive", "--robot", "right.toml", cwd=folder)
    assert "Nothing in the log contradicts the robot file." in done.stdout
    assert "Drift of inertia-online after 30 s without fixes: " in done.stdout
    assert "! " not in done.stdout
    assert "turn on the spot" not in done.stdout  # it turned


def test_a_radius_that_is_a_diameter(folder: Path):
    done = icreckon("check", "drive", "--robot", "wrong.toml", cwd=folder)
    assert done.returncode == 1
    assert "is the radius a diameter? Costs " in done.stdout
    assert re.search(r"Set sprocket_radius = 0\.(0|1)", done.stdout)
    assert done.stderr.strip() == ""


def test_as_json(folder: Path):
    done = icreckon("check", "drive", "--robot", "wrong.toml", "--json", cwd=folder)
    assert done.returncode == 1
    found = json.loads(done.stdout)
    (scale,) = (one for one in found["checks"] if one["problem"])
    assert scale["name"] == "scale of the tracks"
    assert scale["cost_percent"] > 20.0
    assert found["drift_percent_corrected"] < 3.0 < 20.0 < found["drift_percent_as_it_is"]
    assert found["is_of_another_robot"] is False
    assert isinstance(found["missing_manoeuvres"], list)
    # A program needs no words: it reads the numbers, and sets what `set` says.
    measured = scale["measured"]
    assert abs(measured["value"] - 0.5) < 0.05
    assert 0.0 < measured["sigma"] < 0.02
    assert (measured["expected"], measured["unit"]) == (1.0, "-")
    assert [one["contradicts"] for one in found["checks"]].count(True) == 1
    assert list(scale["set"]) == ["vehicle.sprocket_radius"]
    corrected = changed_robot(load_robot(folder / "wrong.toml"), scale["set"])
    assert corrected.vehicle.sprocket_radius == pytest.approx(0.1, rel=0.05)


def test_a_file_that_maps_no_imu_is_not_called_right(folder: Path) -> None:
    text = (folder / "right.toml").read_text(encoding="utf-8")
    head, _, tail = text.partition("[log.imu]")
    (folder / "blind.toml").write_text(head + tail[tail.index("[log.") :], encoding="utf-8")
    done = icreckon("check", "drive", "--robot", "blind.toml", cwd=folder)
    assert done.returncode == 1
    assert "Nothing could be checked: that takes track speeds and an IMU of" in done.stdout
    assert "Nothing in the log contradicts" not in done.stdout
    assert "[log.imu]" in done.stdout


def test_what_nothing_corrects_comes_first(folder: Path) -> None:
    log, other = (simulate(Scenario(duration=70.0, seed=seed), ALPHA) for seed in (2, 3))
    apart = replace(log, imu=replace(other.imu, linear_acceleration=log.imu.linear_acceleration))
    write_log(apart, folder / "apart", "mcap", ALPHA)
    done = icreckon("check", "apart", "--robot", "wrong.toml", cwd=folder)
    assert "3 things contradict the log, worst first:" in done.stdout
    first, second = re.findall(r"(?m)^[12]\. (.*)", done.stdout)
    assert first == "The gyro and the tracks turn, but not together."
    assert "Costs inertia-online" in second


def test_shipped_robots_are_listed(folder: Path):
    done = succeeds("robots", cwd=folder)
    assert "warthog" in done.stdout
    assert str(ROBOTS_FOLDER) in done.stdout


def test_without_a_robot(folder: Path):
    assert "what is the robot?" in fails("check", "drive", cwd=folder)


def test_a_replay_notes_it(folder: Path):
    words = ("--variants", "gyro", "--formats", "none")
    done = icreckon("replay", "drive", "--robot", "wrong.toml", *words, "--out", "w", cwd=folder)
    assert "does not fit this log, and all figures are with it:\n- the truth moves" in done.stdout
    assert "icreckon check says what each of these costs" in done.stdout
    notes = results_in(folder / "w")["log"]["notes"]
    assert any("is the radius a diameter?" in note for note in notes)


def test_a_log_without_turns_names_the_manoeuvre_that_is_missing(tmp_path: Path) -> None:
    simulated(tmp_path / "drive", 25.0, seed=2, trajectory="straight", fix_rate=0.0)
    done = icreckon("check", "drive", "--robot", "auriga-alpha", cwd=tmp_path)
    assert "in the next log: turn on the spot once to each side (eta0 ± " in done.stdout
    unseen = re.search(r"does not show (\d) of \d+ values", done.stdout)
    assert int(unseen[1]) == len(re.findall("not seen:|unclear", done.stdout))
