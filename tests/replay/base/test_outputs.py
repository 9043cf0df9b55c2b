"""Outputs of commands that are killed, run at once, or find no room."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from icreckon.replay.base.errors import ReplayError
from icreckon.replay.base.outputs import is_being_written, written_beside

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")

WRITER = """
import sys, time
from pathlib import Path
from icreckon.replay.base.outputs import written_beside
with written_beside(Path(sys.argv[1]), overwrite=True) as new:
    new.mkdir()
    (new / "metadata.yaml").write_text("half")
    print("writes", flush=True)
    time.sleep(60)
"""


def begin(path: Path) -> subprocess.Popen[bytes]:
    process = subprocess.Popen([sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE)
    process.stdout.readline()
    return process


def write(path: Path, text: str, *, overwrite: bool = False) -> None:
    with written_beside(path, overwrite=overwrite) as new:
        new.mkdir()
        (new / "metadata.yaml").write_text(text, encoding="utf-8")


def test_what_a_killed_process_left_goes_with_the_next_run(tmp_path: Path) -> None:
    """Others' folders stay, however alike their names; so do those of processes that still run."""
    path = tmp_path / "out"
    foreign, other = tmp_path / ".out.abcdefgh", tmp_path / ".out.backup"
    for folder in (foreign, other):
        folder.mkdir()
    with begin(path) as killed, begin(tmp_path / "out2") as running:
        killed.kill()
        killed.wait()
        write(path, "whole")
        assert is_being_written(tmp_path / "out2")
        left = sorted(one.name.split(".")[1] for one in tmp_path.iterdir() if one.name[0] == ".")
        assert left == ["out", "out", "out2"]
        assert foreign.exists()
        assert other.exists()
        running.kill()


def test_two_never_write_to_one_path(tmp_path: Path) -> None:
    path = tmp_path / "out"
    with begin(path) as first:
        with pytest.raises(ReplayError, match="is being written by another process"):
            write(path, "second", overwrite=True)
        assert is_being_written(path)
        first.kill()
        first.wait()
        write(path, "second")
    assert not is_being_written(path)


def test_errors_name_the_target_and_leave_nothing(tmp_path: Path) -> None:
    path = tmp_path / "out"
    for number in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT):
        with (
            pytest.raises(ReplayError, match=f"^{path}: cannot be written: {os.strerror(number)}"),
            written_beside(path),
        ):
            raise OSError(number, os.strerror(number))
    with pytest.raises(ReplayError, match=f"^{path}/x: cannot be"), written_beside(path) as new:
        raise ReplayError(f"{new}/x: cannot be written")
    # Errors of reading are none of the output.
    with pytest.raises(FileNotFoundError), written_beside(path):
        (tmp_path / "log").read_bytes()
    assert not list(tmp_path.iterdir())


def write_results_folder(path: Path, *names: str) -> None:
    with written_beside(path, overwrite=True, marker="results.json", keeps_foreign=True) as new:
        new.mkdir()
        for name in ("results.json", *names):
            (new / name).write_text("ours", encoding="utf-8")


def test_files_of_a_person_stay_in_a_folder_that_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    write_results_folder(folder, "gyro.tum", "page.html")
    (folder / "notes.txt").write_text("mine", encoding="utf-8")
    (folder / "plots").mkdir()
    (folder / "plots" / "a.png").write_text("mine", encoding="utf-8")
    (folder / "inertia.tum").write_text("mine", encoding="utf-8")
    (folder / "there").symlink_to(tmp_path)
    write_results_folder(folder, "inertia.tum", "page.html")
    assert (folder / "notes.txt").read_text(encoding="utf-8") == "mine"
    assert (folder / "plots" / "a.png").read_text(encoding="utf-8") == "mine"
    assert (folder / "there").is_symlink()
    # A name that is taken: both are there.
    assert (folder / "inertia.tum").read_text(encoding="utf-8") == "ours"
    assert (folder / "inertia.tum.kept").read_text(encoding="utf-8") == "mine"
    # Results of the run before are gone.
    assert not (folder / "gyro.tum").exists()
    write_results_folder(folder)
    assert sorted(one.name for one in folder.iterdir()) == [
        ".icreckon-files",
        "inertia.tum.kept",
        "notes.txt",
        "plots",
        "results.json",
        "there",
    ]
