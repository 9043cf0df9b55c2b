"""Track speeds that a logger repeats: found where they are, and left alone where they are not."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from conftest import sample_log
from icreckon import EncoderSpec, Log, Scenario, load_robot, read_log, run, simulate, write_log
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.replay.reading.held_speeds import without_holding

ROBOT = load_robot("auriga-alpha")
SAMPLES = 12
"""Samples for which a value is held: 0.24 s at 50 Hz."""


@pytest.fixture(scope="module")
def driven() -> Log:
    """A drive with stops and noise of its encoders."""
    return simulate(Scenario(duration=60.0, trajectory="random", fix_rate=0.0), ROBOT)


def holding(log: Log, samples: int = SAMPLES, sides: tuple[int, ...] = (0, 1)) -> Log:
    """The log with only one value in so many, repeated until the next."""
    speeds = log.tracks.speeds.copy()
    place = np.arange(len(speeds)) // samples * samples
    for side in sides:
        speeds[:, side] = speeds[place, side]
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, speeds))


def speeds_of(log: Log, held: str = "auto") -> np.ndarray:
    found = without_holding(log, held)
    assert (found.tracks.stamps == log.tracks.stamps).all()
    return found.tracks.speeds


def test_held_speeds_are_interpolated(driven: Log) -> None:
    """Between the first samples of values, which stay what they are, with a note."""
    held = holding(driven)
    found = without_holding(held, "auto")
    (note,) = set(found.notes) - set(driven.notes)
    assert "change only 4 times a second" in note
    assert 'held = "keep"' in note
    # Nearer to what they were before they were held, but for the time that is latency.
    late = SAMPLES // 2
    errors = [
        np.sqrt(np.mean((one.tracks.speeds[late:] - driven.tracks.speeds[:-late]) ** 2))
        for one in (held, found)
    ]
    assert errors[1] < 0.6 * errors[0]
    # Values count for the middle of their time, between its sixth and seventh sample.
    middles = np.arange(SAMPLES, len(held.tracks.speeds) - SAMPLES, SAMPLES) + SAMPLES // 2
    speeds = found.tracks.speeds
    around = 0.5 * (speeds[middles - 1] + speeds[middles])
    steps = np.abs(np.diff(speeds, axis=0))
    slopes = np.maximum(steps[middles - 2], steps[middles])
    assert (np.abs(around - held.tracks.speeds[middles]) <= 0.51 * slopes + 1e-6).mean() > 0.95


def test_keep_keeps_and_interpolate_insists(driven: Log) -> None:
    held = holding(driven)
    assert without_holding(held, "keep") is held
    # Two values in three: not regular enough for "auto".
    loose = driven.tracks.speeds.copy()
    place = np.arange(len(loose))
    place[np.random.default_rng(1).random(len(loose)) < 0.5] = 0
    loose = loose[np.maximum.accumulate(place)]
    log = replace(driven, tracks=TrackSpeedSeries(driven.tracks.stamps, loose))
    assert without_holding(log, "auto") is log
    assert (speeds_of(log, "interpolate") != loose).any()


def test_what_is_not_held_stays(driven: Log) -> None:
    """Plain logs, coarse encoders, standstill, nothing at all."""
    assert without_holding(driven, "auto") is driven
    encoders = EncoderSpec(resolution=0.002)
    coarse = simulate(Scenario(duration=60.0, fix_rate=0.0, encoders=encoders), ROBOT)
    assert without_holding(coarse, "auto") is coarse
    stamps = driven.tracks.stamps
    for speeds in (np.zeros((len(stamps), 2)), np.full((len(stamps), 2), 0.5)):
        still = replace(driven, tracks=TrackSpeedSeries(stamps, speeds))
        assert without_holding(still, "auto") is still
        assert (speeds_of(still, "interpolate") == speeds).all()
    for few in range(4):
        short = replace(driven, tracks=TrackSpeedSeries(stamps[:few], driven.tracks.speeds[:few]))
        assert without_holding(short, "auto") is short
        speeds_of(short, "interpolate")


def test_steps_that_the_robot_makes_stay(driven: Log) -> None:
    """Regular repetitions with a gyro and another track that repeat as well are the motion itself."""
    held = holding(driven)
    quiet = replace(held.imu, angular_velocity=np.zeros_like(held.imu.angular_velocity))
    log = replace(held, imu=quiet)
    assert without_holding(log, "auto") is log
    assert without_holding(replace(held, imu=None), "auto").tracks is held.tracks


def test_standstill_and_steady_speeds_stay(driven: Log) -> None:
    """A value that stays for seconds is one, up to one usual time before the next."""
    held = holding(driven)
    speeds = held.tracks.speeds.copy()
    low, high = 40 * SAMPLES, 60 * SAMPLES
    speeds[low:high] = 0.0
    speeds[high : high + 20 * SAMPLES] = [0.31, 0.29]
    log = replace(held, tracks=TrackSpeedSeries(held.tracks.stamps, speeds))
    found = speeds_of(log)
    assert (found != speeds).any()
    half = SAMPLES // 2
    assert (found[low + half : high - half] == 0.0).all()
    inner = found[high + half : high + 20 * SAMPLES - half]
    np.testing.assert_allclose(inner, np.broadcast_to([0.31, 0.29], inner.shape), atol=1e-12)


def test_a_stuck_sensor_is_still_found(driven: Log) -> None:
    held = holding(driven)
    speeds = held.tracks.speeds.copy()
    moving = int(np.flatnonzero(np.abs(speeds[1000:, 0]) > 0.05)[0]) + 1000
    speeds[moving:, 0] = speeds[moving, 0]
    log = replace(held, tracks=TrackSpeedSeries(held.tracks.stamps, speeds), truth=None)
    found = without_holding(log, "auto")
    assert found is not log
    assert (found.tracks.speeds[moving + SAMPLES :, 0] == speeds[moving, 0]).all()
    assert run(found, ROBOT, "constant-fixed").health.times["stuck"] == 1


def test_a_hole_is_not_bridged(driven: Log) -> None:
    held = holding(driven)
    keep = np.ones(len(held.tracks.stamps), dtype=bool)
    low, high = 100 * SAMPLES + 5, 110 * SAMPLES + 5
    keep[low:high] = False
    tracks = TrackSpeedSeries(held.tracks.stamps[keep], held.tracks.speeds[keep])
    found = speeds_of(replace(held, tracks=tracks))
    # The last value before the hole and the first one after it are as they were read.
    np.testing.assert_allclose(found[low - 1], tracks.speeds[low - 1])
    np.testing.assert_allclose(found[low], tracks.speeds[low])


def test_the_robot_file_has_the_last_word(driven: Log, tmp_path: Path) -> None:
    held = holding(driven)
    bag = write_log(held, tmp_path / "bag", "mcap", ROBOT)
    notes = []
    for how in ("auto", "keep"):
        tracks = {**ROBOT.log["tracks"], "held": how}
        robot = msgspec.structs.replace(ROBOT, log={**ROBOT.log, "tracks": tracks})
        log = read_log(bag, robot)
        notes.append([note for note in log.notes if "repeated in between" in note])
        if how == "keep":
            np.testing.assert_allclose(log.tracks.speeds, held.tracks.speeds)
    assert [len(some) for some in notes] == [1, 0]


@pytest.mark.parametrize(
    ("name", "robot", "rate"),
    [
        ("warthog_grass_2024_8_8_16h11s19", "warthog", 4),
        ("husky_deflated_part1", "husky-deflated", 10),
        ("marmotte_part1", "marmotte", None),
        ("husky_test1.bag", "husky", None),
    ],
)
def test_sample_logs(name: str, robot: str, rate: int | None, data_dir: Path) -> None:
    """The README beside the logs has the rates at which speeds change."""
    known = load_robot(robot)
    tracks = {**known.log["tracks"], "held": "auto"}
    known = msgspec.structs.replace(known, log={**known.log, "tracks": tracks})
    log = read_log(sample_log(data_dir, name), known)
    notes = [note for note in log.notes if "repeated in between" in note]
    assert len(notes) == (rate is not None)
    if rate is not None:
        assert f"change only {rate} times a second" in notes[0]
