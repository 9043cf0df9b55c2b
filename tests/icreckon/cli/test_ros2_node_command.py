"""`icreckon ros2-node` on the command line, without ROS."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("words", [["--varient", "gyro"], ["-r", "/a:=/b"], ["robot.toml"]])
def test_an_unknown_argument_is_refused(words: list[str]) -> None:
    program = Path(sys.executable).parent / "icreckon"
    command = [program, "ros2-node", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert f"icreckon: unknown argument {words[0]!r}" in done.stderr
    assert "--ros-args" in done.stderr
    assert "Traceback" not in done.stderr
