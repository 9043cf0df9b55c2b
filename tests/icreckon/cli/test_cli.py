"""The command line from end to end; each command once in a process of its own."""

import json
import os
import shlex
import subprocess
import sys
from functools import partial
from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np
import pytest

from command_line import fails, icreckon_alone, results_in, succeeds
from conftest import thorough
from icreckon import VARIANTS, EncoderSpec, FixSpec, Log, load_robot, read_log, simulate
from icreckon.cli.main import COMMANDS, load
from icreckon.simulation.scenario import load_scenario


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short demo, run once."""
    folder = tmp_path_factory.mktemp("demo")
    done = succeeds("demo", "--duration", 60, "--workers", 1, cwd=folder, drawn=True)
    assert "truth: friction" in done.stdout
    assert all(variant in done.stdout for variant in VARIANTS)
    return folder / "icreckon-demo"


def test_demo_leaves_everything_it_promises(demo: Path) -> None:
    assert {path.name for path in demo.iterdir()} == {
        *(".icreckon-files", "bag", "figure.png", "odometry.mcap", "page.html", "results.json"),
        *(f"{name}.tum" for name in (*VARIANTS, "ground_truth")),
    }
    assert (demo / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert not [path for path in demo.parent.iterdir() if path != demo]


def test_demo_results_say_what_was_done(demo: Path) -> None:
    results = results_in(demo)
    assert [results[key] for key in ("format", "command", "seed")] == [1, "demo", 1]
    assert results["configuration"]["outages"] == [[20.0, 60.0]]
    assert results["versions"]["numpy"] == np.__version__
    assert results["truth"]["source"] == "friction"
    assert set(results["variants"]) == set(VARIANTS)
    assert len(results["inputs"]["bag"]) == len("sha256:") + 64
    for scores in results["variants"].values():
        for key in ("drift_percent_30s_mean", "yaw_drift_deg_per_m", "rmse_v_y_m_s"):
            assert scores[key] > 0.0
        assert scores["nees_pose_mean"] > 0.0
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    drift = {name: scores["drift_percent_10s_mean"] for name, scores in results["variants"].items()}
    assert drift["inertia-online"] < min(drift["constant-online"], drift["gyro"])


@pytest.mark.thorough
def test_demo_is_reproducible_and_does_not_overwrite(demo: Path, tmp_path: Path) -> None:
    again = succeeds("demo", "--duration", 60, "--json", "--workers", 1, cwd=tmp_path)
    first = results_in(demo)
    assert json.loads(again.stdout)["variants"] == first["variants"]
    assert "exists already" in fails("demo", "--out", "icreckon-demo", cwd=tmp_path)
    assert results_in(tmp_path / "icreckon-demo") == json.loads(again.stdout)


@pytest.mark.parametrize("kind", ["mcap", thorough("sqlite3"), thorough("ros1")])
def test_simulate_replay_and_inspect_in_each_format(kind: str, tmp_path: Path) -> None:
    bag = tmp_path / ("run.bag" if kind == "ros1" else "run")
    words = ("--duration", 30, "--format", kind, "--seed", 5, "--outage", "10:30")
    succeeds("simulate", "--out", bag, *words, cwd=tmp_path)
    words = ("--variants", "constant-online, inertia-online", "--json", "--workers", 1)
    replayed = succeeds("replay", bag, "--robot", "auriga-alpha", *words, cwd=tmp_path)
    results = json.loads(replayed.stdout)
    assert list(results["variants"]) == ["constant-online", "inertia-online"]
    assert results["log"]["fixes"] == 10
    assert results["variants"]["inertia-online"]["final_position_error_m"] < 0.5
    found = succeeds("inspect", bag, "--write", "robot.toml", cwd=tmp_path)
    assert "/joint_states" in found.stdout
    proposed = (tmp_path / "robot.toml").read_text(encoding="utf-8")
    assert 'topic = "/ground_truth/pose"' in proposed
    words = ("--robot", "robot.toml", "--variants", "differential", "--out", "again")
    assert "not filled in" in fails("replay", bag, *words, cwd=tmp_path)
    completed = proposed.replace("radius = nan", "radius = 0.1").replace("= nan", "= 1.0")
    (tmp_path / "robot.toml").write_text(completed, encoding="utf-8")
    succeeds("replay", bag, *words, cwd=tmp_path)


def test_simulate_a_scenario_file_and_what_the_command_line_changes(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(
        'trajectory = "circle"\nduration = 20\nseed = 3\nnoise = "perfect"\nfix_rate = 2.0\n'
        "outages = [[5, 15]]\n[trajectory_options]\nspeed = 0.4\n[encoders]\nresolution = 0.01\n"
    )
    (tmp_path / "drive.csv").write_text("t,left,right\n0,0,0\n5,0.5,0.5\n")
    robot, file = load_robot("auriga-alpha"), load_scenario(tmp_path / "run.toml")

    def made(name: str, *more: object) -> Log:
        succeeds("simulate", "--scenario", "run.toml", "--out", name, *more, cwd=tmp_path)
        return read_log(tmp_path / name, robot)

    same(made("as-it-is"), simulate(file, robot))
    changes = ("--duration", 10, "--outage", "2:4", "--set", "fixes.sigma=0.3", "--seed", 4)
    settings = ("--set", "encoders.resolution=0.001", "--set", "trajectory_options.turn=.3")
    fixes, encoders = FixSpec(sigma=0.3), EncoderSpec(resolution=0.001)
    changed = {"duration": 10.0, "outages": ((2.0, 4.0),), "seed": 4, "fixes": fixes}
    changed |= {"encoders": encoders, "trajectory_options": {"speed": 0.4, "turn": 0.3}}
    expected = simulate(msgspec.structs.replace(file, **changed), robot)
    same(made("changed", *changes, *settings), expected)
    path = str(tmp_path / "drive.csv")
    recorded = {"trajectory": "recorded", "trajectory_options": {}, "trajectory_file": path}
    drive = ("--trajectory", "recorded", "--set", "trajectory_file=drive.csv")
    again = simulate(msgspec.structs.replace(file, **recorded), robot)
    same(made("recorded", *drive), again)


@pytest.mark.parametrize(
    ("words", "proposed"),
    [
        (("--out", "a b", "--robot", "jackal", "--duration", 20), "replay 'a b' --robot jackal"),
        (("--out", "run", "--duration", 60), "replay run --robot auriga-alpha --fixes 0:40%"),
    ],
)
def test_the_replay_that_simulate_proposes_works(words, proposed, tmp_path):
    """For another robot, and so that a long drive has something to score."""
    done = succeeds("simulate", *words, cwd=tmp_path)
    command = done.stderr.strip().splitlines()[-1].partition("; next: icreckon ")[2]
    assert command == proposed
    more = ("--variants", "gyro", "--json")
    results = json.loads(succeeds(*shlex.split(command), *more, cwd=tmp_path).stdout)
    assert results["truth"]["source"] == "friction"
    if "--fixes" in command:
        assert results["variants"]["gyro"]["drift_percent_10s_mean"] > 0.0


def test_the_list_of_commands_has_the_first_lines_of_their_help() -> None:
    for name, first in COMMANDS.items():
        assert (load(name).help or "").splitlines()[0] == first


def test_help_cuts_nothing_at_80_columns(tmp_path: Path) -> None:
    run = partial(icreckon_alone, env=os.environ | {"COLUMNS": "80"})
    simulating = succeeds("simulate", "--help", cwd=tmp_path, run=run).stdout
    assert "trajectory_options.speed=0.4" in simulating
    assert "--without-truth" in simulating
    assert "…" not in simulating
    listed = succeeds("--help", cwd=tmp_path, run=run).stdout.splitlines()
    assert [line.split(maxsplit=1)[1] for line in listed[-len(COMMANDS) :]] == [*COMMANDS.values()]


def same(log: Log, other: Log) -> None:
    """Two logs agree, but for what a bag rounds."""
    for one, two in ((log.tracks, other.tracks), (log.imu, other.imu), (log.fixes, other.fixes)):
        assert np.array_equal(one.stamps, two.stamps)
    assert np.allclose(log.tracks.speeds, other.tracks.speeds, atol=1e-9)
    assert np.allclose(log.imu.angular_velocity, other.imu.angular_velocity, atol=1e-9)
    assert np.allclose(log.fixes.poses[:, :2], other.fixes.poses[:, :2], atol=1e-9)


def test_errors_are_one_line_that_says_what_to_do(tmp_path: Path) -> None:
    robot = ("--robot", "auriga-alpha")
    assert "no such file" in fails("replay", "missing.bag", *robot, cwd=tmp_path).lower()
    into_run = ("simulate", "--out", "run")
    assert "'mcap'" in fails(*into_run, "--format", "mcab", cwd=tmp_path)
    assert "as gyro.noise_density=0.001" in fails(*into_run, "--set", "gyro", cwd=tmp_path)
    assert "as 100:300" in fails(*into_run, "--outage", "x", cwd=tmp_path)
    (tmp_path / "short.toml").write_text("outages = [[100, 200]]\n")
    words = ("--scenario", "short.toml", "--duration", 50)
    assert "command line over short.toml: an outage" in fails(*into_run, *words, cwd=tmp_path)
    assert "recorded" not in fails("demo", "--trajectory", "foo", cwd=tmp_path)
    assert "no trajectory of a demo" in fails("demo", "--trajectory", "recorded", cwd=tmp_path)
    (tmp_path / "afile").write_text("a\n")
    for words in ("simulate --out", "demo --out", "inspect run --write"):
        assert "did not write" in fails(*words.split(), "afile", "--overwrite", cwd=tmp_path)
    assert (tmp_path / "afile").read_text() == "a\n"
    assert "'auriga-alpha'" in fails(*into_run, "--robot", "auriga", cwd=tmp_path)
    words = (*into_run, "--duration", 10)
    succeeds(*words, cwd=tmp_path)
    assert "--overwrite" in fails(*words, cwd=tmp_path)
    assert "icreckon inspect run --write" in fails("replay", "run", cwd=tmp_path)
    assert "no part of a log" in fails("replay", "run", *robot, "--fixes", "x", cwd=tmp_path)
    assert not list(tmp_path.glob("icreckon-replay*")), "a failed command leaves nothing behind"


def test_debug_shows_the_traceback(tmp_path: Path) -> None:
    done = icreckon_alone("--debug", "inspect", "missing.bag", cwd=tmp_path)
    assert done.returncode != 0
    assert "Traceback" in done.stderr


def test_the_module_is_the_command() -> None:
    found = subprocess.run(
        [sys.executable, "-m", "icreckon", "--version"], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == f"icreckon {version('icreckon')}"


@pytest.mark.parametrize("words", [["--varient", "gyro"], ["-r", "/a:=/b"], ["robot.toml"]])
def test_an_unknown_argument_is_refused(words: list[str], tmp_path: Path) -> None:
    said = fails("ros2-node", *words, cwd=tmp_path)
    assert f"unknown argument {words[0]!r}" in said
    assert "--ros-args" in said


def test_a_standstill_without_a_truth_is_drawn_without_a_warning(tmp_path: Path) -> None:
    words = ("--duration", 2, "--fix-rate", 0, "--noise", "perfect", "--trajectory", "straight")
    succeeds("simulate", "--out", "run", "--without-truth", *words, cwd=tmp_path)
    words = ("--robot", "auriga-alpha", "--workers", 1)
    done = succeeds("replay", "run", *words, cwd=tmp_path, drawn=True)
    assert "Warning" not in done.stderr
    assert "No ground truth" in done.stdout
    assert results_in(tmp_path / "icreckon-replay-run")["truth"] is None
