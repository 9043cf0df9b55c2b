"""Clocks that are set forward while the robot drives: the pose goes on, and no years pass."""

from collections.abc import Callable, Iterable
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from conftest import simulated
from icreckon import PoseEstimator, Robot
from icreckon.replay.live.clock_watch import WITNESSES, ClockWatch
from icreckon.replay.live.odometry import LiveOdometry

SECOND = 10**9
VARIANT = "constant-online"


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


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clock") / "bag"
    return simulated(path, 12.0, seed=4, trajectory="slalom", fix_rate=0.0)


def set_stamps(message: Any, by: int) -> Any:
    changed = deepcopy(message)
    stamp = changed.header.stamp
    seconds, nanoseconds = divmod(stamp.sec * SECOND + stamp.nanosec + by, SECOND)
    object.__setattr__(stamp, "sec", seconds)
    object.__setattr__(stamp, "nanosec", nanoseconds)
    return changed


def live_run(bag: Path, robot: Robot, ahead: Callable[[float], int]) -> LiveOdometry:
    """Odometry over a bag whose header stamps are ahead by a function of time [s] in ns."""
    live = LiveOdometry(robot, VARIANT, use_fixes=False)
    topics = {one.topic: one for one in live.inputs.subscriptions()}
    with AnyReader([bag]) as reader:
        wanted = [one for one in reader.connections if one.topic in topics]
        first = when = 0
        for one, when, raw in reader.messages(wanted):
            first = first or when
            by = ahead((when - first) / SECOND)
            message = set_stamps(reader.deserialize(raw, one.msgtype), by)
            # The system's clock is set with the stamps; the steady one is not.
            live.take(topics[one.topic], one.msgtype, message, when + by, when)
        live.flush(when)
    return live


@pytest.fixture(scope="module")
def unstepped(bag: Path, robot: Robot) -> PoseEstimator:
    return live_run(bag, robot, lambda _: 0).odom


@pytest.mark.parametrize(
    "ahead",
    [
        lambda at: 0 if at < 6.0 else 3600 * SECOND,
        lambda at: 0 if at < 6.0 else 5 * SECOND,
        lambda at: -1_600_000_000 * SECOND if at < 4.0 else 0,
        lambda at: -3600 * SECOND if 4.0 <= at < 8.0 else 0,
    ],
    ids=["an hour", "five seconds", "from the seventies", "back and forth"],
)
def test_the_pose_goes_on(ahead, unstepped, bag, robot):
    usual, stepped = unstepped, live_run(bag, robot, ahead).odom
    assert stepped.health.clock_steps >= 1
    assert usual.health.clock_steps == 0
    assert stepped.stamp - usual.stamp == pytest.approx(ahead(12.0), abs=0.1 * SECOND)
    off = np.hypot(*(stepped.pose - usual.pose)[:2])
    assert off < 0.02
    sigmas = np.sqrt(np.diagonal(stepped.pose_covariance))
    assert sigmas == pytest.approx(np.sqrt(np.diagonal(usual.pose_covariance)), rel=0.3)
    for name, health in usual.parameter_health.items():
        assert stepped.parameter_health[name].share == pytest.approx(
            health.share, abs=0.1, nan_ok=True
        )
