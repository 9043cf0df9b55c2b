"""Damaged robot, scenario and study files, recordings, definitions, saved estimators and studies."""

import json
import warnings
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import msgspec
import numpy as np
import pytest

from bag_messages import DEFINITION, definition_files
from icreckon.estimator.base.errors import IcreckonError
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.save import read_saved
from icreckon.replay.bags.decoding import read_definitions
from icreckon.replay.mapping.topics import topic_map
from icreckon.simulation.drives.recorded import read_recording
from icreckon.simulation.running.manifest import as_json
from icreckon.simulation.running.store import Job, open_store
from icreckon.simulation.scenario import Scenario, load_scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import STUDIES_FOLDER, load_study
from mutations import mutated

ALPHA = load_robot("auriga-alpha")
COPIES = 200
SCENARIO = """
trajectory = "slalom"
trajectory_options = { highest = 0.2, speed = 0.4 }
duration = 30.0
outages = [[5.0, 10.0]]
payloads = [{ time = [1.0, 2.0], mass = 5.0 }]
patches = [{ friction = 0.5, x = [0.0, 1.0] }]
[terrain]
rolling_deg = 1.0
[gyro]
bias_sigma = 0.001
"""


def robot_file(path: Path) -> None:
    topic_map(load_robot(path), "robot")


def study_file(path: Path) -> None:
    expand(load_study(path))


def definitions(path: Path) -> None:
    read_definitions([path])


def shipped(folder: Path, name: str) -> bytes:
    return (folder / name).read_bytes()


RECORDING = "\n".join(["t,left,right", *(f"{0.1 * k:.1f},{0.01 * k},0.2" for k in range(50))])
READERS: dict[str, tuple[str, Callable[[Path], object], bytes]] = {
    "robot": ("robot.toml", robot_file, shipped(ROBOTS_FOLDER, "husky.toml")),
    "scenario": ("scenario.toml", load_scenario, SCENARIO.encode()),
    "study": ("study.toml", study_file, shipped(STUDIES_FOLDER, "slopes.toml")),
    "recording": ("drive.csv", read_recording, RECORDING.encode()),
    "definition": ("our_msgs/msg/Drive.msg", definitions, DEFINITION.encode()),
}


def check(read: Callable[[], object]) -> bool:
    """Read a file; return False if it is refused in one line."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read()
    except IcreckonError as problem:
        assert "\n" not in str(problem)  # noqa: PT017 - either outcome will do
        assert len(str(problem)) < 2000  # noqa: PT017
        return False
    return True


@pytest.mark.parametrize("kind", READERS)
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    name, read, data = READERS[kind]
    definition_files(tmp_path)
    path = tmp_path / name
    outcomes = set()
    deep = b"a = " + b"[" * 100_000
    odd = [data, deep] if name.endswith(".toml") else [data]
    for hurt in [*odd, *mutated(data, seed=17, count=COPIES)]:
        path.write_bytes(hurt)
        outcomes.add(check(lambda: read(path)))
    assert outcomes == {True, False}


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    estimator = PoseEstimator(ALPHA)
    for measurement in simulate(
        Scenario(duration=6.0, seed=2, imu_rate=20.0), ALPHA
    ).measurements():
        estimator.feed(measurement)
    path = tmp_path_factory.mktemp("saved") / "saved.json"
    estimator.save(path)
    return path.read_bytes()


def test_damaged_estimators_are_refused(tmp_path: Path, saved: bytes) -> None:
    path = tmp_path / "saved.json"
    for hurt in [b"[" * 100_000, *mutated(saved, seed=17, count=COPIES)]:
        path.write_bytes(hurt)
        check(lambda: PoseEstimator.restore(path, ALPHA))


def test_changed_estimators_are_refused(tmp_path: Path, saved: bytes) -> None:
    """The checksum fits, the content may not."""
    path = tmp_path / "saved.json"
    content = json.dumps(json.loads(saved)["content"]).encode()
    document = json.loads(saved)
    tried = 0
    for hurt in mutated(content, seed=18, count=4 * COPIES):
        try:
            document["content"] = msgspec.json.decode(hurt)
        except (msgspec.DecodeError, UnicodeDecodeError):
            continue
        document["checksum"] = checksum(document["content"])
        path.write_bytes(msgspec.json.encode(document))
        check(lambda: read_saved(path))
        check(lambda: PoseEstimator.restore(path, ALPHA))
        tried += 1
    assert tried > 20


def checksum(content: object) -> str:
    return sha256(msgspec.json.encode(content)).hexdigest()


def test_damaged_blocks_and_manifests_of_a_study(tmp_path: Path) -> None:
    folder, job = tmp_path / "study", Job(0, 0, 3)
    manifest = {"digest": "d", "name": "s", "configuration": {"runs": 3, "x": [1.0, 2.0]}}
    store = open_store(folder, manifest, (2, 4), overwrite=False)
    store.write(job, np.ones((2, 3, 4)), np.array([["", "", "x"]] * 2))
    whole, block = store.path(job).read_bytes(), store.path(job)
    for hurt in mutated(whole, seed=17, count=COPIES):
        block.write_bytes(hurt)
        found = store.read(job)
        assert found is None or found[0].shape == (2, 3, 4)
    block.write_bytes(whole)
    text = as_json(manifest).encode()
    for hurt in [b"[" * 100_000, *mutated(text, seed=17, count=COPIES)]:
        (folder / "manifest.json").write_bytes(hurt)
        check(lambda: open_store(folder, manifest, (2, 4), overwrite=False))
