"""The factor on the slip follows position fixes: not single ones, but where they all point."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from faulty_drives import errors, rotated
from icreckon import Patch, Robot, Scenario, run, simulate
from icreckon.estimator.filter.slip_factor import (
    FACTOR_WEIGHT,
    LARGEST_FACTOR,
    MEMORY,
    TREND_WEIGHT,
    normalised,
    present_factor_after,
    slip_factor_after,
    trend_after,
)

VALUES = st.floats(-3.0, 3.0)
NEW = (0.0, 0.0, 1.0)


@given(z=st.tuples(VALUES, VALUES), root=st.tuples(VALUES, VALUES, VALUES), yaw=VALUES)
def test_a_trend_is_normalised_by_the_covariance(z, root, yaw) -> None:
    """The squares of the normalised innovation's components add up to its NIS."""
    factor = np.array([[1.0 + abs(root[0]), 0.0], [root[1], 0.5 + abs(root[2])]])
    S = factor @ factor.T
    heading = math.cos(yaw), math.sin(yaw)
    trend = trend_after(NEW, *normalised(z, (S[0, 0], S[0, 1], S[1, 1]), heading))
    nis = np.array(z) @ np.linalg.solve(S, np.array(z))
    assert np.hypot(*trend[:2]) == pytest.approx(TREND_WEIGHT * math.sqrt(nis), rel=1e-9)
    # In axes that are turned with the robot it is the same.
    turned, by = rotated(-yaw) @ z, rotated(-yaw) @ S @ rotated(-yaw).T
    same = trend_after(NEW, *normalised(tuple(turned), (by[0, 0], by[0, 1], by[1, 1]), (1.0, 0.0)))
    assert trend == pytest.approx(same, abs=1e-9)


def factors_of(innovations: np.ndarray, factor: float = 1.0) -> tuple[float, float]:
    """Factor on the slip, and that of the newest fixes alone, of a robot that moves.

    The innovations (n, 2) are normalised.
    """
    trend, present = NEW, factor
    for z in innovations.tolist():
        trend = trend_after(trend, *normalised(tuple(z), (1.0, 0.0, 1.0), (1.0, 0.0)))
        present = present_factor_after(present, trend, 0.5, 0.5)
        factor = slip_factor_after(factor, present, 0.5, 0.5)
    return factor, present


def test_white_innovations_leave_the_factor_at_one() -> None:
    rng = np.random.default_rng(1)
    factors = np.array([factors_of(rng.standard_normal((300, 2))) for _ in range(200)])
    assert (factors.mean(axis=0) < (1.6, 1.25)).all()
    off = [factors_of(rng.standard_normal((300, 2)) + np.array([0.8, 0.0])) for _ in range(20)]
    assert np.min(off) > 3.0


def test_small_errors_to_one_side_are_the_fixes_own() -> None:
    """Plain GPS wanders within the size that it states."""
    rng = np.random.default_rng(1)
    wandering = [
        factors_of(0.3 * rng.standard_normal((300, 2)) + np.array([0.4, 0.0])) for _ in range(20)
    ]
    assert np.max(wandering) < 1.2


def test_the_factor_is_bounded_slow_and_rests_with_the_robot() -> None:
    far = 4.0 * np.ones((1000, 2))
    assert factors_of(far) == (LARGEST_FACTOR, LARGEST_FACTOR)
    assert max(factors_of(far[:1])) < 1.0 + 0.5 * 10.0 * FACTOR_WEIGHT
    assert present_factor_after(3.0, (2.0, 2.0, 1.0), 0.0, 0.0) == pytest.approx(3.0)
    assert slip_factor_after(3.0, 1.0, 0.0, 0.0) == 3.0


def test_ground_that_was_met_is_remembered() -> None:
    """Other ground is forgotten at once by the newest fixes, and in some minutes by the filter."""
    factor, present = factors_of(np.zeros((120, 2)), factor=6.0)
    assert present == 1.0
    assert factor == pytest.approx(1.0 + 5.0 * math.exp(-120.0 / MEMORY), rel=0.05)
    assert factors_of(np.zeros((2000, 2)), factor=6.0)[0] < 1.01


# Ice and mud in turn, 20 s each: fixes are rejected at each change.
EXTREME = tuple(
    Patch(time=(20.0 * k, 20.0 * (k + 1)), friction=friction, rolling_resistance=rolling)
    for k, (friction, rolling) in enumerate(((0.4, 0.15), (0.9, 0.02)) * 4)
)


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_ground_that_changes_is_not_taken_for_a_bias(variant: str, robot: Robot) -> None:
    """Yaw was 6 and 26 degrees off when any rejected fixes made the bias uncertain."""
    off = []
    for seed in range(2):
        log = simulate(Scenario(duration=100.0, seed=seed, patches=EXTREME), robot)
        off.append(errors(run(log, robot, variant), log)[2][2000:])
    assert np.sqrt(np.mean(np.square(np.concatenate(off)))) < math.radians(2.0)
