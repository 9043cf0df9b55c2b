"""Bags that are larger than the memory: images are passed over, and measurements made as needed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from bag_messages import STORE, T, header
from icreckon import ImuSeries, Log, Robot, TrackSpeedSeries, write_log

START = 1_700_000_000_000_000_000
IMAGE_BYTES = 1_000_000
PEAK = "print([line for line in open('/proc/self/status') if 'VmHWM' in line][0].split()[1])"

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="the peak of memory is read from Linux's /proc"
)


def slalom(seconds: float) -> Log:
    def drive(rate: float):
        at = np.arange(0.0, seconds, 1.0 / rate)
        return START + np.round(at * 1e9).astype(np.int64), 0.3 * np.sin(0.3 * at)

    tracks, turn = drive(50.0)
    imu, rate = drive(250.0)
    return Log(
        "slalom",
        TrackSpeedSeries(tracks, np.column_stack([0.4 - 0.3 * turn, 0.4 + 0.3 * turn])),
        ImuSeries(
            imu,
            np.column_stack([0.0 * rate, 0.0 * rate, rate]),
            np.column_stack([0.0 * rate, 0.4 * rate, np.full_like(rate, 9.81)]),
        ),
    )


def large_bag(
    folder: Path, robot: Robot, seconds: float, images: int, plugin: StoragePlugin
) -> Path:
    """A bag of a slalom with images between its messages."""
    small = write_log(slalom(seconds), folder / "small", "mcap", robot)
    path = folder / "large"
    kind = "sensor_msgs/msg/Image"
    pixels = np.random.default_rng(1).integers(0, 256, IMAGE_BYTES, dtype=np.uint8)
    written = 0
    with Reader(small) as log, Writer(path, version=9, storage_plugin=plugin) as bag:
        camera = bag.add_connection("/camera", kind, typestore=STORE)
        copies = {
            one.id: bag.add_connection(one.topic, one.msgtype, typestore=STORE)
            for one in log.connections
        }
        for connection, stamp, data in log.messages():
            bag.write(copies[connection.id], stamp, data)
            while written < images * (stamp - START) * 1e-9 / seconds:
                image = T[kind](
                    header(stamp), 1000, 1000, "mono8", 0, 1000, np.roll(pixels, written)
                )
                bag.write(camera, stamp, STORE.serialize_cdr(image, kind))
                written += 1
    return path


def peak_megabytes(script: str, folder: Path, *words: object) -> float:
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{script}\n{PEAK}", *map(str, words)],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
    )
    return float(done.stdout.split()[-1]) * 1024.0 / 1e6


READ = """
from icreckon import load_robot, read_log
log = read_log(sys.argv[1], load_robot("auriga-alpha"))
assert len(log.imu.stamps) == int(sys.argv[2])
"""


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_images_are_not_kept(tmp_path: Path, robot: Robot, plugin: StoragePlugin) -> None:
    path = large_bag(tmp_path, robot, 10.0, 300, plugin)
    # 300 MB of images; the imports alone take about 115 MB.
    assert peak_megabytes(READ, tmp_path, path, 2500) < 200.0
