"""The friction motion model: its steps, its derivatives, and what it says to a filter."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from complex_step import assert_derivatives
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.friction import layout as f
from icreckon.estimator.friction.model import FrictionMotion
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.motion.motion_model import LEVEL, NO_SLIP
from icreckon.estimator.motion.steady_state import solve_steady
from icreckon.estimator.robot.robot_file import Robot, load_robot

ALPHA = load_robot("auriga-alpha")
ALL = np.ones(f.PARAMETERS)
DT = 0.02


def model_of(robot: Robot = ALPHA, estimated: Floats = ALL) -> FrictionMotion:
    return FrictionMotion(
        robot.constants, robot.contact, robot.yaw_inertia, robot.vehicle.load_lag, 2.0, estimated
    )


def wild(seconds: float) -> NDArray[np.float64]:
    """Track speeds (n, 2) that jump, reverse and rest."""
    t = np.arange(round(seconds / DT)) * DT
    left = 0.5 * np.sin(t) + 0.3 * np.sign(np.sin(3.0 * t))
    right = 0.6 * np.cos(1.3 * t)
    resting = (t % 4.0) > 3.5
    return np.stack([np.where(resting, 0.0, left), np.where(resting, 0.0, right)], axis=-1)


def padded(parameters: Floats) -> list[float]:
    return [*parameters.tolist(), 0.0, 0.0, 0.0]


def driven(
    model: FrictionMotion,
    speeds: Floats,
    parameters: Floats,
    dt: float = DT,
    gravity: tuple[float, float] = LEVEL,
) -> Floats:
    """Memories (n, MEMORY) after each step."""
    memories = []
    for V_l, V_r in speeds:
        model.begin_step(dt, V_l, V_r, padded(parameters), gravity)
        memories.append(model.memory)
    return np.array(memories)


def test_at_constant_speeds_it_settles_where_the_stationary_solver_says() -> None:
    for V_l, V_r in ((0.3, 0.8), (0.9, 0.4), (-0.2, 0.5), (-0.4, 0.1), (0.2, 0.7)):
        model = model_of()
        twist = driven(model, np.tile([V_l, V_r], (300, 1)), model.nominal)[-1, :3]
        steady = solve_steady(np.array([V_l]), np.array([V_r]), ALPHA.contact)
        wanted = np.array([part[0] for part in steady.twist])
        # What is left is the larger regularising speed.
        np.testing.assert_allclose(twist, wanted, atol=6e-3)


def test_the_first_step_settles() -> None:
    model = model_of()
    first = driven(model, np.array([[0.3, 0.6]]), model.nominal)[-1]
    later = driven(model, np.tile([0.3, 0.6], (200, 1)), model.nominal)[-1]
    np.testing.assert_allclose(first[:3], later[:3], atol=2e-3)


@pytest.mark.parametrize("level", [True, False], ids=["level", "slope"])
@pytest.mark.parametrize("place", range(f.INPUTS))
def test_sensitivities_are_the_slopes_of_the_motion(place: int, level: bool) -> None:
    """By parameters and by gravity, on ground that has always been as it is."""
    gravity = LEVEL if level else (0.8, -0.5)
    at = np.array([*model_of().nominal * 1.05, *gravity])
    speeds = wild(12.0)
    found = along(at, speeds)[:, f.OF_SENSITIVITIES].reshape(-1, f.STATES, f.INPUTS)
    step = 2e-7
    ends = []
    for sign in (1.0, -1.0):
        moved = at.copy()
        moved[place] += sign * step
        ends.append(along(moved, speeds)[:, f.OF_STATES])
    slopes = (ends[0] - ends[1]) / (2.0 * step)
    scale = np.abs(slopes).max(axis=0)
    assert np.all(scale[:3] > 0.05), "or there is nothing to see here"
    np.testing.assert_allclose(found[:, :, place] / scale, slopes / scale, atol=1e-6)


def model_at(parameters: Floats, gravity: tuple[float, float] = LEVEL) -> FrictionMotion:
    """A model that has known its parameters and gravity from the start."""
    model = model_of()
    memory = model.memory.copy()
    memory[f.AT_INPUTS] = [*parameters, *gravity]
    model.recall(memory)
    return model


def along(inputs: Floats, speeds: Floats) -> Floats:
    """Memories of a model that has known its inputs from the start."""
    parameters, (right, forward) = inputs[: f.PARAMETERS], inputs[f.PARAMETERS :].tolist()
    model = model_at(parameters, (right, forward))
    return driven(model, speeds, parameters, gravity=(right, forward))


def test_the_last_speeds_act_as_their_derivatives_say() -> None:
    speeds, step = wild(7.0), 1e-6
    model = model_of()
    found = driven(model, speeds, model.nominal)[-1, f.OF_SPEEDS].reshape(3, 2)
    for side in range(2):
        ends = []
        for sign in (1.0, -1.0):
            moved = speeds.copy()
            moved[-1, side] += sign * step
            again = model_of()
            ends.append(driven(again, moved, again.nominal)[-1, :3])
        np.testing.assert_allclose(found[:, side], (ends[0] - ends[1]) / (2.0 * step), atol=1e-7)


def test_what_is_learnt_on_the_way_changes_the_motion_as_if_it_had_been_known() -> None:
    speeds = wild(6.0)
    known, learning = model_of(), model_of()
    better = known.nominal * np.array([1.0, 1.01, 1.003, 1.0, 1.02, 1.002])
    last = driven(model_at(better), speeds, better)[-1]
    before = driven(learning, speeds, known.nominal)[-1]
    learning.begin_step(1e-9, *speeds[-1], padded(better), LEVEL)
    moved = np.abs(last[:3] - before[:3])
    left = np.abs(last[:3] - learning.memory[:3])
    assert moved.max() > 1e-3
    assert left.max() < 0.05 * moved.max()


def test_linearise_has_the_derivatives_of_its_twist() -> None:
    model = model_of()
    driven(model, wild(5.3), model.nominal, gravity=(0.4, -0.3))
    p = np.array(padded(model.nominal * 1.01))
    assert_derivatives(model, 0.31, 0.52, p, NO_SLIP, (0.5, -0.2))


def test_parameters_that_are_not_learnt_have_no_derivatives() -> None:
    some = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.0])
    one, other = model_of(estimated=some), model_of()
    mine = driven(one, wild(4.0), one.nominal)
    full = driven(other, wild(4.0), other.nominal)
    S, all_S = (m[:, f.OF_SENSITIVITIES].reshape(-1, f.STATES, f.INPUTS) for m in (mine, full))
    left_out = np.append(some == 0.0, [False, False])
    assert not S[:, :, left_out].any()
    np.testing.assert_array_equal(S[:, :, ~left_out], all_S[:, :, ~left_out])
    assert S[:, :3, f.PARAMETERS :].any()
    np.testing.assert_array_equal(mine[:, f.OF_STATES], full[:, f.OF_STATES])


def test_a_mirrored_vehicle_moves_mirrored() -> None:
    x, y, z = ALPHA.vehicle.centre_of_mass
    vehicle = msgspec.structs.replace(ALPHA.vehicle, centre_of_mass=(x, -y, z))
    mirrored = model_of(msgspec.structs.replace(ALPHA, vehicle=vehicle))
    model, speeds = model_of(), wild(9.0)
    one = driven(model, speeds, model.nominal, gravity=(0.6, 0.9))[:, :3]
    other = driven(mirrored, speeds[:, ::-1], mirrored.nominal, gravity=(-0.6, 0.9))[:, :3]
    np.testing.assert_allclose(one * [-1.0, 1.0, -1.0], other, atol=1e-9)


def test_halving_the_step_changes_little_and_ever_less() -> None:
    """First order, as the scheme is."""
    t = np.arange(0.0, 8.0, 0.0025)
    fine = np.stack([0.5 + 0.3 * np.sin(2.0 * t), 0.5 + 0.3 * np.cos(1.7 * t)], axis=-1)
    ends = []
    for every in (8, 4, 2, 1):
        # Steps of 2.5 to 10 ms are not divided further, and 20 ms are two of 10.
        speeds = fine[every - 1 :: every]
        model = model_of()
        twists = driven(model, speeds, model.nominal, 0.0025 * every)[:, :3]
        ends.append(
            twists[:: 8 // every][1:] if every == 8 else twists[8 // every - 1 :: 8 // every][1:]
        )
    errors = [np.abs(end - ends[-1]).mean() for end in ends[1:3]]
    assert errors[0] < 5e-3
    assert errors[1] < 0.5 * errors[0]


def test_it_stands_where_its_tracks_stand() -> None:
    model = model_of()
    driven(model, wild(3.0), model.nominal)
    at_rest = driven(model, np.zeros((150, 2)), model.nominal)[-1]
    assert np.abs(at_rest[:3]).max() < 1e-6
    S = at_rest[f.OF_SENSITIVITIES].reshape(f.STATES, f.INPUTS)
    assert np.abs(S[:3, : f.PARAMETERS]).max() < 1e-4
    # Gravity makes it creep, as far as friction is regularised.
    creep = f.REGULARISING_SPEED / (ALPHA.contact.soil.friction * GRAVITY)
    assert np.abs(S[:3, f.PARAMETERS :]).max() == pytest.approx(creep, rel=0.01)


def test_it_stands_on_a_slope() -> None:
    model, gravity = model_of(), (1.5, -2.0)
    at_rest = driven(model, np.zeros((300, 2)), model.nominal, gravity=gravity)[-1]
    creep = f.REGULARISING_SPEED / (ALPHA.contact.soil.friction * GRAVITY)
    np.testing.assert_allclose(at_rest[:2], np.array(gravity) * creep, rtol=0.2)
    assert abs(at_rest[2]) < 1e-4


def test_going_back_in_memory_repeats_the_motion_to_the_last_bit() -> None:
    model, speeds = model_of(), wild(6.0)
    driven(model, speeds[:100], model.nominal)
    kept = model.memory
    copy = kept.copy()
    once = driven(model, speeds[100:], model.nominal)
    np.testing.assert_array_equal(kept, copy)
    model.recall(kept)
    np.testing.assert_array_equal(driven(model, speeds[100:], model.nominal), once)


def test_another_model_s_memory_is_refused() -> None:
    with pytest.raises(ValueError, match="another's"):
        model_of().recall(np.zeros(3))


@settings(max_examples=60)
@given(
    speeds=st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)), min_size=2, max_size=20),
    dt=st.sampled_from([1e-6, 1e-3, 0.01, 0.1, 1.0, 30.0]),
    factors=st.tuples(*[st.floats(0.3, 2.0)] * f.PARAMETERS),
    slope=st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0)),
    level=st.booleans(),
)
def test_no_input_makes_it_leave_what_tracks_can_do(
    speeds: list[tuple[float, float]],
    dt: float,
    factors: tuple[float, ...],
    slope: tuple[float, float],
    level: bool,
) -> None:
    """The body never moves faster than its tracks could drag it, whatever the step.

    On a slope that friction hardly holds, spinning tracks let it slide, but not without end.
    """
    model, gravity = model_of(), LEVEL if level else slope
    parameters = model.nominal * factors
    model = model_at(parameters, gravity)
    memories = driven(model, np.array(speeds), parameters, dt, gravity)
    assert np.isfinite(memories).all()
    assert np.abs(memories[:, :2]).max() < (3.0 if level else 12.0)
    assert np.abs(memories[:, 2]).max() < 4.0 / ALPHA.vehicle.track_gauge


def test_bounds_hold_the_nominal_vehicle() -> None:
    model = model_of()
    rows = model.bounds
    assert np.all(rows[:, :-1] @ padded(model.nominal) > rows[:, -1])
