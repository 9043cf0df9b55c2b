"""The node over real ROS 2, for tests: player, node and recorder as processes."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader

from conftest import REPOSITORY

ROBOT, VARIANT = "auriga-alpha", "inertia-online"
INPUTS = ("/joint_states", "/imu/data_raw", "/fix/pose")
OUTPUTS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/pose_in_map": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/icrs": "visualization_msgs/msg/MarkerArray",
    "/slip": "diagnostic_msgs/msg/DiagnosticArray",
    "/learnt_parameters": "diagnostic_msgs/msg/DiagnosticArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
"""Recorded topics. Subscriptions are announced in this order, and only the last one has messages before
the robot drives."""
INPUT_TYPES = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/imu/data_raw": "sensor_msgs/msg/Imu",
    "/fix/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
RATE = 1.0
LONGEST = 120.0
"""Longest time to wait for a process [s]."""


class Process(NamedTuple):
    """A running program and the file of its output."""

    popen: subprocess.Popen[str]
    log: Path

    def text(self) -> str:
        return self.log.read_text(encoding="utf-8")

    def stop(self, by: int = signal.SIGINT) -> int:
        self.popen.send_signal(by)
        return self.popen.wait(LONGEST)


@contextmanager
def started(environment: dict[str, str], log: Path, command: Sequence[object]) -> Iterator[Process]:
    with log.open("w", encoding="utf-8") as file:
        popen = subprocess.Popen(
            list(map(str, command)), env=environment, stdout=file, stderr=file, text=True
        )
        try:
            yield Process(popen, log)
        finally:
            if popen.poll() is None:
                popen.kill()
                popen.wait()


def node(environment: dict[str, str], log: Path, **parameters: object) -> Any:
    """Start the node."""
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    program = Path(sys.executable).parent / "icreckon"
    command = [program, "ros2-node", "--robot", ROBOT, "--variant", VARIANT, "--ros-args", *words]
    return started(environment, log, command)


@contextmanager
def recorded_node(
    environment: dict[str, str],
    folder: Path,
    *,
    topics: dict[str, str] = OUTPUTS,
    stop: int = signal.SIGINT,
    **parameters: object,
) -> Iterator[tuple[Process, Process]]:
    """Recorder of `folder / "out"` and a node that has found it; both end well."""
    path, program = folder / "out", REPOSITORY / "tests" / "ros2_recorder.py"
    wanted = [f"{topic}:{kind}" for topic, kind in topics.items()]
    command = [sys.executable, program, path, *wanted]
    with (
        started(environment, path.with_suffix(".log"), command) as record,
        node(environment, folder / "node.log", **parameters) as running,
    ):
        until((folder / "out.ready").exists, record)
        until(lambda: "ready:" in running.text(), running)
        if "/diagnostics" in topics:
            # Nothing that the node publishes is lost.
            until((folder / "out.hears").exists, record)
            time.sleep(0.5)
        yield record, running
        assert running.stop(stop) == 0, running.text()
        assert record.stop() == 0, record.text()


def player(bag: Path, topics: Sequence[str], *options: object) -> list[str]:
    program = REPOSITORY / "tests" / "ros2_player.py"
    return list(map(str, [sys.executable, program, bag, ",".join(topics), RATE, *options]))


def play(
    environment: dict[str, str], bag: Path, *options: object, topics: Sequence[str] = INPUTS
) -> None:
    command = player(bag, topics, *options)
    subprocess.run(command, env=environment, check=True, timeout=2 * LONGEST)


def refused(environment: dict[str, str], *words: object) -> str:
    """What a node prints that does not start."""
    command = [Path(sys.executable).parent / "icreckon", "ros2-node", *words]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=LONGEST
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    return done.stderr


def until(condition: Callable[[], bool], process: Process) -> None:
    end = time.monotonic() + LONGEST
    while not condition():
        assert process.popen.poll() is None, process.text()
        assert time.monotonic() < end, process.text()
        time.sleep(0.05)


def until_heard(record: Process, path: Path, bag: Path) -> None:
    """Wait until the odometry of each IMU sample of a bag is recorded, and what follows it."""
    with AnyReader([bag]) as reader:
        samples = reader.topics["/imu/data_raw"].msgcount
    until(lambda: odometry_heard(path) >= samples, record)
    time.sleep(2.0)


def until_quiet(record: Process, path: Path) -> None:
    """Wait until the node has worked through its queues: no odometry comes for 5 s."""
    count = -1
    while (heard := odometry_heard(path)) != count:
        assert record.popen.poll() is None, record.text()
        count = heard
        time.sleep(5.0)


def odometry_heard(path: Path) -> int:
    """Number of messages of odometry that the recorder has by now."""
    hears = path.with_suffix(".hears")
    return int(hears.read_text("utf-8") or 0) if hears.exists() else 0


def recorded(path: Path) -> dict[str, list[Any]]:
    messages: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            messages.setdefault(connection.topic, []).append(message)
    return messages


def stamp_of(header: Any) -> int:
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def pose_of(place: Any, turn: Any) -> np.ndarray:
    return np.array([place.x, place.y, 2.0 * np.arctan2(turn.z, turn.w)])
