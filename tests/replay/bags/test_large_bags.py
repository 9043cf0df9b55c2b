"""Bags that are larger than the memory: images are passed over, and measurements made as needed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from bag_messages import STORE, T, header
from conftest import make_log
from icreckon import Robot, write_log

START = 1_700_000_000_000_000_000
IMAGE_BYTES = 1_000_000
PEAK = "print([line for line in open('/proc/self/status') if 'VmHWM' in line][0].split()[1])"

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="the peak of memory is read from Linux's /proc"
)


def large_bag(folder: Path, robot: Robot, images: int, plugin: StoragePlugin) -> Path:
    """A bag of a log of 10 s, with images before its messages."""
    small = write_log(make_log(10.0, start=START), folder / "small", "mcap", robot)
    path = folder / "large"
    kind = "sensor_msgs/msg/Image"
    pixels = np.random.default_rng(1).integers(0, 256, IMAGE_BYTES, dtype=np.uint8)
    with Reader(small) as log, Writer(path, version=9, storage_plugin=plugin) as bag:
        camera = bag.add_connection("/camera", kind, typestore=STORE)
        for k in range(images):
            image = T[kind](header(START), 1000, 1000, "mono8", 0, 1000, np.roll(pixels, k))
            bag.write(camera, START, STORE.serialize_cdr(image, kind))
        for one in log.connections:
            copy = bag.add_connection(one.topic, one.msgtype, typestore=STORE)
            for _, stamp, data in log.messages([one]):
                bag.write(copy, stamp, data)
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
    path = large_bag(tmp_path, robot, 150, plugin)
    # 150 MB of images; the imports alone take about 115 MB.
    assert peak_megabytes(READ, tmp_path, path, 1000) < 200.0
