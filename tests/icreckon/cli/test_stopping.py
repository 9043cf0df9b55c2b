"""Commands that a signal stops: cleaned up, one line, and no process left."""

import contextlib
import errno
import os
import signal
import sys
import time
import warnings
from functools import partial
from pathlib import Path

import psutil
import pytest

from command_line import MAIN, fails, icreckon_alone, started, succeeds
from conftest import thorough
from icreckon.cli.common.console import explain
from icreckon.cli.common.stopping import warned_in_one_line
from icreckon.replay.base.outputs import is_being_written

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")


def living(session: int) -> list[int]:
    """Processes of a session that are no zombies."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, ProcessLookupError):
            if os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
    return found


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    succeeds("simulate", "--out", "drive", "--duration", "200", cwd=folder)
    return folder / "drive"


@pytest.mark.parametrize(
    ("number", "word"), [(signal.SIGTERM, "terminated"), (signal.SIGINT, "interrupted")]
)
def test_a_signal_leaves_one_line_and_nothing_else(bag, tmp_path, number, word):
    """Ctrl-C reaches all processes of the terminal, SIGTERM the command alone."""
    words = ("replay", bag, "--robot", "auriga-alpha", "--workers", 2, "--out", "out")
    with started(*words, cwd=tmp_path, until=lambda: is_being_written(tmp_path / "out")) as one:
        time.sleep(1.5)
        if number is signal.SIGINT:
            os.killpg(one.pid, number)
        else:
            one.send_signal(number)
        _, told = one.communicate(timeout=60)
    assert one.returncode == 128 + number
    lines = [line for line in told.splitlines() if line and not line.startswith("read ")]
    assert lines == [f"icreckon: {word}"]
    assert not list(tmp_path.iterdir())
    deadline = time.monotonic() + 10.0
    while living(one.pid):
        assert time.monotonic() < deadline, "a process outlives the command"
        time.sleep(0.05)


def test_code_that_llvm_calls_is_finished_first(tmp_path):
    """An interrupt there left machine code without an address, and the call of it crashed."""
    inside = "os.kill(os.getpid(), signal.SIGTERM); time.sleep(0.2); print('finished', flush=True)"
    script = (
        "import os, signal, time\n"
        "from icreckon.cli.common.stopping import stopped_in_one_line\n"
        "with stopped_in_one_line():\n"
        f"    exec({inside!r}, globals() | {{'__name__': 'numba.core.codegen'}})\n"
        "    time.sleep(10.0)\n"
    )
    with started(cwd=tmp_path, script=script) as one:
        assert one.communicate(timeout=60) == ("finished\n", "icreckon: terminated\n")
    assert one.returncode == 128 + signal.SIGTERM


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "--duration", "10", "--out", "out"),
        thorough(("simulate", "--duration", "30", "--format", "sqlite3", "--out", "out")),
        ("inspect", "BAG", "--write", "robot.toml"),
    ],
    ids=lambda words: "-".join(words[:5:4]),
)
def test_no_room_is_one_line_and_leaves_nothing(words, bag, tmp_path):
    """No file may be longer than a kilobyte; the compile cache has what they need, or does without."""
    # Python would leave byte code of a kilobyte, which no later process could load.
    limited = (
        "import resource, sys; sys.dont_write_bytecode = True\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n{MAIN}"
    )
    alone = partial(icreckon_alone, script=limited)
    last = fails(*(bag if word == "BAG" else word for word in words), cwd=tmp_path, run=alone)
    assert last.startswith(f"icreckon: {'robot.toml' if 'inspect' in words else 'out'}")
    assert "cannot be written" in last
    assert not list(tmp_path.iterdir())


def test_warnings_are_one_line_without_source() -> None:
    with warned_in_one_line():
        shown = warnings.formatwarning("so it is", UserWarning, "file.py", 3)
    assert shown == "icreckon: so it is\n"
    assert "file.py" in warnings.formatwarning("so it is", UserWarning, "file.py", 3)


@pytest.mark.parametrize(
    ("problem", "status", "text"),
    [
        (MemoryError(), 1, "out of memory: close other programs"),
        (OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)), 1, "out of memory"),
        (ImportError("lapack.so: failed to map segment from shared object"), 1, "out of memory"),
        (ImportError("No module named 'lapack'"), 70, "internal error: ImportError"),
    ],
)
def test_too_little_memory_is_one_line_and_a_missing_library_is_a_defect(
    problem, status, text, capsys
):
    assert explain(problem) == status
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"icreckon: {text}")
