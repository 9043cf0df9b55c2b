"""Clocks that are set forward while the robot drives: the pose goes on, and no years pass."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import pytest

from icreckon.replay.live.clock_watch import WITNESSES, ClockWatch

SECOND = 10**9


class Came(NamedTuple):
    """A message of a stream: its stamp, and when it came [s]."""

    stream: str
    stamp: float
    at: float


def through(messages: Iterable[Came]) -> tuple[list[float], list[float], int]:
    """Stamps that are used [s], steps of the clock [s], and number of lost messages."""
    watch: ClockWatch[float] = ClockWatch()
    used, steps, lost = [], [], 0
    for stream, stamp, at in messages:
        found = watch.take(stream, round(stamp * SECOND), round(at * SECOND), stamp)
        used += found.ready
        steps += [found.step / SECOND] if found.step else []
        lost += found.lost
    return used, steps, lost


def usual(_at: float) -> float:
    return 0.0


def drive(ahead: Callable[[float], float], streams: str = "ab") -> list[Came]:
    """Ten seconds of two streams whose stamps are ahead by a function of time."""
    times = np.arange(0.0, 10.0, 0.05).round(3).tolist()
    return [Came(name, at + ahead(at), at) for at in times for name in streams]


@pytest.mark.parametrize("by", [4.0, 3600.0, 1.7e9])
def test_a_step_is_found_once_and_no_message_is_lost(by: float) -> None:
    messages = drive(lambda at: by if at >= 5.0 else 0.0)
    used, steps, lost = through(messages)
    assert steps == [pytest.approx(by)]
    assert lost == 0
    assert sorted(used) == sorted(one.stamp for one in messages)


def test_small_steps_and_holes_are_none() -> None:
    assert through(drive(lambda at: 2.9 if at >= 5.0 else 0.0))[1:] == ([], 0)
    hole = [one for one in drive(usual) if not 2.0 < one.at < 8.0]
    assert through(hole)[1:] == ([], 0)


def test_a_program_that_could_not_run_sees_no_step() -> None:
    """Messages of six seconds that come all at once, and the last of a short queue."""
    messages = drive(usual)
    late = [one._replace(at=8.0 if 2.0 < one.at < 8.0 else one.at) for one in messages]
    assert through(late) == ([one.stamp for one in messages], [], 0)
    short = [one for one in late if not 2.0 < one.stamp < 7.5]
    assert through(short)[1:] == ([], 0)


@pytest.mark.parametrize("wrong", range(1, WITNESSES))
def test_few_wrong_stamps_are_lost(wrong: int) -> None:
    messages = drive(usual, "a")
    bad = [one._replace(stamp=one.stamp + 100.0) for one in messages[50 : 50 + wrong]]
    used, steps, lost = through([*messages[:50], *bad, *messages[50 + wrong :]])
    assert (steps, lost) == ([], wrong)
    assert used == [one.stamp for one in [*messages[:50], *messages[50 + wrong :]]]
