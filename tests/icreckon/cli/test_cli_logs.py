"""`icreckon inspect` and `replay` over tables, several files and types of one's own."""

import json
from pathlib import Path

import numpy as np
import pytest

from bag_messages import DRIVES, definition_files, drive_bag, halves
from command_line import fails, results_in, succeeds
from icreckon import Log, Scenario, simulate, write_log
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, load_robot
from tum import read_tum


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(Scenario(duration=20.0, trajectory="slalom"), load_robot("auriga-alpha"))


def test_several_files_are_one_log(log: Log, tmp_path: Path) -> None:
    robot = load_robot("auriga-alpha")
    parts = [
        write_log(part, tmp_path / f"part{number}", "mcap", robot)
        for number, part in enumerate(halves(log))
    ]
    words = ("--robot", "auriga-alpha", "--variants", "differential", "--json", "--one-log")
    done = succeeds("replay", *parts, *words, cwd=tmp_path)
    assert "and 1 more" in done.stderr
    results = json.loads(done.stdout)
    assert results["log"]["duration_s"] == pytest.approx(log.duration)
    assert results["configuration"]["log"] == [str(part) for part in parts]
    assert set(results["inputs"]) == {str(part) for part in parts}
    assert "given twice" in fails("replay", parts[0], parts[0], *words, cwd=tmp_path)


def test_a_type_of_ones_own(tmp_path: Path) -> None:
    bag = drive_bag(tmp_path / "bag", DRIVES)
    text = (ROBOTS_FOLDER / "auriga-alpha.toml").read_text(encoding="utf-8")
    text = text[: text.index("[log.tracks]")]
    text += (
        '[log.tracks]\ntopic = "/drive"\nleft = ["wheels[0].rate"]\nright = ["wheels[1].rates"]\n'
    )
    (tmp_path / "robot.toml").write_text(text, encoding="utf-8")
    files = [word for file in definition_files(tmp_path) for word in ("--msg", file)]
    words = ("--robot", "robot.toml", "--variants", "differential")
    problem = fails("replay", bag, *files, *words, cwd=tmp_path)
    assert "no field 'rates' of 'wheels[1].rates'; our_msgs/msg/Wheel has rate" in problem
    (tmp_path / "robot.toml").write_text(text.replace("rates", "rate"), encoding="utf-8")
    succeeds("replay", bag, *files, *words, cwd=tmp_path)


def test_replay_writes_the_smoothed_paths_beside_the_others(tmp_path: Path) -> None:
    words = ("--duration", 20, "--outage", "5:18", "--trajectory", "slalom", "--seed", 3)
    succeeds("simulate", "--out", "run", *words, cwd=tmp_path)
    words = ("--robot", "auriga-alpha", "--variants", "inertia-online", "--smooth")
    words = ("replay", "run", *words, "--out", "found")
    done = succeeds(*words, cwd=tmp_path)
    assert " inertia-online-smoothed " in done.stdout
    assert "Warning" not in done.stderr
    results = results_in(tmp_path / "found")
    assert results["configuration"]["smooth"] is True
    assert list(results["variants"]) == ["inertia-online", "inertia-online-smoothed"]
    filtered, smoothed = (
        read_tum(tmp_path / "found" / f"{name}.tum") for name in results["variants"]
    )
    assert (filtered.stamps == smoothed.stamps).all()
    assert filtered.poses[-1] == pytest.approx(smoothed.poses[-1], abs=0.05)
    assert np.abs(filtered.poses[:, :2] - smoothed.poses[:, :2]).max() > 0.05
