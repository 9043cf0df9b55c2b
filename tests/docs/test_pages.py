"""The pages for newcomers: their commands run, print what the pages show, and say what they explain."""

import json
import shutil
from itertools import chain
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from bag_messages import SECOND, imu, write_bag
from command_line import icreckon
from conftest import sample_log
from readme import ROOT, are_said, blocks, code_blocks, explained_messages, literals, run_page
from tum import read_tum

FIRST = "docs/tutorials/first-bag.md"
OTHER = "docs/how-to/from-robot-localization.md"
CHECK = "docs/how-to/check.md"
REAL, SIMULATED = "A log of a real robot", "A log with a ground truth"
BOTH = "The same bag in both"
PACKAGES = ("estimator", "replay", "icreckon")


@pytest.fixture
def with_husky(tmp_path: Path, data_dir: Path) -> Path:
    """A folder with the bag that the pages have downloaded."""
    shutil.copy(sample_log(data_dir, "husky_test1.bag"), tmp_path / "test1.bag")
    return tmp_path


def test_no_command_is_left_out() -> None:
    """All commands of the pages are in the sections that the tests below run."""
    for page, sections in ((FIRST, (REAL, SIMULATED)), (OTHER, (BOTH,))):
        executed = chain.from_iterable(code_blocks("sh", page, section) for section in sections)
        assert code_blocks("sh", page) == list(executed)
        assert {kind for kind, _ in blocks(page)} <= {"sh", "text"}


@pytest.mark.slow
def test_a_real_log(with_husky: Path) -> None:
    run_page(FIRST, with_husky, REAL)
    assert (with_husky / "with-gps" / "page.html").exists()


@pytest.mark.slow
def test_a_simulated_log(evo: Path, tmp_path: Path) -> None:
    run_page(FIRST, tmp_path, SIMULATED, programs=evo)
    results = json.loads((tmp_path / "first" / "results.json").read_text(encoding="utf-8"))
    verdict = results["verdict"]
    assert {"inertia-online", "constant-online"} <= {verdict["best"], *verdict["not_shown_worse"]}
    for name in ("page.html", "odometry.mcap", "odometry.bag", "inertia-online.tum"):
        assert (tmp_path / "exported" / name).exists()


@pytest.mark.slow
def test_a_robot_file_with_errors(tmp_path: Path) -> None:
    run_page(CHECK, tmp_path, "An example")
    run_page(CHECK, tmp_path, "Settings for ROS")


@pytest.mark.slow
def test_the_same_bag_in_both(with_husky: Path, evo: Path) -> None:
    """With a bag for what robot_localization would have published: icreckon's own odometry."""

    def record(command: str) -> None:
        if "evo_traj bag2 rl" in command:
            copied(
                with_husky / "alone" / "odometry.mcap", "/inertia_online/odom", with_husky / "rl"
            )

    run_page(OTHER, with_husky, BOTH, programs=evo, before=record)
    assert (with_husky / "test1" / "metadata.yaml").exists()
    published, own = (
        read_tum(with_husky / name) for name in ("rl.tum", "alone/inertia-online.tum")
    )
    assert len(published.stamps) == len(own.stamps)


def copied(source: Path, topic: str, folder: Path) -> None:
    """A ROS 2 bag of one topic of an MCAP file, as /odometry/filtered."""
    with (
        AnyReader([source]) as reader,
        Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        (connection,) = (one for one in reader.connections if one.topic == topic)
        target = writer.add_connection(
            "/odometry/filtered", connection.msgtype, typestore=reader.typestore
        )
        for _, stamp, raw in reader.messages(connections=[connection]):
            writer.write(target, stamp, raw)


def test_a_log_without_track_speeds_is_told_so(tmp_path: Path) -> None:
    write_bag(tmp_path / "bare", [("/imu/data_raw", imu(k * SECOND // 100)) for k in range(1, 200)])
    found = icreckon("inspect", "bare", "--write", "robot.toml", cwd=tmp_path)
    assert "Found: no track speeds: nothing here looks like them" in found.stdout
    assert "without them nothing can be replayed" in found.stderr
    assert "then: icreckon replay" not in found.stderr
    assert "imu: header stamps; header and recording times agree" in found.stdout
    assert "-0.000" not in found.stdout
    assert "track acceleration" not in (tmp_path / "robot.toml").read_text(encoding="utf-8")


def test_the_messages_that_are_explained_are_those_that_are_said() -> None:
    sources = [file for one in PACKAGES for file in (ROOT / one).rglob("*.py")]
    said = literals(*(str(file.relative_to(ROOT)) for file in sources))
    assert are_said(explained_messages(FIRST), said)
