"""Names that hold markup, control characters or formulas, and terminals that lack characters."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from command_line import fails, icreckon_alone, succeeds
from icreckon import ReplayError, inspect
from small_robot import drive, write_robot

SECOND = 10**9
NAMES = ("/[/]a[red]b:smiley:$x_{$", "/esc\x1b[2Jx\x9b2J", "/line\nbreak")
STAMPS = [k * SECOND // 10 for k in range(1, 40)]


@pytest.mark.parametrize("name", NAMES)
def test_names_are_shown_as_they_are(tmp_path: Path, name: str) -> None:
    bag = drive(tmp_path / name.replace("/", ""), STAMPS, name)
    shown = name.replace("\x1b", "\ufffd").replace("\x9b", "\ufffd")
    done = succeeds("inspect", bag, cwd=tmp_path)
    table = done.stdout.partition("Proposed robot file")[0]
    assert all(part in table for part in shown.split("\n"))
    write_robot(tmp_path / "robot.toml", name, name)
    words = ("--robot", "robot.toml", "--variants", "gyro", "--workers", 1)
    done_too = succeeds("replay", bag, *words, cwd=tmp_path)
    for text in (done.stdout, done.stderr, done_too.stdout, done_too.stderr):
        assert "\x1b" not in text
        assert "\x9b" not in text
    missing = fails("replay", bag, "--robot", f"{name[1:]}.toml", cwd=tmp_path)
    assert "\x1b" not in missing


@pytest.mark.parametrize("name", ["a\nb", '"a\x1b[31mb"\\b'])
def test_file_names_make_valid_robot_files(tmp_path: Path, name: str) -> None:
    bag = drive(tmp_path / name, STAMPS)
    done = succeeds("inspect", bag, "--write", "robot.toml", cwd=tmp_path)
    assert "\x1b" not in done.stderr
    written = tomllib.loads((tmp_path / "robot.toml").read_text(encoding="utf-8"))
    assert written["name"] == name


def test_a_name_that_is_not_utf8_is_refused(tmp_path: Path) -> None:
    bag = drive(tmp_path / "log", STAMPS)
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/od\xffd"))
    bag.rename(odd)
    with pytest.raises(ReplayError, match="the name is not UTF-8; rename the file"):
        inspect(odd)
    assert "od\\udcffd" in fails("inspect", odd, cwd=tmp_path, run=icreckon_alone)


def test_letters_that_a_figure_lacks_are_no_warning(tmp_path: Path) -> None:
    """Tests make errors of warnings, and a command prints them."""
    bag = drive(tmp_path / "\u8d70\u884c", STAMPS)
    write_robot(tmp_path / "robot.toml", "\u8eca\u4e21 \u0e23\u0e16")
    words = ("--robot", "robot.toml", "--variants", "gyro", "--workers", 1, "--out", "out")
    done = succeeds("replay", bag, *words, cwd=tmp_path, drawn=True)
    assert "Glyph" not in done.stderr
    assert "\u8eca\u4e21" in (tmp_path / "out" / "page.html").read_text(encoding="utf-8")


def test_a_terminal_that_lacks_characters(tmp_path: Path) -> None:
    bag = drive(tmp_path / "log", STAMPS, "/räder/\u8f66")
    done = subprocess.run(
        [sys.executable, "-c", "from icreckon.cli.main import main; main()", "inspect", str(bag)],
        capture_output=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONIOENCODING": "latin-1"},
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "/räder/?" in done.stdout.decode("latin-1")
