"""Raw messages of a bag and their channels (topics with a type)."""

from typing import NamedTuple

from rosbags.interfaces import MessageDefinition


class Channel(NamedTuple):
    """A topic with its message type."""

    topic: str  # name
    msgtype: str  # message type, as ROS 2 writes it: `sensor_msgs/msg/Imu`
    definition: MessageDefinition  # the type's definition in the bag, perhaps none
    encoding: str  # "cdr" (ROS 2), "ros1", or an unsupported one


class Record(NamedTuple):
    """A raw message of a bag."""

    channel: Channel
    time: int  # time of recording [ns]
    data: bytes  # the message, in the channel's encoding


LATEST = 2**62  # later times of recording are damage: their differences overflow int64 [ns]


def ros2_type_name(name: str) -> str:
    """Convert `sensor_msgs/Imu` to `sensor_msgs/msg/Imu`; other names are unchanged."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name
