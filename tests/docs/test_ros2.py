"""The pages of the ROS 2 node: commands run, and tables are those of the program."""

import json
import os
import re
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import msgspec
import pytest

from icreckon import PoseEstimator, load_robot
from icreckon.replay.live.odometry import live_topics
from icreckon.ros2.parameters import DESCRIPTIONS, NodeOptions
from readme import ROOT, are_said, blocks, code_blocks, explained_messages, literals, run_page

LIVE, NODE = "docs/tutorials/live.md", "docs/reference/ros2-node.md"
FROM_A_BAG, WITHOUT_ROS = "A robot file from a bag", "Without a ROS installation"
DOCKERFILE = ROOT / "ros2" / "Dockerfile"
OF_COMMANDS = ROOT / "Dockerfile"


def page() -> str:
    return (ROOT / NODE).read_text(encoding="utf-8")


def test_no_command_is_left_out() -> None:
    """Blocks of `sh` are run below; `bash` marks those that need ROS, docker or a robot."""
    sections = (FROM_A_BAG, WITHOUT_ROS)
    executed = chain.from_iterable(code_blocks("sh", LIVE, section) for section in sections)
    assert code_blocks("sh", LIVE) == list(executed)
    for page in (LIVE, NODE, "docs/how-to/service.md", "docs/how-to/nav2.md"):
        assert {kind for kind, _ in blocks(page)} <= {"sh", "bash", "ini", "yaml"}


@pytest.mark.slow
def test_the_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_page(LIVE, tmp_path, FROM_A_BAG)
    assert (tmp_path / "check" / "page.html").exists()
    assert live_topics(load_robot(tmp_path / "calibrated.toml")).tracks is not None
    if find_spec("rclpy") is None:
        pytest.skip("no ROS 2: pip install -e '.[ros2-test]', or source a ROS 2")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    run_page(LIVE, tmp_path, WITHOUT_ROS)
    robot = load_robot(tmp_path / "calibrated.toml")
    learnt = PoseEstimator.warm_start(tmp_path / "learnt.json", robot, off=0.0)
    assert learnt.parameters["eta0"] != robot.indices.eta0


def test_the_table_of_parameters_is_the_nodes() -> None:
    (table,) = re.findall(
        r"^\| parameter \| default \| \|\n\| --- \| --- \| --- \|\n((?:\|.*\n)+)",
        page(),
        re.MULTILINE,
    )
    rows = re.findall(r"^\| `(\w+)` \| `(.*?)` \| (.*) \|$", table, flags=re.MULTILINE)
    assert len(rows) == len(table.splitlines())
    assert rows == [
        (one.name, json.dumps(one.default), DESCRIPTIONS[one.name])
        for one in msgspec.structs.fields(NodeOptions)
    ]


def test_every_parameter_that_is_set_exists() -> None:
    names = {one.name for one in msgspec.structs.fields(NodeOptions)}
    ours = [
        name
        for one in (LIVE, NODE, "docs/how-to/service.md", "docs/how-to/nav2.md")
        for name in re.findall(r"-p ([a-z_]+):=", (ROOT / one).read_text(encoding="utf-8"))
    ]
    assert {"publish_tf", "state_file"} <= set(ours) <= names


def test_the_diagnostics_that_are_explained_are_those_that_are_sent() -> None:
    sent = literals("replay/live/statuses.py", "estimator/filter/fault_table.py")
    rows = re.findall(
        r"^\| (?:`(.+?)`.*)? \| (OK|WARN|ERROR|STALE) \| `(.+?)` \|", page(), flags=re.MULTILINE
    )
    assert {name for name, _, _ in rows if name} <= sent
    assert {message for _, _, message in rows} <= sent
    statuses = {one for one in sent if one.startswith("icreckon: ")}
    assert statuses == {name for name, _, _ in rows if name}


def test_the_messages_that_are_explained_are_those_of_the_log() -> None:
    said = literals(
        *(["icreckon/ros2/node.py", "icreckon/ros2/parameters.py", "icreckon/ros2/topics.py"]),
        "icreckon/ros2/static_frames.py",
        *("replay/live/odometry.py", "replay/reading/stream.py", "replay/live/silence.py"),
    )
    messages = explained_messages(NODE)
    assert len(messages) > 4
    assert are_said(messages, said)


def copied(dockerfile: Path = DOCKERFILE) -> dict[str, str]:
    """Places in the image of what a Dockerfile copies, by path in the repository."""
    places = {}
    for line in re.findall(r"^COPY (.*)$", dockerfile.read_text(encoding="utf-8"), re.MULTILINE):
        *sources, target = line.split()
        for source in sources:
            places[source] = target + source if target.endswith("/") else target
    return places


def test_the_image_copies_what_exists_and_starts_what_it_installs() -> None:
    text = DOCKERFILE.read_text(encoding="utf-8")
    for source, target in copied().items():
        assert (ROOT / source).exists(), source
        assert target == f"/opt/icreckon/source/{source}"
    assert "pip install --no-cache-dir /opt/icreckon/source\n" in text
    made = re.findall(r"python3 -m venv --system-site-packages (\S+)", text)
    started = re.findall(r"([\w/]+)/bin/icreckon", text)
    assert set(started) == set(made) == {"/opt/icreckon/venv"}
    assert text.index("ENV NUMBA_CACHE_DIR=") < text.index("icreckon prepare")
    assert 'icreckon", "ros2-node"]' in text


def test_the_image_of_the_commands_is_made_of_the_same_files() -> None:
    text = OF_COMMANDS.read_text(encoding="utf-8")
    assert copied(OF_COMMANDS) == copied()
    assert set(re.findall(r"([\w/]+)/bin/icreckon", text)) == {"/opt/icreckon/venv"}
    assert text.index("ENV NUMBA_CACHE_DIR=") < text.index("icreckon prepare")


@pytest.mark.slow
def test_a_wheel_can_be_built_of_what_the_image_copies(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for name in copied():
        subprocess.run(["cp", "-a", ROOT / name, source / name], check=True)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", tmp_path, source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("icreckon-*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    for name in ("ros2/node.py", "cli/main.py", "replay/live/odometry.py", "estimator/__init__.py"):
        assert f"icreckon/{name}" in names
