"""Play the messages of a bag over ROS 2, at their recorded times.

    python ros2_player.py BAG TOPIC,TOPIC,... RATE [--subscribers N] [--clock] [--loops N] [--sent FILE]

It begins when each topic has N subscribers. With --clock it publishes /clock, too, and each loop sets it
back. FILE gets a line for each message: its recorded time and the time of sending [ns].
"""

import argparse
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import QoSProfile
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock


def main() -> None:
    """Play the bag."""
    parser = argparse.ArgumentParser()
    parser.add_argument("bag", type=Path)
    parser.add_argument("topics")
    parser.add_argument("rate", type=float)
    parser.add_argument("--subscribers", type=int, default=1)
    parser.add_argument("--clock", action="store_true")
    parser.add_argument("--loops", type=int, default=1)
    parser.add_argument("--sent", type=Path)
    given = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node("player")
    clock = node.create_publisher(Clock, "/clock", 10) if given.clock else None
    with AnyReader([given.bag]) as reader:
        wanted = [one for one in reader.connections if one.topic in given.topics.split(",")]
        messages = [(one, when, raw) for one, when, raw in reader.messages(wanted)]
    publishers: dict[str, Any] = {}
    for connection in wanted:
        package, _, name = connection.msgtype.split("/")
        kind = getattr(import_module(f"{package}.msg"), name)
        publishers[connection.topic] = node.create_publisher(
            kind, connection.topic, QoSProfile(depth=len(messages))
        )
    while min(one.get_subscription_count() for one in publishers.values()) < given.subscribers:
        if clock is not None:
            _set_clock(clock, messages[0][1])
        time.sleep(0.05)
    time.sleep(0.5)
    sent = []
    for _ in range(given.loops):
        first, begun = messages[0][1], time.monotonic()
        for connection, when, raw in messages:
            wait = (when - first) * 1e-9 / given.rate - (time.monotonic() - begun)
            if wait > 0.0:
                time.sleep(wait)
            if clock is not None:
                _set_clock(clock, when)
            sent.append((when, time.time_ns()))
            publishers[connection.topic].publish(bytes(raw))
    if given.sent is not None:
        given.sent.write_text("".join(f"{when} {now}\n" for when, now in sent), encoding="utf-8")
    for publisher in publishers.values():
        publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=20.0))
    time.sleep(1.0)
    rclpy.try_shutdown()


def _set_clock(clock: Any, when: int) -> None:
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(when, 10**9)
    clock.publish(message)


if __name__ == "__main__":
    main()
