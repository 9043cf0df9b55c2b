"""Record topics of ROS 2 as a bag, until interrupted.

    python ros2_recorder.py BAG TOPIC:TYPE TOPIC:TYPE ...

Times of recording are those of arrival. A file BAG.ready appears when it listens, and a file BAG.hears
with the first message: a publisher that announced all its topics before has found this recorder. In it is
the number of messages of the first topic. It ends without a shutdown of ROS, which hung once.
"""

import os
import signal
import sys
import threading
import time
from functools import partial
from importlib import import_module
from pathlib import Path

import rclpy
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore


def main() -> None:
    """Record until SIGINT or SIGTERM."""
    bag, wanted = Path(sys.argv[1]), [one.split(":") for one in sys.argv[2:]]
    store = get_typestore(Stores.ROS2_HUMBLE)
    arrived: list[tuple[str, int, bytes]] = []
    stopped = threading.Event()
    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, lambda *_: stopped.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("recorder")

    def take(topic: str, raw: bytes) -> None:
        arrived.append((topic, time.time_ns(), raw))

    for topic, kind in wanted:
        package, _, name = kind.split("/")
        message = getattr(import_module(f"{package}.msg"), name)
        node.create_subscription(
            message, topic, partial(take, topic), QoSProfile(depth=100_000), raw=True
        )
    bag.with_suffix(".ready").touch()
    told, next_time = 0, 0.0
    while not stopped.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
        if len(arrived) > told and time.monotonic() > next_time:
            told, next_time = len(arrived), time.monotonic() + 0.1
            count = sum(topic == wanted[0][0] for topic, _, _ in arrived)
            bag.with_suffix(".hears").write_text(f"{count}\n", encoding="utf-8")
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in wanted
        }
        for topic, when, raw in arrived:
            writer.write(connections[topic], when, raw)
    os._exit(0)


if __name__ == "__main__":
    main()
