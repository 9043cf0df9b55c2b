"""Derivatives of motion models by complex steps, for tests."""

import numpy as np

STEP = 1e-30


def assert_derivatives(model, V_l, V_r, parameters, slip):
    """All derivatives of the twist that a model gives are the complex-step ones."""
    _, by = model.linearise(V_l, V_r, parameters, slip)
    h = 1j * STEP

    def derivative(V_l, V_r, parameters, slip):
        twist = model.linearise(V_l, V_r, parameters, slip)[0].twist
        return [complex(part).imag / STEP for part in twist]

    unit = np.eye(8)
    found = {
        "speeds": by.by_speeds,
        "slip": by.by_slip,
        "parameters": by.by_parameters,
    }
    expected = {
        "speeds": [
            derivative(V_l + h, V_r + 0 * h, parameters, slip),
            derivative(V_l + 0 * h, V_r + h, parameters, slip),
        ],
        "slip": [
            derivative(V_l, V_r, parameters, tuple(np.array(slip) + h * unit[axis, :3]))
            for axis in range(3)
        ],
        "parameters": [
            derivative(V_l, V_r, parameters + h * unit[index], slip) for index in range(8)
        ],
    }
    for name, columns in expected.items():
        wanted = np.array(columns).T
        scale = 1e-9 * (1.0 + np.abs(wanted).max(axis=0))
        assert (np.abs(np.array(found[name]) - wanted) < scale).all(), (name, V_l, V_r, parameters)
