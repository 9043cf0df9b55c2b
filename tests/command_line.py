"""Running the command as a user does: in a process of its own, or in this one, which is quicker."""

import io
import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import chdir, nullcontext, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest import mock

from icreckon.cli.main import main

Done = subprocess.CompletedProcess[str]
# Started in the background, the tests hand on that interrupts are ignored.
MAIN = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "from icreckon.cli.main import main; main()"
)
NO_PICTURE = b"\x89PNG\r\n"


def blank(_: object, target: Any, **__: object) -> None:
    """Write a figure that is none, where one would be drawn."""
    if isinstance(target, str | Path):
        Path(target).write_bytes(NO_PICTURE)
    else:
        target.write(NO_PICTURE)


def icreckon(*words: object, cwd: Path, drawn: bool = False) -> Done:
    """Run the command in this process, which has imported and compiled what it needs.

    Drawing takes half of the time of most commands: figures stay blank where no test looks at them.
    """
    command = ["icreckon", *map(str, words)]
    out, err, code = io.StringIO(), io.StringIO(), 0
    with (
        mock.patch.object(sys, "argv", command),
        redirect_stdout(out),
        redirect_stderr(err),
        chdir(cwd),
        nullcontext() if drawn else mock.patch("matplotlib.figure.Figure.savefig", blank),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        except Exception:
            traceback.print_exc()
            code = 1
    return subprocess.CompletedProcess(command, code, out.getvalue(), err.getvalue())


def icreckon_alone(*words: object, cwd: Path, **how: Any) -> Done:
    """Run the command in a process of its own."""
    with started(*words, cwd=cwd, **how) as process:
        out, err = process.communicate(timeout=300)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def started(
    *words: object,
    cwd: Path,
    script: str = MAIN,
    env: dict[str, str] | None = None,
    until: Callable[[], object] = lambda: True,
) -> subprocess.Popen[str]:
    """A command in a session of its own, once something holds."""
    process = subprocess.Popen(
        [sys.executable, "-c", script, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env=os.environ if env is None else env,  # without what readline adds: a width of 80
        start_new_session=True,
    )
    deadline = time.monotonic() + 120.0
    while not until():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return process


def succeeds(*words: object, cwd: Path, run: Callable[..., Done] = icreckon, **how: bool) -> Done:
    """Run a command that ends well."""
    done = run(*words, cwd=cwd, **how)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def results_in(folder: Path) -> dict[str, Any]:
    """Content of the results.json in a folder."""
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def fails(*words: object, cwd: Path, run: Callable[..., Done] = icreckon) -> str:
    """The one line that a command fails with."""
    done = run(*words, cwd=cwd)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("icreckon: "), done.stderr
    return last
