"""The node's inbox, with queues of ROS that are imitated."""

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from icreckon.replay.live.inputs import Subscription
from icreckon.ros2.inbox import Inbox, Queue, Received

SECOND = 1_000_000_000
IMU, TRACKS = Subscription("imu", "/imu", ()), Subscription("tracks", "/joint_states", ())


class Handle(nullcontext[None]):
    """Handle of a subscription of rclpy: its queue of messages."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[tuple[Any, dict[str, int]]] = []

    def take_message(self, kind: str, raw: bool) -> tuple[Any, dict[str, int]] | None:
        assert (kind, raw) == ("a type", False)
        return self.messages.pop(0) if self.messages else None

    def send(self, *times: int) -> None:
        """Put messages into the queue that arrive 1 ms after they were sent."""
        for sent in times:
            info = {"source_timestamp": sent, "received_timestamp": sent + SECOND // 1000}
            self.messages.append((sent, info))


class Drive:
    """Inbox with queues of IMU and tracks, and a clock that the test sets."""

    def __init__(self, depth: int = 100) -> None:
        self.now = 100.0
        self.inbox = Inbox(lambda: self.now)
        self.imu, self.tracks = Handle(), Handle()
        for topic, handle in ((IMU, self.imu), (TRACKS, self.tracks)):
            ros = SimpleNamespace(msg_type="a type", handle=handle)
            self.inbox.add(Queue(topic, "a message", ros, depth))

    def take(self) -> list[int]:
        return [received.message for received in self.inbox.take()]


def test_all_that_waits_comes_in_the_order_of_sending() -> None:
    drive = Drive()
    drive.imu.send(20, 30, 40, 50)
    drive.tracks.send(25, 45)
    info = {"source_timestamp": 10, "received_timestamp": 11}
    drive.inbox.put(Received(IMU, "Imu", 10, info))
    taken = drive.inbox.take()
    assert [received.message for received in taken] == [10, 20, 25, 30, 40, 45, 50]
    assert taken[2].subscription.purpose == "tracks"
    assert not drive.inbox.settling
    assert drive.take() == []


def test_a_queue_that_fills_as_fast_as_it_is_emptied_ends() -> None:
    drive = Drive(depth=3)
    drive.imu.send(*range(1, 8))
    assert [drive.take(), drive.take()] == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize("works", [False, True], ids=["between messages", "in a message"])
def test_after_a_stall_it_waits_for_what_comes_late(works: bool) -> None:
    drive = Drive()
    assert drive.take() == []
    drive.now += 3.0
    if works:
        drive.inbox.worked()
    drive.imu.send(10, 20, 30)
    assert drive.take() == []
    assert drive.inbox.settling
    drive.now += 0.4
    drive.tracks.send(15, 25)
    assert drive.take() == []
    drive.now += 0.7
    assert drive.take() == [10, 15, 20, 25, 30]


def test_long_work_on_many_messages_is_no_stall() -> None:
    drive = Drive()
    for _ in range(30):
        drive.now += 0.1
        drive.inbox.worked()
    drive.imu.send(20)
    assert drive.take() == [20]


@pytest.mark.parametrize(
    ("source", "received", "sent"), [(5, 7, 5), (0, 7, 7), (None, 7, 7), (0, 0, 0), (None, None, 0)]
)
def test_without_times_of_sending_those_of_arrival_count(source, received, sent):
    info = {"source_timestamp": source, "received_timestamp": received}
    assert Received(IMU, "Imu", None, info).sent == sent


@pytest.mark.parametrize(
    ("received", "arrival"),
    [(70, 70), (0, 100), (101, 100), (10, 100)],
    ids=["of the middleware", "none given", "in the future", "of another clock"],
)
def test_arrival(received: int, arrival: int) -> None:
    info = {"source_timestamp": 1, "received_timestamp": received * SECOND}
    assert Received(IMU, "Imu", None, info).arrival(100 * SECOND) == arrival * SECOND
