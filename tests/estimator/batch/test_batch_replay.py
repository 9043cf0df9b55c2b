"""Variants side by side over one log: real logs, what is refused, and where comparisons use them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import sample, thorough
from icreckon.estimator.base.errors import BatchError, EstimatorError
from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ZeroVelocity
from icreckon.estimator.log.series import FixSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.run import run
from icreckon.replay.comparison import compare as comparison
from icreckon.replay.comparison.compare import compare
from icreckon.replay.comparison.fixes import parse_part, with_fixes_within
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from same_runs import ROBOT, assert_same_run, drive


@pytest.mark.parametrize(
    ("name", "robot_name", "part"),
    [
        ("husky_test1.bag", "husky", None),
        thorough("jackal_test2.bag", "jackal", None),
        thorough("warthog_grass_2024_8_8_15h56s39", "warthog", "0:40%"),
        thorough("marmotte_part1", "marmotte", None),
        thorough("husky_deflated_part1", "husky-deflated", "0:40%"),
    ],
)
def test_real_logs(data_dir: Path, name: str, robot_name: str, part: str | None) -> None:
    """Clocks that are not even, holes, and fixes that show that the robot was lost."""
    robot = load_robot(robot_name)
    log = sample(data_dir, name, robot_name)
    if part is not None:
        log = with_fixes_within(log, parse_part(part))
    for variant, found in run_side_by_side(
        log, robot, ["constant-online", "inertia-online"]
    ).items():
        assert_same_run(found, run(log, robot, variant))


def test_what_cannot_be_taken_is_refused_by_name() -> None:
    log = drive()
    begin = int(log.tracks.stamps[0])

    def refused(log: Log, why: str, *variants: str, settings: Settings | None = None) -> None:
        with pytest.raises(BatchError, match=why):
            run_side_by_side(log, ROBOT, variants or ("constant-online",), settings=settings)

    refused(replace(log, imu=None), "no IMU")
    refused(replace(log, others=(ZeroVelocity(begin, (0.1, 0.1, 0.1)),)), "ZeroVelocity")
    refused(log, "engine", settings=Settings(engine="plain"))
    forces = log.imu.linear_acceleration
    forces = forces.copy()
    forces[7] = np.nan
    refused(replace(log, imu=replace(log.imu, linear_acceleration=forces)), "without forces")
    broken = FixSeries(np.array([begin + 10**9]), np.zeros((1, 3)), -np.ones((1, 2)))
    refused(replace(log, fixes=broken), "fixes that are no numbers")
    stamps = log.tracks.stamps.copy()
    stamps[500:] += 200 * 10**9
    later = replace(log, tracks=TrackSpeedSeries(stamps, log.tracks.speeds), imu=log.imu)
    refused(later, "longest_gap")
    empty = TrackSpeedSeries(np.zeros(0, np.int64), np.zeros((0, 2)))
    with pytest.raises(EstimatorError, match="no track speeds"):
        run_side_by_side(replace(log, tracks=empty), ROBOT, ("constant-online",))
    with pytest.raises(EstimatorError, match="start_sigma must be three finite numbers"):
        run_side_by_side(log, ROBOT, ("constant-online",), start_sigma=(0.0, -1.0, 0.0))
    assert run_side_by_side(log, ROBOT, ()) == {}


def test_long_logs_are_compared_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    log = drive(25.0, fix_rate=5.0)
    log = replace(log, truth=simulate(Scenario(duration=25.0, seed=5), ROBOT).truth)
    variants = ("constant-online", "inertia-fixed", "inertia-online")
    apart = compare(log, ROBOT, variants)
    monkeypatch.setattr(comparison, "MANY_SAMPLES", 1000)
    told: list[float] = []
    monkeypatch.setattr(comparison, "run", _not_streamed)
    together = compare(log, ROBOT, variants, progress=told.append)
    assert list(together.runs) == list(variants)
    for variant, found in together.runs.items():
        assert_same_run(found, apart.runs[variant])
    assert told == sorted(told)
    assert told[0] < 0.5 < told[-1] <= 1.0


def _not_streamed(*_: Any, **__: Any) -> Run:
    raise AssertionError("all variants were to run side by side")


def test_what_side_by_side_cannot_take_is_streamed(monkeypatch: pytest.MonkeyPatch) -> None:
    log = drive()
    log = replace(log, others=(ZeroVelocity(int(log.tracks.stamps[50]), (0.1, 0.1, 0.1)),))
    apart = compare(log, ROBOT, ("constant-online",))
    monkeypatch.setattr(comparison, "MANY_SAMPLES", 1000)
    streamed = compare(log, ROBOT, ("constant-online",)).runs["constant-online"]
    np.testing.assert_array_equal(streamed.states, apart.runs["constant-online"].states)
    smoothed = compare(drive(), ROBOT, ("constant-online",), smooth=True)
    assert list(smoothed.runs) == ["constant-online", "constant-online-smoothed"]


def test_a_truth_that_was_logged_is_aligned_side_by_side(monkeypatch, data_dir):
    robot = load_robot("warthog")
    log = sample(data_dir, "warthog_asphalt_2024_9_25_12h8s57", "warthog")
    apart = compare(log, robot, ("constant-online",))
    monkeypatch.setattr(comparison, "MANY_SAMPLES", 1000)
    monkeypatch.setattr(comparison, "run", _not_streamed)
    together = compare(log, robot, ("constant-online",))
    assert together.alignment.lag == pytest.approx(apart.alignment.lag, abs=1e-6)
    assert_same_run(together.runs["constant-online"], apart.runs["constant-online"], 1e-5)
