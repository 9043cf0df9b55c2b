"""Compiled motion models are those of the textbook, within the limits of the indices and beyond."""

import numpy as np
import pytest

from icreckon import PoseEstimator, load_robot
from icreckon.estimator.base import state
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.robot.variants import find_variant, initial_parameters, motion_model

ALPHA = load_robot("auriga-alpha")
ROUNDING = 1e-12
# eta2 [1/N²] is a very small number.
UNITS = np.ones(state.SIZE)
UNITS[state.ETA2] = 1e-5
WEIGHT = ALPHA.constants.mass * 9.81
NASTY = [
    (0.0, 0.0), (0.5, 0.5), (-0.5, -0.5), (0.7, -0.7), (-0.7, 0.7), (0.0, 0.8), (0.8, 0.0),
    (-1e-300, 1e-300), (0.5, 0.5 + 1e-9), (1e-13, -1e-13),
    # Beyond the table of the friction model, and of anything that drives.
    (9.0, -3.0), (-40.0, 55.0),
]  # fmt: skip


def points():
    rng = np.random.default_rng(1)
    for V_l, V_r in [*rng.uniform(-1.2, 1.2, (20, 2)).tolist(), *NASTY]:
        slip = tuple(rng.normal(scale=0.1, size=3).tolist())
        yield V_l, V_r, rng.uniform(0.7, 1.3, 9), slip
        yield V_l, V_r, np.ones(9), (0.0, 0.0, 0.0)
        # From no real vehicle: everything held at its limit.
        yield V_l, V_r, rng.uniform(-30.0, 30.0, 9), slip


def assert_same(found, expected, rel=ROUNDING):
    for one, other in zip(flat(found), flat(expected), strict=True):
        assert one == pytest.approx(other, rel=rel, abs=1e-13)


def flat(result):
    if isinstance(result, tuple | list):
        return [number for part in result for number in flat(part)]
    return [result]


def ekfs(variant):
    """The textbook's filter and a compiled one, of one motion model each."""
    compiled = PoseEstimator(ALPHA, variant.name)._reckoning.ekf
    return IcrEkf(motion_model(ALPHA, variant)), compiled


def put_on_a_slope(ekf, number):
    """Slopes of up to more than anything drives on or than there are, and tracks of unlike radii."""
    factor = 15.0 if number % 6 == 5 else 1.0
    ekf.x[state.GRAVITY] = factor * np.array([0.7 * (number % 5) - 1.0, 3.0 - 0.9 * (number % 7)])
    ekf.x[state.TRACK_SCALE] = 0.01 * (number % 3)
    ekf.x[state.TRACK_DIFFERENCE] = 0.02 * (number % 4) - 0.03


def assert_same_twist(plain, compiled, left, right, slip_shares, rel=ROUNDING):
    expected = plain.twist_model(left, right, slip_shares)
    found = compiled.evaluation(compiled, left, right, slip_shares)
    if np.abs(flat(expected.motion)).max() < 1e9:
        assert_same(found.motion, expected.motion, rel)
        assert found.twist == pytest.approx(expected.twist, rel=rel, abs=1e-13)
        of_unit, expected_of_unit = found.jacobian * UNITS, expected.jacobian * UNITS
        assert of_unit == pytest.approx(expected_of_unit, rel=10.0 * rel, abs=1e-13)
        assert found.by_speeds == pytest.approx(expected.by_speeds, rel=rel, abs=1e-13)
    return expected


@pytest.mark.parametrize("name", ["inertia-online", "full-linear"])
def test_explicit_models_are_the_same_compiled(name):
    variant = find_variant(name)
    plain, compiled = ekfs(variant)
    start = initial_parameters(ALPHA, variant)
    held = 0
    for number, (V_l, V_r, factors, slip) in enumerate(points()):
        for ekf in (plain, compiled):
            ekf.x[state.PARAMETERS] = start * factors
            ekf.x[state.SLIP], ekf.x[state.FAST_SLIP] = slip, slip[::-1]
            put_on_a_slope(ekf, number)
        # The forces lag behind a motion at other speeds.
        plain.begin_step(0.2 * (1 + number % 4), V_r, 0.3 * V_l)
        compiled.model.recall(plain.model.memory)
        expected = assert_same_twist(
            plain, compiled, V_l, V_r, (0.9, 0.8, 0.5 + 0.25 * (number % 3))
        )
        held += abs(expected.motion.u) > WEIGHT
    assert held > 10 or name == "full-linear"
