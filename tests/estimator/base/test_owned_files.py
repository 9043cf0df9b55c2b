"""Files of killed processes are removed; those of running ones, and others', are not."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from uuid import uuid4

import pytest

from icreckon.estimator.base.atomic_write import ABANDONED, remove_abandoned, write_whole
from icreckon.estimator.base.owned_files import is_held, owned

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")


def test_a_killed_process_holds_nothing(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    script = (
        "import sys, time; from pathlib import Path\n"
        "from icreckon.estimator.base.owned_files import owned\n"
        "with owned(Path(sys.argv[1])):\n    print('held', flush=True)\n    time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", script, mark], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert is_held(mark) is True
        process.kill()
        process.wait()
        assert is_held(mark) is False
    assert is_held(tmp_path / "nothing") is None


def test_only_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    write_whole(tmp_path / "there", b"1")
    left, young, busy = (tmp_path / f"there.{uuid4().hex}.tmp" for _ in range(3))
    foreign = tmp_path / "notes.tmp"
    for path in (left, young, foreign):
        path.write_bytes(b"half")
    with owned(busy):
        long_ago = time.time() - 2.0 * ABANDONED
        for path in (left, busy, foreign):
            os.utime(path, (long_ago, long_ago))
        remove_abandoned(tmp_path)
        assert {one.name for one in tmp_path.iterdir()} == {
            one.name for one in (tmp_path / "there", young, busy, foreign)
        }
