"""`icreckon study` from end to end, in processes of their own, killed at will."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import study_stub
from command_line import MAIN, icreckon, started, succeeds
from conftest import REPOSITORY
from icreckon import SimulationError, study_names
from icreckon.cli.study import command
from icreckon.simulation.running import engines

TINY = """
description = "Very small."
variants = ["constant-online", "differential"]
runs = 8
truths = 4
horizons = [4.0]
[scenario]
duration = 10.0
outages = [[5.0, 10.0]]
[sweep.grid]
gyro.factor = [1.0, 10.0]
"""
BLOCKS = 4


def finished_blocks(cwd: Path) -> int:
    return len(list((cwd / "icreckon-study" / "tiny" / "blocks").glob("*.npz")))


def contents(cwd: Path) -> Any:
    """Bytes by name of the files of the study."""
    return study_stub.contents(cwd / "icreckon-study" / "tiny")


@pytest.fixture(scope="module", autouse=True)
def _stub() -> Iterator[None]:
    """An engine that takes no time, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        engine = engines.Engine("stub", "study_stub", 4, threads=True)
        patch.setattr(engines, "ENGINES", [engine])
        yield


def slowly(seconds: float, *, threads: bool) -> dict[str, Any]:
    """How a command is started whose blocks take so long."""
    engine = f"engines.Engine('stub', 'study_stub', 4, threads={threads})"
    script = (
        f"from icreckon.simulation.running import engines\nengines.ENGINES[:] = [{engine}]\n{MAIN}"
    )
    found_at = os.pathsep.join([str(REPOSITORY / "tests"), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": found_at, study_stub.PACE: str(seconds)}
    return {"script": script, "env": environment}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "tiny.toml").write_text(TINY, encoding="utf-8")
    done = succeeds("study", "tiny.toml", "--workers", 1, cwd=folder)
    assert "drift after 4 s" in done.stdout
    assert "Over 2 cells of 8 runs each, the median drift of constant-online is" in " ".join(
        done.stdout.split()
    )
    assert "page.html" in done.stderr
    return folder


@pytest.fixture
def here(tmp_path: Path) -> Path:
    (tmp_path / "tiny.toml").write_text(TINY, encoding="utf-8")
    return tmp_path


def test_the_results_are_printed_as_json_on_demand(undisturbed: Path) -> None:
    done = icreckon("study", "tiny.toml", "--json", cwd=undisturbed)
    assert "going on: 4 of 4 blocks are there" in done.stderr
    assert done.stdout.encode() == contents(undisturbed)["results.json"]
    told = json.loads(done.stdout)
    assert told["command"] == "study"
    assert told["overall"]["constant-online"]["drift_percent_4s"]["n"] == 8


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for processes in /proc")
def test_killed_it_loses_no_finished_block_and_comes_to_the_same(here, undisturbed):
    words, how = ("study", "tiny.toml", "--workers", 1), slowly(0.5, threads=False)
    process = started(*words, cwd=here, until=lambda: finished_blocks(here), **how)
    listed = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="utf-8")
    workers = [int(word) for word in listed.split()]
    process.kill()
    process.communicate()
    kept = finished_blocks(here)
    assert 1 <= kept < BLOCKS
    assert "results.json" not in contents(here)
    deadline = time.monotonic() + 10.0
    while any(Path(f"/proc/{worker}/exe").exists() for worker in workers):
        assert time.monotonic() < deadline, "a worker outlives the command"
        time.sleep(0.05)
    done = icreckon("study", "tiny.toml", "--workers", 1, cwd=here)
    assert f"going on: {kept} of {BLOCKS} blocks are there" in done.stderr
    assert contents(here) == contents(undisturbed)


@pytest.mark.parametrize(
    ("threads", "number", "word"),
    [(True, signal.SIGINT, "interrupted"), (False, signal.SIGTERM, "terminated")],
    ids=["threads", "processes"],
)
def test_a_signal_waits_for_nothing_and_says_how_to_go_on(here, threads, number, word):
    """Blocks take minutes here, so whoever waits for one is late."""
    manifest = here / "icreckon-study" / "tiny" / "manifest.json"
    words, how = ("study", "tiny.toml", "--workers", 1), slowly(300.0, threads=threads)
    with started(*words, cwd=here, until=manifest.exists, **how) as process:
        time.sleep(0.5)
        os.killpg(process.pid, number)
        _, told = process.communicate(timeout=120)
    assert process.returncode == 128 + number
    (line,) = [one for one in told.splitlines() if one]
    assert f"icreckon: {word}; 0 of 4 blocks are in icreckon-study/tiny/" in line
    assert "Go on with the same command: icreckon study tiny.toml --workers 1" in told


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ({"study": None}, "which study.* or a name: driving-style, imu-grades"),
        ({"study": "nowhere.toml"}, "nowhere.toml: no such file"),
        ({"out": Path()}, "holds no study of icreckon"),
    ],
)
def test_what_cannot_be_done_is_said(here, monkeypatch, words, told):
    monkeypatch.chdir(here)
    asked: dict[str, Any] = dict.fromkeys(("out", "runs", "workers"))
    asked |= dict.fromkeys(("as_json", "wide", "overwrite", "list_studies"), False)
    with pytest.raises(SimulationError, match=told):
        command(**asked | {"study": "tiny.toml"} | words)


def test_the_shipped_studies_are_listed(here: Path) -> None:
    shown = icreckon("study", "--list", cwd=here).stdout
    assert all(name in shown for name in study_names())
