"""What a shell gets beyond results: completion of names, and what is logged."""

import logging

import pytest

from command_line import icreckon, icreckon_alone
from icreckon.cli.main import app
from small_robot import drive, write_robot


@pytest.mark.parametrize(
    ("words", "proposed"),
    [
        ("check --robot hu", ["husky", "husky-deflated"]),
        ("replay log.bag --robot jack", ["jackal"]),
        ("simulate --robot warth", ["warthog"]),
        ("replay log.bag --variants gyro,ine", ["gyro,inertia-fixed", "gyro,inertia-online"]),
        ("ros2-node --variant full", ["full-linear"]),
        ("study dri", ["driving-style"]),
    ],
)
def test_names_are_completed(words, proposed, monkeypatch, capsys):
    """What the shell proposes for the last word."""
    monkeypatch.setenv("_ICRECKON_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"icreckon {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    with pytest.raises(SystemExit):
        app(prog_name="icreckon")
    assert capsys.readouterr().out.split() == proposed


def test_what_is_logged_is_printed_from_a_level_on(tmp_path):
    robot = write_robot(tmp_path / "small.toml")
    log = drive(tmp_path / "drive", [round((1000.0 + 0.02 * k) * 1e9) for k in range(100)])
    loud = icreckon_alone("--log-level", "info", "check", log, "--robot", robot, cwd=tmp_path)
    quiet = icreckon("check", log, "--robot", robot, cwd=tmp_path)
    record = "INFO icreckon.replay.reading.read_log: read <Log 'drive', "
    assert record in loud.stderr
    assert record not in quiet.stderr
    assert quiet.stdout == loud.stdout


def test_a_program_that_sets_no_logging_up_gets_nothing_on_stderr():
    handlers = logging.getLogger("icreckon").handlers
    assert any(isinstance(one, logging.NullHandler) for one in handlers)
