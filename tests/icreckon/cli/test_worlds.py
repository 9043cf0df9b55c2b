"""Two commands at once in one place, and installations that nothing can be written to."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from command_line import MAIN, results_in, started
from conftest import REPOSITORY
from small_robot import drive, write_robot

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="permissions are those of POSIX")

STAMPS = [k * 10**8 for k in range(1, 60)]


def test_two_with_one_default_output_take_two_names(tmp_path: Path) -> None:
    drive(tmp_path / "log", STAMPS)
    write_robot(tmp_path / "robot.toml")
    words = ("replay", "log", "--robot", "robot.toml", "--variants", "gyro", "--formats", "none")
    both = [started(*words, "--workers", 1, cwd=tmp_path) for _ in range(2)]
    assert not any("Traceback" in one.communicate(timeout=240)[1] for one in both)
    codes = [one.returncode for one in both]
    assert set(codes) <= {0, 1}
    done = codes.count(0)
    folders = [one for one in tmp_path.iterdir() if (one / "results.json").is_file()]
    assert len(folders) == done >= 1
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".")]
    for folder in folders:
        assert results_in(folder)["variants"]


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A copy of the package, and an empty home, that cannot be written to."""
    place = tmp_path / "installed"
    skip = shutil.ignore_patterns("__pycache__", ".git")
    shutil.copytree(REPOSITORY / "icreckon", place / "icreckon", ignore=skip)
    (place / "home").mkdir()
    subprocess.run(["chmod", "-R", "a-w", place], check=True)
    yield place
    subprocess.run(["chmod", "-R", "u+w", place], check=True)


def confined(place: Path, *words: object, home: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command of a read-only installation; root without its privilege to write anywhere."""
    rights = "-dac_override,-dac_read_search"
    prefix = ["setpriv", "--bounding-set", rights, "--inh-caps", rights]
    if os.geteuid():
        prefix = []
    elif shutil.which("setpriv") is None:
        pytest.skip("root without setpriv cannot be confined")
    left_out = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "MPLCONFIGDIR", "XDG_CONFIG_HOME")
    env = {name: value for name, value in os.environ.items() if name not in left_out}
    return subprocess.run(
        [*prefix, sys.executable, "-c", MAIN, *map(str, words)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**env, "PYTHONPATH": str(place), "HOME": str(place / home)},
        timeout=300,
        check=False,
    )


def test_a_read_only_installation_reads_logs(tmp_path: Path, read_only: Path) -> None:
    drive(tmp_path / "log", STAMPS)
    done = confined(read_only, "inspect", "log", "--write", "new.toml", home="none", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "new.toml").is_file()
    assert not any("arning" in line for line in done.stderr.splitlines())
    failed = confined(read_only, "prepare", home="home", cwd=tmp_path)
    assert failed.returncode == 1
    (line,) = failed.stderr.strip().splitlines()
    assert line.startswith("icreckon: ")
    assert "NUMBA_CACHE_DIR" in line
