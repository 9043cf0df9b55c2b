"""Locks of processes end with them; files are replaced whole."""

import subprocess
import sys
from pathlib import Path

import pytest

from icreckon.estimator.base.files import is_held, write_whole

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")


def test_a_killed_process_holds_nothing(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    script = (
        "import sys, time; from pathlib import Path\n"
        "from icreckon.estimator.base.files import owned\n"
        "with owned(Path(sys.argv[1])):\n    print('held', flush=True)\n    time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", script, mark], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        assert is_held(mark) is True
        process.kill()
        process.wait()
        assert is_held(mark) is False
    assert is_held(tmp_path / "nothing") is None


def test_a_file_that_is_replaced_keeps_its_mode_and_its_links(tmp_path: Path) -> None:
    place, link = tmp_path / "secret" / "state.json", tmp_path / "state.json"
    place.parent.mkdir()
    place.write_bytes(b"old")
    place.chmod(0o600)
    link.symlink_to(place)
    write_whole(link, b"new")
    assert link.is_symlink()
    assert place.read_bytes() == b"new"
    assert place.stat().st_mode & 0o777 == 0o600
    place.unlink()
    write_whole(link, b"again")
    assert place.read_bytes() == b"again"
    assert list(place.parent.iterdir()) == [place]
