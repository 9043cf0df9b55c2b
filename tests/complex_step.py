"""Derivatives of motion models by complex steps, for tests."""

import numpy as np

STEP = 1e-30


def assert_derivatives(model, V_l, V_r, parameters, slip, gravity=(0.0, 0.0)):
    """All derivatives of the twist that a model gives are the complex-step ones."""
    _, by = model.linearise(V_l, V_r, parameters, slip, gravity)
    at = ((V_l, V_r), parameters, slip, gravity)

    def slopes(which):
        """Derivatives (3, n) by the inputs of one kind."""
        columns = []
        for index in range(len(at[which])):
            moved = [np.array(part, dtype=complex) for part in at]
            moved[which][index] += 1j * STEP
            speeds, of_model, of_slip, of_gravity = moved
            twist = model.linearise(*speeds, of_model, tuple(of_slip), tuple(of_gravity))[0].twist
            columns.append([complex(part).imag / STEP for part in twist])
        return np.array(columns).T

    kinds = ("by_speeds", "by_parameters", "by_slip", "by_gravity")
    for which, name in enumerate(kinds):
        wanted = slopes(which)
        scale = 1e-9 * (1.0 + np.abs(wanted).max(axis=0))
        found = np.array(getattr(by, name))
        assert found.shape == wanted.shape
        assert (np.abs(found - wanted) < scale).all(), (name, *at)
