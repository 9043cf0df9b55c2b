"""`icreckon replay` over several logs, and with several robot files."""

import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from command_line import Done, fails, icreckon, results_in, succeeds
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER

WORDS = ("--variants", "gyro,constant-online", "--formats", "none", "--workers", 1)
AURIGA = ("--robot", "auriga-alpha")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two simulated drives of different lengths, a file that is none, and a second robot file."""
    folder = tmp_path_factory.mktemp("many")
    for name, seconds in (("monday", 40), ("tuesday <&>", 35)):
        words = ("--duration", seconds, "--seed", seconds, "--fix-rate", 0)
        succeeds("simulate", "--out", folder / name, *words, cwd=folder)
    (folder / "broken.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    text = (ROBOTS_FOLDER / "auriga-alpha.toml").read_text(encoding="utf-8")
    gauge = re.search(r"^track_gauge = ([\d.]+)", text, re.MULTILINE)
    wide = text.replace(gauge[0], f"track_gauge = {1.2 * float(gauge[1])}")
    (folder / "wide.toml").write_text(wide, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def both(folder: Path) -> Done:
    words = ("monday", "broken.bag", "tuesday <&>", *AURIGA, *WORDS, "--out", "both")
    return icreckon("replay", *words, cwd=folder)


def test_each_log_has_a_folder_or_its_reason_and_all_have_a_page(folder: Path, both: Done) -> None:
    assert both.returncode == 1
    last = both.stderr.strip().splitlines()[-1]
    assert last.startswith("ERROR: broken has no result: ")
    assert "broken.bag" in last
    assert "Traceback" not in both.stderr
    assert "results in both/" in both.stderr.replace("\n", "")
    results = results_in(folder / "both")
    assert [one["folder"] for one in results["logs"]] == ["monday", "tuesday <&>"]
    for name in ("monday", "tuesday <&>"):
        own = results_in(folder / "both" / name)
        assert own["configuration"]["log"] == name
        assert (folder / "both" / name / "figure.png").exists()
    assert not (folder / "both" / "broken").exists()
    page = (folder / "both" / "page.html").read_text(encoding="utf-8")
    links = re.findall(r'<a href="([^"]+)">', page)
    assert links == ["monday/page.html", "tuesday%20%3C%26%3E/page.html"]
    assert "tuesday &lt;&amp;&gt;" in page
    assert "broken has no result" in page


@pytest.fixture(scope="module")
def robots(folder: Path) -> Done:
    """Both drives with two robot files, on a terminal of 80 columns."""
    words = ("monday", "tuesday <&>", *AURIGA, "--robot", "wide.toml", *WORDS, "--out", "robots")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "80")
        patch.setattr("icreckon.cli.common.console.TABLE_WIDTH", 80)
        return icreckon("replay", *words, cwd=folder)


def test_the_table_of_all_logs_fits_80_columns(both: Done, robots: Done) -> None:
    assert "All logs together: 2 logs" in both.stdout
    for name in ("gyro", "constant-online"):
        assert re.search(rf"│ {name} +│ +\d+\.\d\d │", both.stdout)
    assert robots.returncode == 0, robots.stderr
    assert max(map(len, robots.stdout.splitlines())) <= 80
    assert "…" not in robots.stdout
    assert "--wide shows all columns" in robots.stdout


def test_two_robot_files_are_compared_on_the_same_segments(folder: Path, robots: Done) -> None:
    assert robots.returncode == 0, robots.stderr
    results = results_in(folder / "robots")
    assert list(results["pooled"]) == ["auriga-alpha", "wide"]
    places = ["monday/auriga-alpha", "monday/wide", "tuesday <&>/auriga-alpha", "tuesday <&>/wide"]
    assert [one["folder"] for one in results["logs"]] == places
    assert all((folder / "robots" / place / "page.html").exists() for place in places)
    ratio = results["ratios"]["wide"]
    assert ratio["to"] == "auriga-alpha"
    assert set(ratio["variants"]) == {"gyro", "constant-online"}
    assert ratio["variants"]["gyro"]["logs"] == 2
    page = (folder / "robots" / "page.html").read_text(encoding="utf-8")
    assert "Robot files compared" in page


def test_what_cannot_be_compared_is_refused_in_one_line(folder: Path) -> None:
    same = ("monday", *AURIGA, *AURIGA, *WORDS)
    assert "robot file auriga-alpha is given twice" in fails("replay", *same, cwd=folder)
    same = ("monday", "./monday", *AURIGA, *WORDS)
    assert "log monday is given twice" in fails("replay", *same, cwd=folder)
    only = fails("replay", "broken.bag", "missing.bag", *AURIGA, *WORDS, "--out", "no", cwd=folder)
    assert "no log has a result: broken: " in only
    assert not (folder / "no").exists()


def test_an_interrupt_is_no_failure_of_a_log(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from icreckon.cli import replay
    from icreckon.cli.common.stopping import Stop

    def stopped(*_: object, **__: object) -> None:
        Stop.number = 2
        raise RuntimeError("a library's own error")

    monkeypatch.setattr(replay, "compare_and_write", stopped)
    monkeypatch.setattr(os, "_exit", sys.exit)  # which would end the tests, too
    done = icreckon("replay", "monday", "tuesday <&>", *AURIGA, *WORDS, "--out", "x", cwd=folder)
    assert done.returncode == 130
    assert "has no result" not in done.stderr


def test_a_defect_loses_its_log_alone(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from icreckon.cli import replay

    real: Callable[..., object] = replay.compare_and_write

    def broken(log: object, *words: object, **options: object) -> object:
        if getattr(log, "name", "") == "monday":
            raise ZeroDivisionError("of a bug")
        return real(log, *words, **options)

    monkeypatch.setattr(replay, "compare_and_write", broken)
    done = icreckon("replay", "monday", "tuesday <&>", *AURIGA, *WORDS, "--out", "y", cwd=folder)
    assert done.returncode == 1
    assert "monday has no result: ZeroDivisionError: of a bug" in done.stderr
    assert (folder / "y" / "tuesday <&>" / "page.html").exists()
