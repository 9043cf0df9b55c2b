"""Derivatives of the calibration's friction model, where Newton's iteration misses a motion, too."""

from __future__ import annotations

import numpy as np
import pytest

from icreckon.estimator.calibration.models import model_of
from icreckon.estimator.motion.steady_state import solve_steady
from icreckon.estimator.robot.robot_file import changed_robot, load_robot

# Motions of a real log that Newton's iteration from those of the robot file does not reach.
SPEEDS = np.array([[1.88530466, 2.58841055], [0.70170963, 1.63572257], [0.92253741, 1.76256438]])
VALUES = np.array([0.02, 0.4128, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("length", [0.2, 0.45, 1.0])
def test_derivatives_do_not_depend_on_the_start(length: float) -> None:
    """A missed motion made derivatives far too large, and standard errors too small."""
    robot = changed_robot(
        load_robot("warthog"),
        {
            "vehicle.half_contact_length": length,
            "vehicle.track_gauge": 1.1652,
            "vehicle.centre_of_mass": [0.0, 0.0, 0.0],
            "soil": {"friction": 0.9, "regularising_speed": 1e-4},
        },
    )
    model = model_of("friction", robot)
    found = model.at(SPEEDS[:, None], VALUES, np.zeros((len(SPEEDS), 1, 2)))

    def by_continuation(values: np.ndarray) -> np.ndarray:
        contact = model.put_into(robot, values).contact
        twist = solve_steady(SPEEDS[:, 0], SPEEDS[:, 1], contact).twist
        return np.stack([twist.v_y, -twist.v_x, twist.w], axis=-1)

    np.testing.assert_allclose(found.twist[:, 0], by_continuation(VALUES), atol=1e-6)
    for place, parameter in enumerate(model.parameters[:2]):
        step = np.zeros(len(VALUES))
        step[place] = 1e-4
        slope = (by_continuation(VALUES + step) - by_continuation(VALUES - step)) / 2e-4
        by_model = found.by_parameters[:, 0, :, place]
        np.testing.assert_allclose(by_model, slope, atol=0.05, err_msg=parameter.name)
