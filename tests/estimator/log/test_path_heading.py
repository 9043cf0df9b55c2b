"""Headings of a truth: those that are none are noticed, and missing ones found from the path."""

from dataclasses import replace

import numpy as np
import pytest

from icreckon.estimator.base.frames import rotate, wrap_angle
from icreckon.estimator.log.path_heading import heading_fault, headings_by_path
from icreckon.estimator.log.scores import drift, path_length
from icreckon.estimator.log.series import PoseSeries, Truth, TwistSeries

STAMPS = np.arange(0, 60_000_000_000, 50_000_000, dtype=np.int64)
SECONDS = STAMPS * 1e-9


def drive(turning: float = 0.4) -> PoseSeries:
    """A winding path at 0.5 m/s."""
    yaw = turning * np.sin(0.3 * SECONDS) * 3.0 + 0.1 * turning * SECONDS
    steps = 0.025 * np.exp(1j * yaw)
    places = np.concatenate([[0.0], np.cumsum(0.5 * (steps[1:] + steps[:-1]))])
    return PoseSeries(STAMPS, np.column_stack([places.real, places.imag, yaw]))


def with_yaw(path: PoseSeries, yaw: np.ndarray | float) -> Truth:
    poses = path.poses.copy()
    poses[:, 2] = yaw
    return Truth(PoseSeries(path.stamps, poses))


def test_headings_that_follow_the_path_are_good() -> None:
    path = drive()
    yaw = path.poses[:, 2]
    noise = 0.2 * np.random.default_rng(1).standard_normal(len(yaw))
    # Noisy ones, wrapped ones, those of a robot that drives backwards, and of a turned sensor.
    for good in (yaw, yaw + noise, wrap_angle(yaw), yaw + np.pi, yaw + 0.5):
        assert heading_fault(with_yaw(path, good)) is None
    # A straight way shows little, and a robot at rest nothing.
    assert heading_fault(with_yaw(drive(0.0), 1e-3 * noise)) is None
    still = PoseSeries(STAMPS, np.zeros((len(STAMPS), 3)))
    assert heading_fault(with_yaw(still, 0.0)) is None


@pytest.mark.parametrize("straight", [True, False])
def test_constant_headings_of_a_moving_robot_are_none(straight: bool) -> None:
    path = drive(0.0 if straight else 0.4)
    assert "all the same although it moves by 30 m" in str(heading_fault(with_yaw(path, 0.0)))


def test_random_and_mirrored_headings_are_none() -> None:
    path, rng = drive(), np.random.default_rng(2)
    for bad in (rng.uniform(-3.0, 3.0, len(STAMPS)), -path.poses[:, 2]):
        assert "do not follow its path" in str(heading_fault(with_yaw(path, bad)))


def test_headings_of_a_robot_that_turns_on_the_spot_are_some() -> None:
    """Its path is short, and its course is that of its slips."""
    yaw = 1.2 * np.sin(0.5 * SECONDS) + 0.8 * SECONDS
    places = np.cumsum(0.015 * np.exp(4j * np.sin(0.17 * SECONDS)))
    path = PoseSeries(STAMPS, np.column_stack([places.real, places.imag, yaw]))
    rates = np.gradient(yaw, SECONDS)
    assert "do not follow its path" in str(heading_fault(with_yaw(path, yaw)))
    # The gyro has a bias, and the truth is late.
    late = STAMPS - 200_000_000
    assert heading_fault(with_yaw(path, yaw), (late, rates + 0.02)) is None
    rng = np.random.default_rng(4)
    for bad in (-yaw, rng.uniform(-3.0, 3.0, len(STAMPS)), 2.0 * yaw):
        assert heading_fault(with_yaw(path, bad), (STAMPS, rates)) is not None


def test_a_truth_with_twists_is_held_to_these() -> None:
    path = drive()
    # Sideways all the time: strange, but what the twist says.
    twists = np.tile([0.0, 0.5, 0.1], (len(STAMPS), 1))
    strange = replace(
        with_yaw(path, path.poses[:, 2] - 0.5 * np.pi), twists=TwistSeries(STAMPS, twists)
    )
    assert heading_fault(strange) is None
    assert (
        heading_fault(replace(with_yaw(path, 0.0), twists=TwistSeries(STAMPS, twists))) is not None
    )
    # A straight drive of a simulation has one heading.
    straight = TwistSeries(STAMPS, np.tile([0.5, 0.0, 0.0], (len(STAMPS), 1)))
    assert heading_fault(replace(with_yaw(drive(0.0), 0.0), twists=straight)) is None


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_headings_are_found_in_any_frame(noise: float) -> None:
    path, rng = drive(), np.random.default_rng(3)
    places = rotate(path.poses[:, :2], np.full(len(STAMPS), 2.1)) + np.array([500.0, -80.0])
    places += noise * rng.standard_normal(places.shape)
    positions = PoseSeries(STAMPS, np.column_stack([places, np.full(len(STAMPS), np.nan)]))
    found = headings_by_path(positions, path)
    np.testing.assert_array_equal(found.poses.poses[:, :2], places)
    off = wrap_angle(found.poses.poses[:, 2] - path.poses[:, 2] - 2.1)
    assert np.abs(off).max() < 1e-6 + 4.0 * found.sigma
    assert found.noise == pytest.approx(noise, rel=0.1, abs=1e-6)
    # Only where both are.
    later = PoseSeries(path.stamps[200:], path.poses[200:])
    part = headings_by_path(positions, later)
    assert part.poses.stamps[0] == path.stamps[200]


def test_noise_of_the_positions_adds_nothing_to_the_distance() -> None:
    """Those of plain GPS at 1 Hz, by a path of tracks whose radius is 10 % too small."""
    path, rng = drive(), np.random.default_rng(5)
    places = path.poses[::20, :2] + 0.5 * rng.standard_normal((len(STAMPS[::20]), 2))
    positions = PoseSeries(STAMPS[::20], np.column_stack([places, np.zeros(len(places))]))
    found = headings_by_path(positions, PoseSeries(STAMPS, path.poses * (0.9, 0.9, 1.0))).poses
    assert path_length(positions)[-1] > 1.4 * 29.5
    assert path_length(found)[-1] == pytest.approx(29.5, rel=0.05)
    assert drift(path, found, 10.0).distances == pytest.approx(5.0, rel=0.05)


def test_a_robot_that_hardly_moves_shows_no_headings() -> None:
    path = drive()
    small = PoseSeries(STAMPS, path.poses * (0.02, 0.02, 1.0))
    assert headings_by_path(small, small) is None
    rough = 5.0 * np.random.default_rng(4).standard_normal((len(STAMPS), 3))
    assert headings_by_path(PoseSeries(STAMPS, path.poses + rough), path) is None
