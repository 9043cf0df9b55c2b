"""Progress on a terminal: from the first second on, and of how many."""

import contextlib
import os
import pty
import subprocess
import sys
from pathlib import Path

from rich.progress import Task

from icreckon.cli.common import console
from icreckon.cli.common.comparing import kernels_of
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.tracing import kernel_cache

COUNTED = """
from icreckon import ImuSample, Log, TrackSpeeds, load_robot, run
from icreckon.estimator.tracing.kernel_cache import CodeFiles
names, load = set(), CodeFiles.load
CodeFiles.load = lambda self, *key: names.add(key) or load(self, *key)
stamps = range(0, 1_000_000_000, 10_000_000)
tracks = [TrackSpeeds(stamp, 0.5, 0.5) for stamp in stamps]
imu = [ImuSample(stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)) for stamp in stamps]
for variant in {}:
    run(Log.from_measurements([*tracks, *imu]), load_robot("auriga-alpha"), variant)
print(len(names))
"""


def test_the_total_is_that_of_the_functions_that_filters_compile() -> None:
    """One process has the functions of several filters only once."""
    script = COUNTED.format([*VARIANTS])
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert int(done.stdout) == kernels_of([*VARIANTS])


def title(monkeypatch, tmp_path: Path, counts: list[int], compiles: int) -> list[str]:
    """Texts of the bar, one after the other, with so many kernels on disk."""
    folder = tmp_path / kernel_cache.environment_digest("estimator")
    column, found = console._Title(compiles), []
    task = Task(0, "filtering", 1.0, 0.0, _get_time=lambda: 0.0)  # type: ignore[arg-type]
    for count in counts:
        files = [folder / str(k) for k in range(count)] + [tmp_path / "other" / "kernel"]
        monkeypatch.setattr(kernel_cache, "kernel_files", lambda files=files: files)
        found.append(column.render(task).plain)
    return found


def test_compiled_functions_are_counted_with_their_total(monkeypatch, tmp_path: Path) -> None:
    text = "compiling filters (first run only)"
    found = title(monkeypatch, tmp_path, [0, 3, 22, 23], 22)
    assert found == [f"{text} 0/22", f"{text} 3/22", f"{text} 22/22", f"{text} 23"]
    assert title(monkeypatch, tmp_path, [30, 30], 22) == ["filtering"] * 2
    assert title(monkeypatch, tmp_path, [0], 0) == ["filtering"]


def on_terminal(tmp_path: Path, *arguments: str) -> str:
    """What a command shows on a terminal of 80 columns."""
    main, side = pty.openpty()
    command = [Path(sys.executable).parent / "icreckon", *arguments]
    environment = os.environ | {"COLUMNS": "80"}
    running = subprocess.Popen(command, cwd=tmp_path, stdout=side, stderr=side, env=environment)
    os.close(side)
    shown = b""
    # A terminal without a program at its other side is an OSError.
    with contextlib.suppress(OSError), os.fdopen(main, "rb", buffering=0) as terminal:
        while read := terminal.read(1000):
            shown += read
    running.wait()
    return shown.decode()


def test_a_terminal_shows_at_once_what_is_done(tmp_path: Path) -> None:
    shown = on_terminal(tmp_path, "replay", "none.bag")
    assert shown.startswith("loading icreckon replay")


def test_a_simulation_shows_what_it_does(tmp_path: Path) -> None:
    """The first one compiles for 15 s."""
    shown = on_terminal(tmp_path, "simulate", "--out", "bag", "--duration", "5", "--seed", "3")
    assert "simulating 5 s of auriga-alpha (the first run compiles)" in shown
