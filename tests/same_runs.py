"""Simulated logs whose sensors are irregular or silent, and the comparison of two runs over them."""

from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from icreckon import FixSeries, Log, PoseEstimator, Robot, Run, Scenario, load_robot, simulate
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.health import Health
from icreckon.estimator.streaming.run import work_through

ROBOT = load_robot("auriga-alpha")
# What rounding may come to, in standard deviations. Where track speeds are hardly known, the gyro cuts
# the variance of the yaw rate to a billionth, of which doubles have seven digits left.
ROUNDING, FEW_DIGITS = 1e-8, 1e-6


@cache
def drive(
    duration: float = 12.0, fix_rate: float = 0.0, antenna: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> Log:
    """A drive whose sensors sample at no regular times, none of them when another does.

    Its fixes are those of base_link, whatever place the antenna claims.
    """
    log = simulate(Scenario(duration=duration, seed=5, fix_rate=fix_rate), ROBOT)
    rng = np.random.default_rng(1)

    def late(stamps: np.ndarray, most: int) -> np.ndarray:
        return np.asarray(np.sort(stamps + rng.integers(0, most, len(stamps))))

    tracks = replace(log.tracks, stamps=late(log.tracks.stamps, 18_000_000))
    imu = replace(log.imu, stamps=late(log.imu.stamps, 9_000_000))
    fixes = log.fixes
    if fixes is not None:
        inner = slice(1, -1)
        stamps = late(fixes.stamps[inner], 150_000_000)
        antennas = np.tile(antenna, (len(stamps), 1)) if any(antenna) else None
        fixes = FixSeries(stamps, fixes.poses[inner], fixes.variances[inner], antennas)
    return replace(log, tracks=tracks, imu=imu, fixes=fixes, truth=None)


def without(log: Log, stream: str, start: float, end: float) -> Log:
    """A log whose IMU or track speeds are silent for a while [s]."""
    series: Any = getattr(log, stream)
    since = (series.stamps - log.start) * 1e-9
    kept = (since < start) | (since > end)
    columns = ("speeds", "angular_velocity", "linear_acceleration")
    changes = {name: getattr(series, name)[kept] for name in columns if hasattr(series, name)}
    return replace(log, **{stream: replace(series, stamps=series.stamps[kept], **changes)})


def every(log: Log, stream: str, step: int) -> Log:
    """A log of which the IMU or the track speeds are slower."""
    series: Any = getattr(log, stream)
    columns = ("stamps", "speeds", "angular_velocity", "linear_acceleration")
    # Contiguous as what readers of logs give: for others numba compiles the loop again.
    changes = {
        name: np.ascontiguousarray(getattr(series, name)[::step])
        for name in columns
        if hasattr(series, name)
    }
    return replace(log, **{stream: replace(series, **changes)})


def off(found: np.ndarray, expected: np.ndarray, sigmas: np.ndarray) -> float:
    return float((np.abs(found - expected) / np.where(sigmas > 0.0, sigmas, 1.0)).max())


def assert_same_run(found: Run, expected: Run, rounding: float = ROUNDING) -> None:
    """All rows, counts and innovations are the same, to rounding."""
    assert found.variant == expected.variant
    np.testing.assert_array_equal(found.stamps, expected.stamps)
    sigmas = expected.state_sigmas.copy()
    # A fast slip of less than 1 µm/s is what is left of larger numbers that cancel.
    fast = [k for k, name in enumerate(expected.state_names) if name.startswith("fast_slip")]
    sigmas[:, fast] = np.maximum(sigmas[:, fast], 1e-6)
    assert off(found.states, expected.states, sigmas) < rounding
    assert off(found.state_sigmas, expected.state_sigmas, sigmas) < rounding
    here, there = found.trajectory, expected.trajectory
    scale = sigmas[:, :3, None] * sigmas[:, None, :3]
    assert off(here.pose_covariances, there.pose_covariances, scale) < rounding
    spread = np.sqrt(np.diagonal(there.twist_covariances, axis1=1, axis2=2))
    # A twist that nothing is known to be wrong of has no sigma worth the name.
    assert off(here.twists, there.twists, np.maximum(spread, 1e-6)) < rounding
    scale = np.maximum(spread[:, :, None] * spread[:, None], 1e-12)
    assert off(here.twist_covariances, there.twist_covariances, scale) < rounding
    np.testing.assert_allclose(found.indices, expected.indices, rtol=1e-9, atol=1e-9)
    assert found.state_names == expected.state_names
    assert found.innovation_names == expected.innovation_names
    np.testing.assert_allclose(found.innovations, expected.innovations, rtol=1e-5, atol=1e-6)
    assert_same_counts(found.health, expected.health)


def numbers(of: object) -> list[float]:
    """All numbers of nested tuples and records, in order; one for each that is None."""
    if is_dataclass(of):
        return [number for one in fields(of) for number in numbers(getattr(of, one.name))]
    if isinstance(of, tuple):
        return [number for part in of for number in numbers(part)]
    if isinstance(of, str):
        return [float(sum(of.encode()))]
    return [-1.0 if of is None else float(of)]  # type: ignore[arg-type]


def assert_same_counts(found: Health, expected: Health, rounding: float = 1e-6) -> None:
    assert found.sensors.keys() == expected.sensors.keys()
    for name in ("standstill_updates", "track_gaps", "clock_steps", "times"):
        assert getattr(found, name) == getattr(expected, name), name
    mine_, theirs_ = (numbers(tuple(one.findings)) for one in (found, expected))
    np.testing.assert_allclose(mine_, theirs_, rtol=rounding)
    np.testing.assert_allclose(found.slip_factor, expected.slip_factor, rtol=1e-6)
    for name, noise in expected.noise.items():
        np.testing.assert_allclose(numbers(found.noise[name]), numbers(noise), rtol=1e-8)
    for name, sensor in expected.sensors.items():
        mine = found.sensors[name]
        for count in ("used", "rejected", "degrees", "late", "judged_count", "reacquired"):
            assert getattr(mine, count) == getattr(sensor, count), (name, count)
        assert mine.nis_sum == pytest.approx(sensor.nis_sum, rel=rounding)
        for sum_ in ("newest_nis", "recent_nis"):
            theirs = getattr(sensor, sum_)
            assert getattr(mine, sum_) == (theirs and pytest.approx(theirs, rel=1e-6))
        assert (mine.newest is None) == (sensor.newest is None)
        if mine.newest is not None and sensor.newest is not None:
            assert mine.newest[:2] == sensor.newest[:2]
            assert mine.newest.residual == pytest.approx(sensor.newest.residual, rel=1e-6)
            here, there = np.array(mine.newest.covariance), np.array(sensor.newest.covariance)
            np.testing.assert_allclose(here, there, rtol=1e-6)


def apart(found: PoseEstimator, state: Floats, covariance: Floats, before: Any = 0.0) -> float:
    """Difference from a state and covariance in standard deviations, or in larger ones before.

    An update leaves the rounding of the numbers that it subtracts, which were of the size before it.
    """
    sigmas = np.maximum(np.sqrt(np.diagonal(covariance)), before)
    unit = np.where(sigmas > 0.0, sigmas, 1.0)
    of_covariance = off(found.covariance, covariance, np.outer(unit, unit))
    return max(off(found.state, state, unit), of_covariance)


def assert_same_estimate(found: PoseEstimator, expected: PoseEstimator) -> None:
    """Estimate and health are the same, to rounding."""
    assert (found.stamp, found.stands) == (expected.stamp, expected.stands)
    assert apart(found, expected.state, expected.covariance) < 1e-9
    assert_same_counts(found.health, expected.health, 1e-9)
    assert found.twist == pytest.approx(expected.twist, abs=1e-10)
    assert found.indices == pytest.approx(expected.indices, abs=1e-9)


def fed_one_by_one(log: Log, robot: Robot, variant: str, **options: Any) -> Run:
    """Run whose measurements are fed one by one."""
    return work_through(log, PoseEstimator(robot, variant, **options), at_row=lambda: None)
