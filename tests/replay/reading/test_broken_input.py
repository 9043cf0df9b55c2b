"""Broken messages: the replay ends within its own 3 sigma of the unbroken one, and says what happened."""

from dataclasses import replace

import numpy as np
import pytest
from broken_input import FAULTS, broken_runs, standstill_drift

from icreckon import Scenario, load_robot, simulate
from icreckon.replay.reading.stamps import doubled_times, without_steps

SECOND = 1_000_000_000
SPIKE = "spike of 30 m/s and 20 rad/s"
# What the report has to say of each fault.
TOLD = {
    "one NaN": "1 x tracks: not finite",
    "one infinite value": "1 x imu: not finite",
    "one stamp 30 s in the past": "1 x tracks: stamp goes backward",
    "headers step back 5 s for good": "the clock of imu was set back by 5.00 s",
    "clock steps back 5 s for good": "twice as many track speeds and IMU samples",
    "headers step an hour forward": "the clock of tracks was set forward by 3600.00 s",
    "clock steps an hour forward": "1 gaps of the tracks bridged",
    "every message twice": "tracks: duplicate stamp",
    "same stamp, another value": "1 x tracks: duplicate stamp",
    "gap of 2 s": "1 gaps of the tracks bridged",
    SPIKE: "1 x tracks: absurdly fast",
}
# The robot has lost time in these; in all others next to nothing.
COSTLY = ("gap", "clock steps")


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    robot = load_robot("auriga-alpha")
    log = replace(simulate(Scenario(duration=30.0, seed=6), robot), fixes=None)
    return broken_runs(log, robot, "inertia-online", tmp_path_factory.mktemp("broken"))


@pytest.mark.parametrize("fault", [*FAULTS, SPIKE])
def test_a_fault_stays_within_three_sigma_and_is_told(outcomes, fault: str) -> None:
    found = outcomes[fault]
    assert found.share < 1.0
    assert TOLD.get(fault, "") in "; ".join(found.told)
    if not fault.startswith(COSTLY):
        assert found.metres < 0.02
        assert found.degrees < 0.2


def test_a_standing_robot_does_not_drift() -> None:
    metres, degrees = standstill_drift(load_robot("auriga-alpha"), "inertia-online")
    assert metres < 1e-3
    assert degrees < 0.1


def test_a_recorder_that_stalls_is_no_step() -> None:
    stamped = np.arange(1000, dtype=np.int64) * 10_000_000
    recorded = stamped + 2_000_000
    # For 3 s nothing was written down, and then all at once.
    recorded[300:600] = recorded[600] + np.arange(300) * 10_000 - 3_000_000
    found, steps = without_steps(stamped, recorded)
    assert (found == stamped).all()
    assert not steps


def test_a_wrong_stamp_long_before_a_short_log_doubles_no_time() -> None:
    """The empty windows behind it halved the usual count: most of the log was left out."""
    stamps = np.arange(0, 40 * SECOND, SECOND // 100)
    wrong = np.sort(np.append(stamps, -60 * SECOND))
    assert doubled_times(wrong) == doubled_times(stamps) == []
    twice = np.sort(np.concatenate([wrong, stamps[1000:2000] + 1]))
    ((begin, end),) = doubled_times(twice)
    assert (begin, end) == pytest.approx((10 * SECOND, 20 * SECOND), abs=SECOND)
