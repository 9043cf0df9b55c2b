"""Discovery of the input topics: message type and QoS of their publishers."""

from functools import cache
from importlib import import_module
from typing import Any

from icreckon.replay.base.errors import ReplayError
from icreckon.replay.live.inputs import Subscription
from icreckon.replay.reading.stream import unreadable
from icreckon.ros2.parameters import QOS_POLICIES


def find_topic(node: Any, subscription: Subscription) -> tuple[str, str] | None:
    """Find a topic in the ROS graph.

    Returns:
        Its first supported type, and "reliable" if all supported publishers are, else "best_effort"; None
        without any.

    Raises:
        ReplayError: none of its types is supported for this stream.
    """
    from rclpy.qos import ReliabilityPolicy

    publishers = node.get_publishers_info_by_topic(node.resolve_topic_name(subscription.topic))
    if not publishers:
        return None
    supported = [
        publisher
        for publisher in publishers
        if not subscription.types or publisher.topic_type in subscription.types
    ]
    if not supported:
        types = sorted({publisher.topic_type for publisher in publishers})
        purpose, readable = subscription.purpose, subscription.types
        raise ReplayError(unreadable(subscription.topic, types, purpose, readable))
    reliabilities = {publisher.qos_profile.reliability for publisher in supported}
    are_reliable = reliabilities == {ReliabilityPolicy.RELIABLE}
    return supported[0].topic_type, "reliable" if are_reliable else "best_effort"


@cache
def message_class(msgtype: str) -> Any:
    """Class of a message type, as "sensor_msgs/msg/Imu".

    Raises:
        ReplayError: its package is not installed.
    """
    package, _, name = msgtype.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as problem:
        raise ReplayError(
            f"messages of type {msgtype} cannot be read: install and source the ROS package {package} "
            f"({problem})"
        ) from None


def overridable() -> Any:
    """Policies of a topic that the node's parameters can override."""
    from rclpy.qos import QoSPolicyKind
    from rclpy.qos_overriding_options import QoSOverridingOptions

    return QoSOverridingOptions([QoSPolicyKind[policy.upper()] for policy in QOS_POLICIES])


def input_qos(subscription: Subscription, depth: int, reliability: str) -> Any:
    """QoS profile of an input, "reliable" or "best_effort"."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    durability = "TRANSIENT_LOCAL" if subscription.latched else "VOLATILE"
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy[reliability.upper()],
        durability=DurabilityPolicy[durability],
    )
