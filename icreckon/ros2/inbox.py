"""Inbox of the node: waiting messages, sorted by their time of sending."""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from icreckon.replay.live.inputs import Subscription

LONGEST_QUEUE = 60.0  # age beyond which a middleware's time of arrival is that of another clock [s]
STALL = 1.0
"""Time without running beyond which messages may be too late to correct the estimate [s]."""
SETTLING = 1.0  # time after a stall in which the middleware brings one topic after another [s]
NO_TIMES: Mapping[str, Any] = {"source_timestamp": 0, "received_timestamp": 0}
"""Times of a message if rclpy gives callbacks none, as in Humble."""


class Received(NamedTuple):
    """Message with the times that the middleware gives."""

    subscription: Subscription  # its topic
    msgtype: str  # its type, as "sensor_msgs/msg/Imu"
    message: Any
    # `source_timestamp` and `received_timestamp`, of the sender's and this computer's clock [ns];
    # 0 where it gives none
    info: Mapping[str, Any]

    @property
    def sent(self) -> int:
        """Time of sending by the sender's clock, or of arrival [ns]; 0 for none."""
        return int(self.info["source_timestamp"] or self.info["received_timestamp"] or 0)

    def arrival(self, now: int) -> int:
        """Time of arrival [ns]: that of the middleware if plausible, else `now`.

        `now` is the present time of this computer's clock [ns].
        """
        received = int(self.info["received_timestamp"] or 0)
        is_plausible = received != 0 and 0 <= now - received <= LONGEST_QUEUE * 1e9
        return received if is_plausible else now


class Queue(NamedTuple):
    """Queue of an input in ROS."""

    subscription: Subscription  # its topic
    msgtype: str  # type of its messages
    ros: Any  # subscription of rclpy
    depth: int  # longest length

    def take_all(self) -> list[Received]:
        """Remove and return the messages that wait, at most `depth`: more may be coming."""
        taken: list[Received] = []
        with self.ros.handle:
            while len(taken) < self.depth:
                message_and_info = self.ros.handle.take_message(self.ros.msg_type, False)  # not raw
                if message_and_info is None:
                    break
                taken.append(Received(self.subscription, self.msgtype, *message_and_info))
        return taken


class Inbox:
    """Messages that wait for the node.

    An executor of ROS takes one message of each topic in turn. A node that could not run for seconds
    would have the last track speeds before most of the IMU, which then came too late to be used.

    Args:
        clock: time that never jumps [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._queues: list[Queue] = []
        self._waiting: list[Received] = []
        self._ran = self._settled = clock()

    @property
    def settling(self) -> bool:
        """True if messages are held back after a stall."""
        return self._clock() < self._settled

    def add(self, queue: Queue) -> None:
        """Add the queue of an input."""
        self._queues.append(queue)

    def put(self, message: Received) -> None:
        """Add a message that the executor took."""
        self._waiting.append(message)

    def take(self) -> list[Received]:
        """Remove and return all messages, in the order of their sending.

        Empty for a second after a stall. Call it often, also without messages, to detect stalls.
        """
        self.worked()
        for queue in self._queues:
            self._waiting += queue.take_all()
        if self.settling:
            return []
        taken, self._waiting = self._waiting, []
        return sorted(taken, key=lambda message: message.sent)

    def worked(self) -> None:
        """Record that the node runs, to detect stalls; call it after each message."""
        now = self._clock()
        if now - self._ran > STALL:
            self._settled = now + SETTLING
        self._ran = now
