"""The node's inbox, with queues of ROS that are imitated."""

from __future__ import annotations

from typing import Any

import pytest

from icreckon.replay.live.inputs import Subscription
from icreckon.ros2.inbox import Inbox, Queue, Received

SECOND = 1_000_000_000
IMU, TRACKS = Subscription("imu", "/imu", ()), Subscription("tracks", "/joint_states", ())


class Handle:
    """Queue of ROS: the messages that a take finds, none when it is empty."""

    def __init__(self) -> None:
        self.messages: list[tuple[Any, dict[str, int]]] = []

    def __enter__(self) -> Handle:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def take_message(self, kind: str, raw: bool) -> tuple[Any, dict[str, int]] | None:
        assert not raw
        assert kind == "a type"
        return self.messages.pop(0) if self.messages else None

    def send(self, *times: int) -> None:
        """Put messages into the queue that arrive 1 ms after they were sent."""
        for sent in times:
            info = {"source_timestamp": sent, "received_timestamp": sent + SECOND // 1000}
            self.messages.append((sent, info))


class Ros:
    """Subscription of rclpy."""

    msg_type = "a type"

    def __init__(self) -> None:
        self.handle = Handle()


class Clock:
    """Time that the test sets."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def inbox_of(clock: Clock, depth: int = 100) -> tuple[Inbox, Handle, Handle]:
    """Inbox with queues of IMU and tracks."""
    inbox, imu, tracks = Inbox(clock), Ros(), Ros()
    inbox.add(Queue(IMU, "Imu", imu, depth))
    inbox.add(Queue(TRACKS, "JointState", tracks, depth))
    return inbox, imu.handle, tracks.handle


def test_all_that_waits_comes_in_the_order_of_sending(clock: Clock) -> None:
    inbox, imu, tracks = inbox_of(clock)
    imu.send(20, 30, 40, 50)
    tracks.send(25, 45)
    inbox.put(Received(IMU, "Imu", 10, {"source_timestamp": 10, "received_timestamp": 11}))
    taken = inbox.take()
    assert [one.message for one in taken] == [10, 20, 25, 30, 40, 45, 50]
    assert taken[2].subscription.purpose == "tracks"
    assert not inbox.settling
    assert inbox.take() == []


def test_a_queue_that_fills_as_fast_as_it_is_emptied_ends(clock: Clock) -> None:
    inbox, imu, _ = inbox_of(clock, depth=3)
    imu.send(*range(1, 8))
    assert [one.message for one in inbox.take()] == [1, 2, 3]
    assert [one.message for one in inbox.take()] == [4, 5, 6]


def test_after_a_stall_it_waits_for_what_comes_late(clock: Clock) -> None:
    inbox, imu, tracks = inbox_of(clock)
    assert inbox.take() == []
    clock.now += 3.0
    imu.send(10, 20, 30)
    assert inbox.take() == []
    assert inbox.settling
    clock.now += 0.4
    tracks.send(15, 25)
    assert inbox.take() == []
    clock.now += 0.7
    assert [one.message for one in inbox.take()] == [10, 15, 20, 25, 30]


def test_long_work_on_many_messages_is_no_stall(clock: Clock) -> None:
    inbox, imu, _ = inbox_of(clock)
    imu.send(10)
    assert len(inbox.take()) == 1
    for _ in range(30):
        clock.now += 0.1
        inbox.worked()
    imu.send(20)
    assert [one.message for one in inbox.take()] == [20]


def test_a_stall_while_a_message_is_worked_on_is_one(clock: Clock) -> None:
    inbox, imu, _ = inbox_of(clock)
    imu.send(10)
    assert len(inbox.take()) == 1
    clock.now += 1.5
    inbox.worked()
    imu.send(20)
    assert inbox.take() == []
    clock.now += 0.9
    assert inbox.take() == []
    clock.now += 0.2
    assert [one.message for one in inbox.take()] == [20]


def test_without_times_of_sending_those_of_arrival_count() -> None:
    def sent(source: int | None, received: int | None) -> int:
        info = {"source_timestamp": source, "received_timestamp": received}
        return Received(IMU, "Imu", None, info).sent

    assert [sent(5, 7), sent(0, 7), sent(None, 7), sent(0, 0), sent(None, None)] == [5, 7, 7, 0, 0]


@pytest.mark.parametrize(
    ("received", "arrival"),
    [
        (70 * SECOND, 70 * SECOND),
        (0, 100 * SECOND),
        (101 * SECOND, 100 * SECOND),
        (10 * SECOND, 100 * SECOND),
    ],
    ids=["of the middleware", "none given", "in the future", "of another clock"],
)
def test_arrival(received: int, arrival: int) -> None:
    info = {"source_timestamp": 1, "received_timestamp": received}
    assert Received(IMU, "Imu", None, info).arrival(100 * SECOND) == arrival
