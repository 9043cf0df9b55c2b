"""A log format that is no part of the package: sentences with a checksum, as GPS receivers write."""

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from icreckon import Log, ReplayError, Robot, Scenario, compare, simulate
from icreckon.estimator.log.measurements import ImuSample, Measurement, PositionFix, TrackSpeeds

# --- the reader ---------------------------------------------------------------------------------------


def read_sentences(path: Path) -> Log:
    """Read lines such as `$TRACKS,1700000000.500000000,0.45,0.60*hh`."""
    damaged = 0

    def measurements() -> Iterator[Measurement]:
        nonlocal damaged
        for line in path.read_text(encoding="ascii").splitlines():
            text, _, check = line.removeprefix("$").partition("*")
            if f"{checksum(text):02X}" != check:
                damaged += 1
                continue
            kind, time, *values = text.split(",")
            seconds, fraction = time.split(".")
            stamp, numbers = int(seconds + fraction), tuple(map(float, values))
            if kind == "TRACKS":
                yield TrackSpeeds(stamp, *numbers)
            elif kind == "IMU":
                yield ImuSample(stamp, numbers[:3], numbers[3:])
            elif kind == "FIX":
                x, y, sigma = numbers
                yield PositionFix(stamp, x, y, sigma**2)

    log = Log.from_measurements(measurements(), path.stem)
    if not len(log.tracks.stamps):
        raise ReplayError(f"{path} holds no track speeds")
    return replace(log, dropped=log.dropped | ({"line: checksum": damaged} if damaged else {}))


def checksum(text: str) -> int:
    return reduce(lambda total, byte: total ^ byte, text.encode("ascii"), 0)


# --- its tests ----------------------------------------------------------------------------------------

VARIANTS = ["constant-online", "inertia-online"]


def sentences(log: Log) -> Iterator[str]:
    for m in log.measurements():
        match m:
            case TrackSpeeds(_, left, right):
                kind, values = "TRACKS", (left, right)
            case ImuSample(_, rate, force):
                kind, values = "IMU", (*rate, *force)
            case PositionFix(_, x, y, variance):
                kind, values = "FIX", (x, y, variance**0.5)
        seconds, fraction = divmod(m.stamp, 1_000_000_000)
        text = ",".join([kind, f"{seconds}.{fraction:09d}", *map(repr, values)])
        yield f"${text}*{checksum(text):02X}"


@pytest.fixture
def simulated(robot: Robot) -> Log:
    return simulate(Scenario(duration=20.0, fix_rate=1.0, include_truth=False, seed=2), robot)


@pytest.fixture
def file(simulated: Log, tmp_path: Path) -> Path:
    path = tmp_path / "drive.txt"
    path.write_text("\n".join(sentences(simulated)), encoding="ascii")
    return path


def test_it_replays_like_the_log_that_was_written(file: Path, simulated: Log, robot: Robot) -> None:
    log = read_sentences(file)
    assert log.name == "drive"
    assert not log.dropped
    read, direct = (compare(one, robot, VARIANTS) for one in (log, simulated))
    assert list(read.runs) == VARIANTS
    for name, run in direct.runs.items():
        np.testing.assert_array_equal(read.runs[name].stamps, run.stamps)
        np.testing.assert_allclose(read.runs[name].states, run.states, rtol=1e-9, atol=1e-12)


def test_damaged_lines_are_dropped_and_counted(file: Path, simulated: Log) -> None:
    text = file.read_text(encoding="ascii")
    file.write_text(text.replace("0", "1", 1), encoding="ascii")
    log = read_sentences(file)
    assert log.dropped == {"line: checksum": 1}
    assert len(list(log.measurements())) == len(list(simulated.measurements())) - 1
