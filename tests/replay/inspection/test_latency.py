"""Latency: found against the gyro, proposed, taken off the stamps, and worth it on the real logs."""

import re
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from conftest import inspected, sample_log
from icreckon import ReplayError, Robot, load_robot
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.latency import objection, track_latency
from icreckon.replay.mapping.topics import topic_map

RATE = 100.0


def turning(*, late: float):
    """Tracks that are late by so much, a gyro that is not, and the turning itself."""
    rng = np.random.default_rng(1)
    knots = np.arange(-5.0, 125.0, 2.0)
    rates = rng.normal(0.0, 0.6, len(knots))

    def yaw_rate(t):
        return np.interp(t, knots, rates)

    imu = np.arange(0.0, 120.0, 1.0 / RATE)
    vertical = yaw_rate(imu - 0.5 / RATE) + 0.01 * rng.standard_normal(len(imu)) + 0.02
    times = np.arange(0.0, 120.0, 0.05)
    # A value is the mean since the one before, so that it is right in the middle of that time.
    shown = yaw_rate(times - late - 0.025)
    speeds = np.column_stack([0.5 - 0.4 * shown, 0.5 + 0.4 * shown])
    stamps = (imu * 1e9).astype(np.int64)
    tracks = TrackSpeedSeries((times * 1e9).astype(np.int64), speeds)
    return tracks, YawRates(stamps, vertical)


@pytest.mark.parametrize("late", [-0.2, 0.0, 0.07, 0.21, 0.6])
def test_the_latency_of_tracks_is_found(late: float) -> None:
    found = track_latency(*turning(late=late))
    assert found.seconds == pytest.approx(late, abs=0.004)
    assert found.sigma < 0.005
    assert (not objection(found)) == (abs(late) > 0.03)


def mapped(robot: Robot, **latencies: float) -> Robot:
    log = {name: dict(table) for name, table in robot.log.items()}
    for name, value in latencies.items():
        log[name]["latency"] = value
    return structs.replace(robot, log=log)


@pytest.mark.parametrize("latency", [float("nan"), 11.0])
def test_nonsense_is_refused(latency: float) -> None:
    with pytest.raises(ReplayError, match="latency must be a number of seconds"):
        topic_map(mapped(load_robot("marmotte"), imu=latency))


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("warthog_grass_2024_7_29_14h46s15", 0.18),
        ("warthog_asphalt_2024_9_25_12h8s57", 0.18),
        ("husky_test1.bag", 0.36),
        ("marmotte_part1", None),
    ],
)
def test_inspect_proposes_it(name: str, seconds: float | None, data_dir: Path) -> None:
    found = inspected(sample_log(data_dir, name))
    (said,) = (one for one in found.findings if re.match("tracks: stamps (lag|lead)", one))
    assert "± 0.0" in said
    assert ("no latency is proposed" in said) == (seconds is None)
    proposed = re.findall(r"^latency = (\S+)", found.proposed_robot_file, re.MULTILINE)
    expected = [] if seconds is None else [pytest.approx(seconds, abs=0.015)]
    assert [*map(float, proposed)] == expected
