"""What the state at the newest step says of a stamp a little later, of which the IMU has yet to tell.

A fix or body velocity between two IMU samples must not end the step: the pose would go there by the
track speeds alone, and since the IMU moves no pose, the next sample could not take back what was slip.
So such a measurement is set against what the present state foretells of its time, and corrects the state
where it stands. Until then the robot is taken to move as it does now, but for a new fast slip, of which
nothing is known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.motion_model import TwistModel
from icreckon.estimator.motion.propagation import step_on_se2
from icreckon.estimator.sensors.sensor_models import Reading, shift


class Foretold(NamedTuple):
    """Three numbers that are to be measured: a pose, or a twist.

    Attributes:
        values: (3,) x, y [m], yaw [rad] or v_x, v_y [m/s], w [rad/s].
        by_state: (3, SIZE) their derivative by the present state.
        covariance: (3, 3) of what the state does not tell of them.
    """

    values: Floats
    by_state: Floats
    covariance: Floats


class Surprise(NamedTuple):
    """Numbers that were measured together against what was foretold of them.

    Attributes:
        residual: (n,) measured less foretold.
        spread: (n, n) covariance that it should have.
        nis: normalised innovation squared, chi-square with n degrees of freedom.
    """

    residual: Floats
    spread: Floats
    nis: float


def pose_now(x: Floats) -> Foretold:
    """The pose of a state (SIZE,)."""
    return Foretold(x[s.POSE].copy(), np.eye(s.SIZE)[s.POSE], np.zeros((3, 3)))


def pose_ahead(x: Floats, model: TwistModel, density: Floats, elapsed: float) -> Foretold:
    """The pose a little later.

    Args:
        x: (SIZE,) the state.
        model: the twist there.
        density: (3, 3) of the fast slip, see `estimator.filter.process_noise`.
        elapsed: how much later [s].
    """
    twist, jacobian = _without_fast_slip(x, model)
    step, by_yaw, by_motion = step_on_se2(x.item(s.YAW), (twist * elapsed).tolist())
    turned = np.array(by_motion)
    by_state = turned @ jacobian * elapsed
    by_state[s.POSE, s.POSE] += np.eye(3)
    by_state[s.POSITION, s.YAW] += by_yaw
    return Foretold(x[s.POSE] + step, by_state, turned @ density @ turned.T * elapsed)


def twist_ahead(x: Floats, model: TwistModel, density: Floats, interval: float) -> Foretold:
    """The twist of the next step.

    Args:
        x: (SIZE,) the state.
        model: the twist there.
        density: (3, 3) of the fast slip, see `estimator.filter.process_noise`.
        interval: how long the next step will be [s].
    """
    return Foretold(*_without_fast_slip(x, model), density / interval)


def component(
    axis: int, value: float, variance: float, foretold: Foretold, foretold_at: Floats, x: Floats
) -> Reading:
    """One of the three, measured; a yaw's residual is not wrapped.

    Args:
        axis: which one, 0 to 2.
        value: what it is measured to be [m], [rad], [m/s] or [rad/s].
        variance: of the measurement.
        foretold: all three.
        foretold_at: (SIZE,) the state that they were foretold at.
        x: (SIZE,) the state.
    """
    row = foretold.by_state[axis]
    residual = value - foretold.values.item(axis) - shift(row, x, foretold_at)
    return Reading(residual, row, variance + foretold.covariance.item(axis, axis))


def _without_fast_slip(x: Floats, model: TwistModel) -> tuple[Floats, Floats]:
    jacobian = model.jacobian.copy()
    jacobian[:, s.FAST_SLIP] = 0.0
    return model.twist - model.jacobian[:, s.FAST_SLIP] @ x[s.FAST_SLIP], jacobian
