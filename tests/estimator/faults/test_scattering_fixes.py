"""Position fixes that scatter more than stated, and those that do not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import faulty_drives
from fed_estimators import feed_all
from icreckon import FixSpec, Health, Log, PoseFix, Scenario, load_robot, run, simulate
from icreckon.estimator.faults.scattering_fixes import (
    MOST_ALIGNED,
    ScatterRecord,
    TakenFix,
    add_fix,
    expected_residuals,
    wanders,
)
from icreckon.estimator.log.scores import pose_nees
from icreckon.estimator.robot.settings import FixWander, Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

ALPHA = load_robot("auriga-alpha")
SECOND = 1_000_000_000
STATED = 0.05
ONLINE = ["constant-online", "inertia-online"]


def after_fixes(errors, *, path=None, admitted=True, stated=STATED) -> ScatterRecord:
    """Scatter of fixes at 1 Hz with errors (n, 2) on a path (n,) of a filter that they do not correct."""
    n = len(errors)
    sigmas = np.broadcast_to(stated, n)
    path = np.arange(n) * 1.0 + 0j if path is None else path
    yaws = np.angle(np.gradient(path)) if n > 1 else np.zeros(n)
    scatter = ScatterRecord()
    for k, (error, place, yaw) in enumerate(zip(errors, path, yaws, strict=True)):
        used = admitted if isinstance(admitted, bool) else bool(admitted[k])
        at = place.real, place.imag, float(yaw)
        x, y = place.real + error[0], place.imag + error[1]
        # The filter is not corrected with it.
        variance = sigmas[k] ** 2
        taken = TakenFix(k * SECOND, x, y, variance, (0.0, 0.0), (1.0, 0.0, 1.0), at, at, used)
        add_fix(scatter, taken, np.zeros(3))
    return scatter


def noise(sigma: float, n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, sigma, (n, 2))


LINE = np.arange(60) * 1.0 + 0j
CIRCLE = 3.0 * np.exp(1j * np.arange(60) / 3.0)
PATHS = pytest.mark.parametrize("path", [LINE, CIRCLE, 0.0 * LINE], ids=["line", "circle", "rest"])


@PATHS
@pytest.mark.parametrize("sigmas", [(STATED, STATED), (1.2, 0.03), (0.03, 1.2)], ids=str)
def test_a_receiver_that_stays_or_becomes_better_or_worse_as_it_says_does_not_scatter(path, sigmas):
    """RTK begins: older fixes are judged by the variances that they state themselves."""
    stated = np.repeat(sigmas, 30)
    for seed in range(5):
        scatter = after_fixes(noise(1.0, 60, seed) * stated[:, None], path=path, stated=stated)
        assert (scatter.used, scatter.variance) == (0, 0.0)


@PATHS
def test_white_scatter_is_measured(path):
    """After two minutes: with fewer fixes white errors and those that walk are not told apart."""
    path = np.concatenate([path, path + path[-1] - path[0]])
    found = [after_fixes(noise(0.5, 120, seed), path=path) for seed in range(8)]
    # Of some hundred fixes in two dimensions, the variance of one record is off by 10 %.
    assert np.median([one.variance for one in found]) == pytest.approx(0.5**2, rel=0.2)
    assert not any(wanders(one) for one in found)
    assert all(one.used > 100 for one in found)


@PATHS
def test_scatter_that_walks_counts_as_one_fix_in_a_minute(path):
    """A walk of 0.5 m a second is off by 3.9 m after a minute, and 60 fixes share it."""
    found = [after_fixes(np.cumsum(noise(0.5, 60, seed), axis=0), path=path) for seed in range(8)]
    # The square of how far one walk comes is uncertain by itself, the mean of eight by a third of it.
    assert np.mean([one.variance for one in found]) == pytest.approx(0.25 * 60.0 * 60.0, rel=0.33)
    assert np.mean([wanders(one) for one in found]) > 0.8


def test_expected_ratios_are_those_of_many_errors():
    """Von Neumann's ratio of white errors and of walks, laid over a circle, by drawing them."""
    path, rng = CIRCLE[:MOST_ALIGNED], np.random.default_rng(4)
    white = rng.normal(size=(4000, MOST_ALIGNED)) + 1j * rng.normal(size=(4000, MOST_ALIGNED))
    basis, _ = np.linalg.qr(np.column_stack([np.ones(MOST_ALIGNED), path]))
    ratios, sizes = [], []
    for off in (white, np.cumsum(white, axis=1)):
        rest = off - (off @ basis.conj()) @ basis.T
        squares = (np.abs(rest) ** 2).sum()
        ratios.append((np.abs(np.diff(rest)) ** 2).sum() / squares)
        sizes.append(squares / off.size * MOST_ALIGNED / (MOST_ALIGNED - 2) / 2.0)
    of_white, of_walk, walked = expected_residuals(
        after_fixes(np.zeros((MOST_ALIGNED, 2)), path=path)
    )
    assert ratios == pytest.approx([of_white, of_walk], rel=0.03)
    assert sizes == pytest.approx([1.0, walked], rel=0.05)


def test_a_wrong_heading_and_slip_along_the_tracks_are_no_scatter():
    path = np.cumsum(np.exp(1j * np.sin(np.arange(60) / 5.0)))
    turned = 0.8 * path * np.exp(0.4j) + 3.0 - 2.0j
    off = turned - path
    errors = np.column_stack([off.real, off.imag]) + noise(STATED, 60)
    assert after_fixes(errors, path=path).variance == 0.0


