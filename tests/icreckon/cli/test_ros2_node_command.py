"""`icreckon ros2-node` on the command line, without ROS."""

from __future__ import annotations

from pathlib import Path

import pytest

from command_line import fails


@pytest.mark.parametrize("words", [["--varient", "gyro"], ["-r", "/a:=/b"], ["robot.toml"]])
def test_an_unknown_argument_is_refused(words: list[str], tmp_path: Path) -> None:
    said = fails("ros2-node", *words, cwd=tmp_path)
    assert f"unknown argument {words[0]!r}" in said
    assert "--ros-args" in said
