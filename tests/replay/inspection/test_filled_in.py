"""A proposal that is written again keeps what a person filled in and added."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from command_line import fails, icreckon, succeeds
from icreckon import inspect
from icreckon.replay.inspection.filled_in import with_filled_in

PROPOSED = """\
# Proposed by inspecting drive: check every line.
name = "drive"
[vehicle]
mass = nan               # not in the log: fill in (kg, with load)
track_gauge = nan        # not in the log: fill in (m)
max_track_speed = 2.0    # not in the log: fill in (m/s)

[imu]
rotation_rpy_deg = [0.1, 0.2, 0.0]
position = [0.0, 0.0, 0.0]    # not in the log: fill in (m forward, left, up)
"""


def proposal(path: Path, text: str = PROPOSED) -> str:
    """First proposal, as `icreckon inspect --write` writes it."""
    path.write_text(with_filled_in(text, path)[0], encoding="utf-8")
    return path.read_text(encoding="utf-8")


def test_what_was_filled_in_is_kept(tmp_path: Path):
    path = tmp_path / "robot.toml"
    before = proposal(path).replace("mass = nan", "mass = 30", 1)
    before = before.replace("max_track_speed = 2.0", "max_track_speed = 0.123456789")
    before = before.replace("[0.0, 0.0, 0.0]", "[0.1, 0.0, 0.3]")
    before = before.replace('name = "drive"', 'name = "mole"')
    before += "\n[soil]  # of the yard\nfriction = 0.7\n"
    path.write_text(before, encoding="utf-8")
    text, taken = with_filled_in(PROPOSED, path)
    assert taken == ["name", "vehicle.mass", "vehicle.max_track_speed", "imu.position", "[soil]"]
    found = tomllib.loads(text)
    assert found["name"] == "mole"
    assert found["vehicle"]["mass"] == 30
    assert found["vehicle"]["max_track_speed"] == 0.123456789
    assert found["vehicle"]["track_gauge"] != found["vehicle"]["track_gauge"]
    assert found["imu"]["position"] == [0.1, 0.0, 0.3]
    assert found["soil"] == {"friction": 0.7}
    path.write_text(text, encoding="utf-8")
    again, taken = with_filled_in(PROPOSED.replace('"drive"', '"next"'), path)
    assert taken == ["name", "vehicle.mass", "vehicle.max_track_speed", "imu.position", "[soil]"]
    assert tomllib.loads(again)["imu"] == found["imu"]


def test_proposed_values_follow_the_log_and_changed_ones_stay(tmp_path: Path):
    """Also where the remark beside a value was left, where a key was added, and another log differs."""
    path = tmp_path / "robot.toml"
    first = PROPOSED.replace("[imu]", "sprocket_radius = 0.12    # m, by the truth\n\n[imu]")
    first += (
        '[log.tracks]\ntopic = "/o"\nleft = ["l"]\n# gauge = 0.5    # not in the log: fill in\n'
    )
    shown = first.replace("0.12 ", "0.15 ").replace("0.1, 0.2", "0.3, 0.4").replace('"/o"', '"/p"')
    filled = proposal(path, first).replace("[imu]", "[imu]\ngyro_range = true")
    filled = filled.replace("sprocket_radius = 0.12 ", "sprocket_radius = 0.21 ")
    filled = filled.replace("# gauge", "gauge").replace('["l"]', '["l1", "l2"]')
    path.write_text(filled, encoding="utf-8")
    for _ in range(2):
        text, taken = with_filled_in(shown, path)
        assert set(taken) == {
            "vehicle.sprocket_radius", "imu.gyro_range", "log.tracks.gauge", "log.tracks.left"
        }  # fmt: skip
        found = tomllib.loads(text)
        assert found["vehicle"]["sprocket_radius"] == 0.21
        assert found["imu"]["gyro_range"] is True
        assert found["imu"]["rotation_rpy_deg"] == [0.3, 0.4, 0.0]
        assert found["log"]["tracks"] == {"topic": "/p", "gauge": 0.5, "left": ["l1", "l2"]}
        path.write_text(text, encoding="utf-8")


def test_a_file_without_marks_is_a_persons(tmp_path: Path):
    path = tmp_path / "robot.toml"
    path.write_text(PROPOSED, encoding="utf-8")
    text, taken = with_filled_in(PROPOSED.replace("0.1, 0.2", "0.3, 0.4"), path)
    assert "imu.rotation_rpy_deg" in taken
    assert tomllib.loads(text)["imu"]["rotation_rpy_deg"] == [0.1, 0.2, 0.0]


def test_the_command_keeps_it(tmp_path: Path):
    words = ("--out", "drive", "--duration", 20, "--fix-rate", 0)
    succeeds("simulate", *words, cwd=tmp_path)
    command = ("inspect", "drive", "--write", "robot.toml")
    succeeds(*command, cwd=tmp_path)
    path = tmp_path / "robot.toml"
    text = path.read_text(encoding="utf-8").replace("mass = nan", "mass = 31.5")
    path.write_text(text, encoding="utf-8")
    assert "exists already" in fails(*command, cwd=tmp_path)
    done = succeeds(*command, "--overwrite", cwd=tmp_path)
    assert "kept from the file before: vehicle.mass" in done.stderr
    assert tomllib.loads(path.read_text(encoding="utf-8"))["vehicle"]["mass"] == 31.5
    shown = tomllib.loads(text)["vehicle"]["track_gauge"]
    assert tomllib.loads(text)["indices"]["eta0"] == 1.0
    narrower = text.replace(f"track_gauge = {shown}", "track_gauge = 0.42")
    path.write_text(narrower, encoding="utf-8")
    done = icreckon(*command, "--overwrite", cwd=tmp_path)
    assert "vehicle.track_gauge" in done.stderr
    assert "the file before is in robot.toml~" in done.stderr
    assert (tmp_path / "robot.toml~").read_text(encoding="utf-8") == narrower
    found = tomllib.loads(path.read_text(encoding="utf-8"))
    assert found["vehicle"]["track_gauge"] == 0.42
    assert found["indices"]["eta0"] == pytest.approx(shown / 0.42, rel=0.01)
    broken = text + "= 3"
    path.write_text(broken, encoding="utf-8")
    assert "what was filled in cannot be read" in fails(*command, "--overwrite", cwd=tmp_path)
    assert path.read_text(encoding="utf-8") == broken


def weaving(path: Path, tracks: str, per_metre: float = 1.0, gyro: float = 1.0) -> Path:
    """Table of a drive with an effective track of 0.9 m; speeds and rates in other units."""
    seconds = np.arange(0.0, 60.0, 0.02)
    rate = 0.6 * np.sin(0.4 * seconds)
    left, right = (per_metre * (0.5 + side * 0.5 * rate * 0.9) for side in (-1.0, 1.0))
    none = np.zeros_like(seconds)
    columns = [1.7e9 + seconds, left, right, none, none, gyro * rate, none, none, none + 9.81]
    head = f"time,{tracks},gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z"
    how = {"delimiter": ",", "fmt": "%.9f", "comments": "", "header": head}
    np.savetxt(path, np.column_stack(columns), **how)
    return path


def test_eta0_is_computed_once_the_radius_is_filled_in(tmp_path: Path):
    """Rates of wheels and no truth: the effective track is in units of the radius."""
    weaving(tmp_path / "own.csv", "left_rad_s,right_rad_s", per_metre=5.0)
    path, command = tmp_path / "robot.toml", ("inspect", "own.csv", "--write", "robot.toml")
    assert "--overwrite, which computes eta0" in icreckon(*command, cwd=tmp_path).stderr
    text = path.read_text(encoding="utf-8")
    assert "eta0 = nan    # not in the log: fill in (4.5 sprocket_radius / track_gauge" in text
    text = text.replace("track_gauge = nan", "track_gauge = 0.5")
    text = text.replace("sprocket_radius = nan", "sprocket_radius = 0.2")
    path.write_text(text, encoding="utf-8")
    succeeds(*command, "--overwrite", cwd=tmp_path)
    found = tomllib.loads(path.read_text(encoding="utf-8"))
    assert found["indices"]["eta0"] == pytest.approx(4.5 * 0.2 / 0.5, rel=0.02)
    assert found["vehicle"]["max_track_speed"] == pytest.approx(1.2 * 0.2 * 3.85, rel=0.05)


@pytest.mark.parametrize("unit", ["rad/s", "deg/s"])
def test_a_gyro_of_a_table_in_degrees_is_seen_by_its_size(tmp_path: Path, unit: str):
    """The track of the proposal is that of the robot."""
    gyro = np.degrees(1.0) if unit == "deg/s" else 1.0
    found = inspect(weaving(tmp_path / "own.csv", "left_speed_m_s,right_speed_m_s", gyro=gyro))
    proposed = tomllib.loads(found.proposed_robot_file)
    assert proposed["log"]["columns"]["imu"]["rate_unit"] == unit
    assert proposed["vehicle"]["track_gauge"] == pytest.approx(0.9, rel=0.02)
    told = [note for note in found.notes if "taken for deg/s" in note]
    assert len(told) == (unit == "deg/s")