@pytest.mark.parametrize("seconds", [4.0, 8.0])
def test_a_robot_that_slides_is_no_scatter(seconds):
    """Downhill by 0.6 m/s for some seconds at a time, while it turns at 0.3 m/s."""
    times, path = np.arange(60.0), 0.3 * CIRCLE
    for seed in range(5):
        slow = np.sin(2.0 * np.pi * times / (2.0 * seconds) + seed)
        slides = np.cumsum(0.6 * np.clip(slow, 0.0, None))
        errors = slides[:, None] * [-0.8, 0.6] + noise(STATED, 60, seed)
        assert all(after_fixes(errors[:k], path=path[:k]).variance == 0.0 for k in range(4, 61))


@PATHS
@pytest.mark.parametrize("angle", [0.0, 0.6, 3.0])
def test_a_jump_of_the_fixes_or_of_the_heading_is_no_scatter(path, angle):
    """The gate rejects the fixes after it, until the filter follows."""
    late = np.arange(60) >= 30
    moved = np.where(late, path * np.exp(1j * angle) + 20.0 - 7.0j, path)
    errors = np.column_stack([(moved - path).real, (moved - path).imag]) + noise(STATED, 60)
    admitted = ~late | (np.arange(60) > 40)
    assert all(
        after_fixes(errors[:k], path=path[:k], admitted=admitted[:k]).variance == 0.0
        for k in range(30, 60)
    )


def test_outliers_are_no_scatter():
    """Neither single ones nor a burst; once most of the newest fixes are off, they scatter."""
    errors, admitted = noise(STATED, 60), np.ones(60, bool)
    for k in (20, 21, 35, 50):
        errors[k] += 8.0
        admitted[k] = False
    assert after_fixes(errors, admitted=admitted).variance == 0.0
    errors[20:32] += noise(8.0, 12)
    admitted[20:32] = False
    assert after_fixes(errors[:25], admitted=admitted[:25]).variance == 0.0
    assert after_fixes(errors[:32], admitted=admitted[:32]).variance > 1.0


def test_scatter_is_forgotten_once_it_is_over():
    errors = noise(STATED, 120)
    errors[:30] += noise(0.5, 30, 2)
    assert after_fixes(errors[:30]).variance > 0.05
    assert after_fixes(errors).variance == 0.0


@cache
def driven(white: float, wander: float = 0.0, *, rate: float = 1.0) -> Log:
    """A drive of two minutes whose fixes state 5 cm."""
    fixes = FixSpec(sigma=white, wander_sigma=wander, wander_time=60.0)
    scenario = Scenario(duration=120.0, seed=8, fix_rate=rate, fixes=fixes)
    log = simulate(scenario, ALPHA)
    stated = np.full_like(log.fixes.variances, STATED**2)
    return replace(log, fixes=replace(log.fixes, variances=stated))


def sigma_of(health: Health) -> float:
    """Sigma that fixes are used with, 0 if that is the stated one [m]."""
    found = health.finding("scattering")
    return 0.0 if found is None or found.size is None else found.size


@pytest.mark.parametrize(("variant", "rate"), [("constant-online", 5.0), ("inertia-online", 1.0)])
def test_a_white_error_of_ten_times_what_fixes_say(variant, rate):
    log = driven(0.5, rate=rate)
    one = run(log, ALPHA, variant)
    nees, (seconds, position, yaw) = (
        pose_nees(one.trajectory, log.truth.poses),
        faulty_drives.errors(one, log),
    )
    assert nees[len(nees) // 2 :].mean() < 10.0
    assert np.sqrt(np.mean(position[seconds > 60.0] ** 2)) < 0.5
    assert np.degrees(np.sqrt(np.mean(yaw[seconds > 60.0] ** 2))) < 4.0
    assert 0.2 < sigma_of(one.health) < 1.5


@pytest.mark.parametrize("variant", ONLINE)
def test_a_wander_that_does_not_scatter_shows_in_the_innovations(variant):
    """An error of 5 m in a minute, of a receiver that states 1 m: from fix to fix it is as it says."""
    log = driven(1.0, 5.0)
    fixes = replace(log.fixes, variances=np.full_like(log.fixes.variances, 1.0))
    health = run(replace(log, fixes=fixes), ALPHA, variant).health
    assert sigma_of(health) == 0.0
    assert health.finding("wandering") is not None
    healthy = run(driven(STATED), ALPHA, variant).health
    assert healthy.finding("wandering") is None
    assert "scattering" not in healthy.times


def test_a_stated_wander_is_not_measured_as_scatter():
    settings, log = Settings(wander=FixWander(5.0, 60.0)), driven(0.05, 5.0)
    assert "scattering" in run(log, ALPHA, "inertia-online").health.times
    assert "scattering" not in run(log, ALPHA, "inertia-online", settings=settings).health.times


def test_a_pose_fix_begins_anew():
    log = driven(0.5)
    estimator = feed_all(PoseEstimator(ALPHA, "constant-online"), log)
    assert sigma_of(estimator.health) > 0.0
    x, y, yaw = estimator.pose
    tight = tuple(tuple(row) for row in (np.eye(3) * 0.01).tolist())
    estimator.feed(PoseFix(estimator.stamp, x, y, yaw, tight))
    assert sigma_of(estimator.health) == 0.0
