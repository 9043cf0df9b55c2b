"""The traced step of the friction model against the forces of `contact_forces`, written apart from it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.friction import layout as f
from icreckon.estimator.friction.kernel import OneModel
from icreckon.estimator.friction.model import FrictionMotion
from icreckon.estimator.friction.step import LARGEST_PULL
from icreckon.estimator.motion.contact import Contact, ContactGeometry, ground
from icreckon.estimator.motion.contact_forces import (
    COLUMNS,
    PointLoads,
    add_track_forces,
    mass_matrix,
    point_loads,
)
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.motion.motion_model import LEVEL
from icreckon.estimator.robot.robot_file import load_robot

ALPHA = load_robot("auriga-alpha")
LAG, H = 0.3, 0.01


def contact_of(z_CM: float = 0.7, **soil: Any) -> Contact:
    """Contact with uneven points, off-centre, on some soil."""
    geometry = ContactGeometry(
        0.42, (-0.35, -0.1, 0.05, 0.42), weights=(1.0, 2.0, 1.5, 1.0), across=(-0.03, 0.04)
    )
    body = msgspec.structs.replace(ALPHA.contact.body, x_CM=0.01, y_CM=-0.03, z_CM=z_CM)
    return Contact(msgspec.structs.replace(ALPHA.contact.soil, **soil), geometry, body)


CONTACTS = {
    "plain": contact_of(),
    "anisotropic": contact_of(longitudinal_friction=0.6, rolling_resistance=0.06),
    "opposes the track": contact_of(resistance_opposes="track", rolling_resistance=0.06),
    "sheared": contact_of(shear_modulus=0.02),
    "high": contact_of(z_CM=1.6),
    "rolling hard": contact_of(friction=0.2, rolling_resistance=0.5),
}


def model_of(contact: Contact, estimated: Floats | None = None) -> FrictionMotion:
    mask = np.ones(f.PARAMETERS) if estimated is None else estimated
    return FrictionMotion(ALPHA.constants, contact, 7.0, LAG, 2.0, mask)


def moving(
    model: FrictionMotion, state: Floats, gravity: tuple[float, float] = LEVEL
) -> FrictionMotion:
    """A model in the middle of a motion, on ground that has always been as it is."""
    memory = model.memory.copy()
    memory[f.AT_INPUTS][f.PARAMETERS :] = gravity
    memory[f.OF_STATES], memory[f.STARTED] = state, 1.0
    model.recall(memory)
    return model


def padded(parameters: Floats) -> list[float]:
    return [*parameters.tolist(), 0.0, 0.0, 0.0]


def forces_on(model: FrictionMotion, contact: Contact, y: Floats, v: Floats, V: Floats) -> Floats:
    """Force and moment of the ground at loads of the state `y` (5,), and a twist `v` (3,)."""
    at = ground(contact)._replace(small=model.constants["small"])
    loads, right, forward = (np.empty(len(at.x)) for _ in range(3))
    point_loads(at, y[3], y[4], loads, right, forward)
    values, jacobian = np.zeros(3), np.zeros((3, COLUMNS))
    add_track_forces(at, tuple(v), tuple(V), PointLoads(loads, right, forward), values, jacobian)
    return values


STATES = st.tuples(
    *[st.floats(-1.0, 1.0)] * 3, *[st.floats(-0.5 * 9.81 * ALPHA.vehicle.mass, 5e3)] * 2
)
SLOPES = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))


@pytest.mark.parametrize("name", CONTACTS)
@settings(max_examples=60)
@given(state=STATES, V=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), gravity=SLOPES)
def test_a_step_solves_its_equations(
    name: str, state: tuple[float, ...], V: tuple[float, float], gravity: tuple[float, float]
) -> None:
    """Points that lift off and a vehicle that tips are among the states, and ground that is steep."""
    contact = CONTACTS[name]
    model, before, speeds = model_of(contact), np.array(state), np.array(V)
    moving(model, before, gravity).begin_step(H, *V, padded(model.nominal), gravity)
    after = model.memory[f.OF_STATES]
    # Of more gravity than friction holds, what it holds.
    limit = LARGEST_PULL * GRAVITY * min(contact.soil.coefficients)
    gravity = np.array(gravity) * min(1.0, limit / max(1e-9, np.hypot(*gravity)))
    body, (v_x, v_y, w) = contact.body, before[:3]
    A = mass_matrix(body.mass, body.x_CM, body.y_CM, 7.0)
    right = body.mass * (w * (v_y + body.x_CM * w) + gravity[0])
    forward = body.mass * (w * (body.y_CM * w - v_x) + gravity[1])
    pull = np.array([right, forward, body.x_CM * forward - body.y_CM * right])
    F = forces_on(model, contact, before, after[:3], speeds)
    wrong = np.linalg.solve(A, A @ (after[:3] - before[:3]) - H * (F + pull))
    # Newton's last step is below 1e-7; shear has no potential and may leave the iteration where it is.
    assert np.abs(wrong).max() < (1e-6 if name != "sheared" else 1e-2)
    keep = np.exp(-H / LAG)
    np.testing.assert_allclose(
        after[3:], keep * before[3:] - (1.0 - keep) * F[:2], rtol=1e-7, atol=1e-3
    )


def after_step(contact: Contact, state: Floats, at: Floats, V: Floats) -> Floats:
    """State after a step with parameters and gravity that were always these."""
    model = moving(model_of(contact), state)
    memory = model.memory.copy()
    memory[f.AT_INPUTS] = at
    model.recall(memory)
    model.begin_step(H, *V, padded(at[: f.PARAMETERS]), tuple(at[f.PARAMETERS :]))
    return model.memory[f.OF_STATES]


@pytest.mark.parametrize("steepness", [1.0, 10.0], ids=["slope", "too steep"])
@pytest.mark.parametrize("name", CONTACTS)
def test_its_derivatives_are_slopes(name: str, steepness: float) -> None:
    """By each parameter, by gravity, and by the track speeds."""
    contact, step = CONTACTS[name], 1e-5
    rng = np.random.default_rng(1)
    for _ in range(20):
        state = np.concatenate([rng.uniform(-0.6, 0.6, 3), rng.uniform(-300.0, 300.0, 2)])
        speeds, gravity = rng.uniform(-0.8, 0.8, 2), steepness * rng.uniform(-1.5, 1.5, 2)
        inputs = np.concatenate([model_of(contact).nominal, gravity, speeds])
        model = moving(model_of(contact), state, tuple(gravity))
        model.begin_step(H, *speeds, padded(inputs[: f.PARAMETERS]), tuple(gravity))
        S = model.memory[f.OF_SENSITIVITIES].reshape(f.STATES, f.INPUTS)
        B = model.memory[f.OF_SPEEDS].reshape(3, 2)
        for place in range(len(inputs)):
            ends = []
            for sign in (1.0, -1.0):
                moved = inputs.copy()
                moved[place] += sign * step
                ends.append(after_step(contact, state, moved[:-2], moved[-2:]))
            slopes = (ends[0] - ends[1]) / (2.0 * step)
            found = S[:, place] if place < f.INPUTS else B[:, place - f.INPUTS]
            slopes = slopes[: len(found)]
            for part in (slice(0, 3), slice(3, 5)):
                tolerance = 3e-5 * (np.abs(slopes[part]).max(initial=0.0) + 1e-3)
                np.testing.assert_allclose(found[part], slopes[part], rtol=0.0, atol=tolerance)


def test_contact_points_that_are_missing_are_not_read() -> None:
    model = model_of(CONTACTS["plain"])
    one = OneModel(model.constants, model.pairs[1:], sheared=False)
    with pytest.raises(ValueError, match="size"):
        one.step(model.memory, [*model.nominal, *LEVEL], (0.1, 0.2), H)
