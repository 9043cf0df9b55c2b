"""Reading a long log: the time against rosbags' own decoding, and the memory.

A drive of many minutes is written as a bag, with camera images beside it if asked for. Then are told:
the time that rosbags needs to go through the messages of track speeds and IMU and to decode them, the
time that icreckon needs to read them as a log, and that of `compare` with the five variants of the index
models; each the shortest of several, in turn. Five variants are compiled once in the life of an
installation, before anything is timed. Then the most memory that a process of its own takes for reading
the log, and for reading and filtering it (Linux). `--streaming` also times the streaming filter, one
variant after the other.

    python benchmarks/reading.py --minutes 30
    python benchmarks/reading.py --minutes 10 --gigabytes 4
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _study import table
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.streaming.run import run
from icreckon.replay.comparison.compare import MANY_SAMPLES, compare
from icreckon.replay.export.log_bag import write_log
from icreckon.replay.reading.read_log import read_log

ROBOT = "auriga-alpha"
VARIANTS = (
    "differential",
    "constant-fixed",
    "constant-online",
    "inertia-fixed",
    "inertia-online",
)
START = 1_700_000_000_000_000_000
TRACK_RATE = 50.0
IMAGE_BYTES = 1_000_000
PEAK = "print([line for line in open('/proc/self/status') if 'VmHWM' in line][0].split()[1])"


def long_log(seconds: float, imu_rate: float, robot: Robot, seed: int = 1) -> Log:
    """A slalom of any length; its numbers are of no interest but for their number."""
    rng = np.random.default_rng(seed)

    def drive(rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = np.arange(0.0, seconds, 1.0 / rate)
        stamps = START + np.round(at / NANOSECOND).astype(np.int64)
        return stamps, np.full_like(at, 0.4), 0.3 * np.sin(0.3 * at)

    tracks, v, w = drive(TRACK_RATE)
    half = 0.5 * robot.constant_indices.eta0 * robot.vehicle.track_gauge * w
    speeds = np.column_stack([v - half, v + half])
    stamps, v, w = drive(imu_rate)
    rates = np.column_stack([0.0 * w, 0.0 * w, w]) + rng.normal(0.0, 1e-3, (len(w), 3))
    forces = np.column_stack([0.0 * w, v * w, np.full_like(w, 9.81)])
    forces += rng.normal(0.0, 0.02, forces.shape)
    return Log("long", TrackSpeedSeries(tracks, speeds), ImuSeries(stamps, rates, forces))


def write_with_images(source: Path, path: Path, seconds: float, gigabytes: float) -> None:
    """A copy of a bag with images between its messages, so many that it is as large as asked for."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    kind = "sensor_msgs/msg/Image"
    count = max(1, round(gigabytes * 1e9 / IMAGE_BYTES))
    pixels = np.random.default_rng(1).integers(0, 256, IMAGE_BYTES, dtype=np.uint8)
    written = 0
    with Reader(source) as log, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        camera = bag.add_connection("/camera/image_raw", kind, typestore=store)
        copies = {
            one.id: bag.add_connection(one.topic, one.msgtype, typestore=store)
            for one in log.connections
        }
        for connection, stamp, data in log.messages():
            bag.write(copies[connection.id], stamp, data)
            while written < count * (stamp - START) * NANOSECOND / seconds:
                moment = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
                header = types["std_msgs/msg/Header"](moment, "camera")
                roll = np.roll(pixels, written)
                image = types[kind](header, 1000, 1000, "mono8", 0, 1000, roll)
                bag.write(camera, stamp, store.serialize_cdr(image, kind))
                written += 1


def decoding_time(path: Path) -> tuple[float, int]:
    """Seconds that rosbags needs to decode all messages of tracks and IMU, and how many they are."""
    begin, count = time.perf_counter(), 0
    with AnyReader([path]) as reader:
        wanted = [one for one in reader.connections if "image" not in one.topic]
        for connection, _, data in reader.messages(wanted):
            reader.deserialize(data, connection.msgtype)
            count += 1
    return time.perf_counter() - begin, count


def peak_megabytes(script: str, *words: str) -> float:
    """The most memory that a process takes that runs a script with these arguments [MB]."""
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{script}\n{PEAK}", *words],
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout.split()[-1]) * 1024.0 / 1e6


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--imu-rate", type=float, default=250.0)
    parser.add_argument("--format", default="mcap", choices=["mcap", "sqlite3", "ros1"])
    parser.add_argument("--gigabytes", type=float, default=0.0)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--streaming", action="store_true")
    arguments = parser.parse_args()
    if arguments.gigabytes and arguments.format == "ros1":
        parser.error("--gigabytes is for ROS 2 bags")
    robot, seconds = load_robot(ROBOT), 60.0 * arguments.minutes
    with tempfile.TemporaryDirectory() as folder:
        log = long_log(seconds, arguments.imu_rate, robot)
        path = write_log(log, Path(folder) / "bag", arguments.format, robot)
        compare(long_log(MANY_SAMPLES / 250.0, 250.0, robot), robot, VARIANTS)
        count, names = 0, ("rosbags decodes", "icreckon reads", "five variants")
        shortest = dict.fromkeys(names, np.inf)
        for _ in range(arguments.repeat):
            decoding, count = decoding_time(path)
            begin = time.perf_counter()
            log = read_log(path, robot)
            reading = time.perf_counter() - begin
            begin = time.perf_counter()
            compare(log, robot, VARIANTS)
            comparing = time.perf_counter() - begin
            for name, spent in zip(names, (decoding, reading, comparing), strict=True):
                shortest[name] = min(shortest[name], spent)
        decoding, reading, comparing = shortest.values()
        total = "reading and five variants"
        shortest[total] = reading + comparing
        if arguments.streaming:
            for variant in VARIANTS:
                begin = time.perf_counter()
                run(log, robot, variant)
                shortest[f"`{variant}`, streaming"] = time.perf_counter() - begin
        rows = [
            [name, f"{spent:.1f}", f"{spent / decoding:.2f}"] for name, spent in shortest.items()
        ]
        print(f"{count} messages, {arguments.minutes:g} min\n")
        table(["what", "s", "of rosbags' time"], rows)
        del log
        large = path
        if arguments.gigabytes:
            large = Path(folder) / "large"
            write_with_images(path, large, seconds, arguments.gigabytes)
        imports = "from icreckon import compare, load_robot, read_log"
        read = f"{imports}\nrobot = load_robot('{ROBOT}')\nlog = read_log(sys.argv[1:], robot)"
        compared = f"{read}\nfound = compare(log, robot, {VARIANTS!r})"
        print(f"\nimports alone: {peak_megabytes(imports):.0f} MB")
        print(f"reading: {peak_megabytes(read, str(large)):.0f} MB")
        print(f"reading and five variants: {peak_megabytes(compared, str(large)):.0f} MB")


if __name__ == "__main__":
    main()
