"""Raw messages of a bag, and what channels (topics with a type) carry them."""

from __future__ import annotations

from typing import NamedTuple

from rosbags.interfaces import MessageDefinition


class Channel(NamedTuple):
    """A topic with its message type.

    Attributes:
        topic: name.
        msgtype: message type, as ROS 2 writes it: `sensor_msgs/msg/Imu`.
        definition: the type's definition as the bag holds it, perhaps none.
        encoding: "cdr" (ROS 2), "ros1", or another that is not known here.
    """

    topic: str
    msgtype: str
    definition: MessageDefinition
    encoding: str


class Record(NamedTuple):
    """A message as it lies in a bag: its channel, the time of recording [ns] and its bytes."""

    channel: Channel
    time: int
    data: bytes


LATEST = 2**63
"""Times of recording from here on are damage: they do not fit the int64 nanoseconds used inside."""


def ros2_type_name(name: str) -> str:
    """`sensor_msgs/Imu` as ROS 2 writes it, `sensor_msgs/msg/Imu`; other names as they are."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name
