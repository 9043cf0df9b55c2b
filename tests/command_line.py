"""Running the command as a user does."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def icreckon(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from icreckon.cli.main import main; main()", *map(str, words)],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=300,
        check=False,
    )


def fails(*words: object, cwd: Path) -> str:
    """The one line that a command fails with."""
    done = icreckon(*words, cwd=cwd)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("icreckon: "), done.stderr
    return last
