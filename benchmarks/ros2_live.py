"""The ROS 2 node live: start, latency from input to output, share of a core, messages lost.

    python benchmarks/ros2_live.py

It needs a ROS 2 (`pip install -e '.[test,ros2-test]'`). A bag of 30 s is simulated for each IMU rate and
played in real time by one process; the node and a recorder are two more. The latency is the time from the
sending of an IMU sample to the arrival of the odometry of its stamp at the recorder, so it holds the way
of both messages through the middleware. The cold start is that of an empty cache of compiled code.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

TESTS = Path(__file__).parent.parent / "tests"
ICRECKON = Path(sys.executable).parent / "icreckon"
INPUTS = "/joint_states,/imu/data_raw"
SECONDS = 30
RATES = (100, 400)
LONGEST = 300.0
"""Longest time to wait for a start [s]."""


def environment(folder: Path) -> dict[str, str]:
    """Environment of all processes."""
    given = os.environ | {
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(folder / "log"),
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONUNBUFFERED": "1",
    }
    if importlib.util.find_spec("tf2_msgs") is None:
        builder = [sys.executable, TESTS / "ros2_tf2_msgs.py", folder / "built"]
        subprocess.run(builder, env=given, check=True, capture_output=True)
        given["PYTHONPATH"] = os.pathsep.join(
            [str(folder / "built"), os.environ.get("PYTHONPATH", "")]
        )
    return given


def start(given: dict[str, str], log: Path) -> tuple[subprocess.Popen[bytes], float]:
    """Start the node; return it with the time until it was ready [s]."""
    begun = time.monotonic()
    with log.open("wb") as file:
        node = subprocess.Popen(
            [ICRECKON, "ros2-node", "--robot", "auriga-alpha", "--ros-args", "-p", "use_fixes:=false"],
            env=given, stdout=file, stderr=file,
        )  # fmt: skip
    while b"ready:" not in log.read_bytes():
        if node.poll() is not None or time.monotonic() - begun > LONGEST:
            raise SystemExit(log.read_text(encoding="utf-8"))
        time.sleep(0.02)
    return node, time.monotonic() - begun


def processor_time(pid: int) -> float:
    """Processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def drive(given: dict[str, str], folder: Path, rate: int, what: str) -> str:
    """Play a drive to a new node; return a row of the table."""
    bag, recorded = folder / f"drive-{rate}", folder / f"out-{rate}-{what}"
    if not bag.exists():
        simulate = [ICRECKON, "simulate", "--out", bag, "--duration", SECONDS, "--seed", 1]
        simulate += ["--set", f"imu_rate={rate}"]
        subprocess.run(list(map(str, simulate)), check=True, capture_output=True)
    node, ready = start(given, folder / f"node-{rate}-{what}.log")
    recorder = subprocess.Popen(
        [sys.executable, TESTS / "ros2_recorder.py", recorded, "/odom:nav_msgs/msg/Odometry"],
        env=given, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    while not recorded.with_suffix(".ready").exists():
        time.sleep(0.05)
    time.sleep(1.0)
    before, begun = processor_time(node.pid), time.monotonic()
    sent = folder / "sent"
    player = [sys.executable, TESTS / "ros2_player.py", bag, INPUTS, "1.0", "--sent", sent]
    subprocess.run(list(map(str, player)), env=given, check=True)
    share = (processor_time(node.pid) - before) / (time.monotonic() - begun)
    for process in (node, recorder):
        process.send_signal(signal.SIGINT)
        process.wait(60)
    left = {}
    for line in sent.read_text(encoding="utf-8").splitlines():
        stamp, now = map(int, line.split())
        left[stamp] = now
    waits = []
    with AnyReader([recorded]) as reader:
        for connection, when, raw in reader.messages():
            stamp = reader.deserialize(raw, connection.msgtype).header.stamp
            waits.append((when - left[stamp.sec * 10**9 + stamp.nanosec]) * 1e-6)
    of_imu = SECONDS * rate + 1
    median, high, highest = np.percentile(waits, [50.0, 99.0, 100.0])
    return (
        f"{rate} Hz, {what} | {ready:.1f} | {of_imu} | {len(waits)} | {median:.2f} | {high:.2f} | "
        f"{highest:.1f} | {100.0 * share:.0f}"
    )


def main() -> None:
    """Print the table."""
    print(
        "IMU | start to ready [s] | IMU samples | odometry | latency: median [ms] | 99 % [ms] | "
        "highest [ms] | share of a core [%]"
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        given = environment(folder)
        print(drive(given, folder, RATES[0], "cold"), flush=True)
        for rate in RATES:
            print(drive(given, folder, rate, "warm"), flush=True)


if __name__ == "__main__":
    main()
