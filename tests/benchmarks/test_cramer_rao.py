"""The Cramér-Rao bound: with one motion it is the covariance along it, with several it is below."""

import numpy as np
import pytest
from analysis.cramer_rao import bound_terms, in_axes_of_robot, posterior_bound
from analysis.linearised import LinearisedModel, Sensors, stepped

from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import find_variant

ALPHA = load_robot("auriga-alpha")
VARIANT = find_variant("inertia-online")
SENSORS = Sensors(gyro=True, accelerometer=True, position_sigma=0.05)
DT = 0.05
SPEEDS = 0.5 + 0.2 * np.sin(np.arange(120) * DT)[:, None] * [-1.0, 1.0]
START_SIGMA = (0.05, 0.05, 0.02)


def motion(change=0.0, speeds=SPEEDS):
    """Steps, yaws, sigmas and covariances along a motion whose eta0 differs."""
    model = LinearisedModel(ALPHA, VARIANT, SENSORS, DT)
    sigmas = model.sigmas.copy()
    sigmas[s.POSE] = START_SIGMA
    x, P = model.start.copy(), np.diag(sigmas**2)
    x[s.ETA0] += change
    steps, yaws, covariances = [], [0.0], []
    for left, right in speeds.tolist():
        model.begin(x, left, right)
        after = x.copy()
        after[s.YAW] += model.twist_model(x, left, right).twist[2] * DT
        steps.append(model.step(x, left, right, after))
        P = stepped(P, steps[-1])
        x = after
        yaws.append(x[s.YAW])
        covariances.append(in_axes_of_robot(P, x[s.YAW]))
    return steps, np.array(yaws), sigmas, np.array(covariances)


def test_of_one_motion_it_is_the_covariance_along_it():
    steps, yaws, sigmas, covariances = motion()
    terms = bound_terms(steps, yaws, sigmas)
    bounds = posterior_bound(terms, sigmas)
    expected = covariances[:, terms.states[:, None], terms.states]
    # What is added to the noise, and to the slip that starts from none, is a share of 1e-5 of each unit.
    unit = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    error = (bounds - expected) / (unit[:, :, None] * unit[:, None, :])
    assert np.abs(error[5:]).max() < 1e-3


def test_of_several_motions_it_is_no_larger_than_their_mean_covariance():
    found = [motion(change) for change in (-0.4, 0.0, 0.4)]
    sigmas = found[0][2]
    first, *others = (bound_terms(steps, yaws, sigmas) for steps, yaws, _, _ in found)
    terms = first
    for one in others:
        terms = terms + one
    assert terms.count == 3
    bound = posterior_bound(terms, sigmas)[-1]
    mean = np.mean([covariances[-1] for *_, covariances in found], axis=0)
    gap = mean[np.ix_(terms.states, terms.states)] - bound
    unit = sigmas[terms.states].clip(1e-3)
    assert np.linalg.eigvalsh(gap / np.outer(unit, unit))[0] > -1e-6


def test_terms_of_different_lengths_do_not_add_up():
    steps, yaws, sigmas, _ = motion(speeds=SPEEDS[:10])
    long, short = bound_terms(steps, yaws, sigmas), bound_terms(steps[:9], yaws[:10], sigmas)
    with pytest.raises(EstimatorError, match="same states and steps"):
        long + short
