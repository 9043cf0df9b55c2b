"""Planar geometry, and the crossing between the paper's axes and REP-103."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from icreckon.estimator.base.frames import (
    arc_factors,
    compose,
    paper_to_rep103,
    quaternion_to_yaw,
    relative,
    rep103_to_paper,
    rpy_to_matrix,
    yaw_to_quaternion,
)

metres = st.floats(-1e3, 1e3)
angles = st.floats(-20.0, 20.0)
poses = st.tuples(metres, metres, angles)


def test_forward_and_left_of_rep103_are_forward_and_minus_right_of_the_paper():
    assert paper_to_rep103(0.0, 1.0) == (1.0, 0.0)
    assert paper_to_rep103(1.0, 0.0) == (0.0, -1.0)
    assert rep103_to_paper(1.0, 0.0) == (0.0, 1.0)
    assert rep103_to_paper(0.0, 1.0) == (-1.0, 0.0)


@given(a=poses, b=poses)
def test_relative_undoes_compose(a, b):
    again = relative(a, compose(a, b))
    assert again[:2] == pytest.approx(b[:2], abs=1e-11)
    assert np.exp(1j * again[2]) == pytest.approx(np.exp(1j * b[2]), abs=1e-12)


def test_compose_by_hand():
    assert compose([1.0, 2.0, np.pi / 2], [3.0, 0.5, 0.25]) == pytest.approx(
        [0.5, 5.0, np.pi / 2 + 0.25]
    )


@given(yaw=st.floats(-3.14, 3.14))
def test_yaw_comes_back_from_its_quaternion(yaw):
    assert quaternion_to_yaw(yaw_to_quaternion(yaw)) == pytest.approx(yaw, abs=1e-14)


def test_yaw_of_tilted_quaternions_is_the_yaw_of_roll_pitch_yaw():
    rng = np.random.default_rng(2)
    rpy = rng.uniform([-3.0, -1.5, -3.1], [3.0, 1.5, 3.1], (200, 3))
    quaternions = Rotation.from_euler("xyz", rpy).as_quat()
    assert quaternion_to_yaw(quaternions) == pytest.approx(rpy[:, 2], abs=1e-12)


def test_roll_pitch_yaw_are_about_fixed_axes():
    for rpy in np.random.default_rng(3).uniform(-np.pi, np.pi, (50, 3)):
        expected = Rotation.from_euler("xyz", rpy).as_matrix()
        assert rpy_to_matrix(*rpy) == pytest.approx(expected, abs=1e-14)


def test_arc_factors_are_the_chord_of_the_arc():
    # A quarter circle of radius one ends at (1, 1).
    a, b = arc_factors(np.pi / 2)
    assert np.array([a, b]) * np.pi / 2 == pytest.approx([1.0, 1.0])
    assert arc_factors(0.0) == (1.0, 0.0)


@pytest.mark.parametrize("angle", [1e-12, 1e-6, 0.99999e-4, 1.00001e-4, 1e-3, 0.1, 3.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_arc_factors_are_exact_on_both_sides_of_the_switch_to_the_series(angle, sign):
    angle = sign * angle
    a, b = arc_factors(angle)
    assert a == pytest.approx(np.sinc(angle / np.pi), rel=1e-15)
    # 1 - cos(a) loses 1e-16 of 1, which dividing by the smallest angle makes 1e-12.
    assert b == pytest.approx(np.sin(angle / 2) * np.sinc(angle / (2 * np.pi)), abs=2e-12)
