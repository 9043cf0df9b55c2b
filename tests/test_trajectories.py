import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.robot import load_robot
from simulation.errors import SimulationError
from simulation.trajectories import (
    ACCELERATION,
    STANDSTILL,
    TRAJECTORIES,
    aggressive,
    figure_eight,
    make_trajectory,
    spin,
)

ALPHA = load_robot("auriga-alpha")


def robot_with_top_speed(top):
    vehicle = msgspec.structs.replace(ALPHA.vehicle, max_track_speed=top)
    return msgspec.structs.replace(ALPHA, vehicle=vehicle)


@settings(deadline=None, max_examples=80)
@given(
    name=st.sampled_from(sorted(TRAJECTORIES)),
    seed=st.integers(0, 2**32),
    top=st.floats(0.2, 4.0),
    duration=st.floats(0.5, 120.0),
)
def test_every_trajectory_keeps_its_limits(name, seed, top, duration):
    command = make_trajectory(
        name, duration, robot_with_top_speed(top), np.random.default_rng(seed)
    )
    step = 0.005
    times = np.arange(0.0, duration, step)
    speeds = command(times)
    assert speeds.shape == (len(times), 2)
    assert np.abs(speeds).max() <= top * (1.0 + 1e-12)
    assert (speeds[times <= STANDSTILL] == 0.0).all()
    rates = np.diff(speeds, axis=0) / step
    if len(rates):
        assert np.abs(rates).max() <= ACCELERATION * (1.0 + 1e-9)
    if len(rates) > 1:
        # Acceleration is continuous: a quintic blend has |jerk| <= 5.78 change / length², and no
        # blend is shorter than 0.2 s.
        assert np.abs(np.diff(rates, axis=0)).max() <= 20.0 * step


@pytest.mark.parametrize("name", sorted(TRAJECTORIES))
def test_every_trajectory_drives_and_does_not_depend_on_sampling(name):
    command = make_trajectory(name, 60.0, ALPHA, np.random.default_rng(3))
    coarse, fine = np.arange(0.0, 60.0, 0.5), np.arange(0.0, 60.0, 0.125)
    assert np.array_equal(command(coarse), command(fine)[::4])
    assert np.abs(command(fine)).max() > 0.3


@pytest.mark.parametrize("name", ["random", "aggressive"])
def test_random_trajectories_follow_their_seed(name):
    times = np.arange(0.0, 60.0, 0.1)

    def speeds(seed, duration=60.0):
        return make_trajectory(name, duration, ALPHA, np.random.default_rng(seed))(times)

    assert np.array_equal(speeds(1), speeds(1))
    assert not np.array_equal(speeds(1), speeds(2))
    assert np.array_equal(speeds(1), speeds(1, duration=200.0))


def test_random_is_forward_mostly_and_aggressive_is_everywhere():
    times = np.arange(STANDSTILL, 2000.0, 0.1)
    everyday = make_trajectory("random", 2000.0, ALPHA, np.random.default_rng(5))(times)
    assert (everyday.mean(axis=1) > 0.05).mean() > 0.75
    assert (everyday.mean(axis=1) < -0.05).any()
    wild = aggressive(2000.0, ALPHA, np.random.default_rng(5))(times)
    assert (wild.min(axis=0) < -0.95).all()
    assert (wild.max(axis=0) > 0.95).all()
    assert (np.abs(wild.mean(axis=0)) < 0.1).all()


def test_spin_has_the_on_spot_ratio():
    rng = np.random.default_rng(0)
    left, right = spin(20.0, ALPHA, rng)(np.array([15.0]))[0]
    assert left / right == pytest.approx(-ALPHA.indices.H)
    left, right = spin(20.0, ALPHA, rng, ratio=2.0)(np.array([15.0]))[0]
    assert left / right == pytest.approx(-2.0)
    assert left == pytest.approx(-0.6 * ALPHA.vehicle.max_track_speed)


def test_figure_eight_turns_full_circles_for_constant_indices():
    command = figure_eight(200.0, ALPHA, np.random.default_rng(0))
    times = np.arange(0.0, 200.0, 0.001)
    left, right = command(times).T
    effective_gauge = ALPHA.vehicle.track_gauge * ALPHA.indices.eta0
    heading = np.cumsum(right - left) * 0.001 / effective_gauge
    turns = np.flatnonzero(np.diff(np.sign(right - left)[times > 5.0])) + np.sum(times <= 5.0)
    lobes = np.diff(heading[turns])
    assert len(lobes) >= 4
    assert np.abs(lobes) == pytest.approx(2.0 * np.pi, rel=1e-3)
    assert (np.sign(lobes[1:]) == -np.sign(lobes[:-1])).all()


def test_unknown_name_says_which_is_nearest():
    with pytest.raises(SimulationError, match="did you mean 'figure-eight'"):
        make_trajectory("figure-eigth", 10.0, ALPHA, np.random.default_rng(0))
