"""Linear model: body velocity linear in both track speeds, with six coefficients.

    v_x (right) = right_l V_l + right_r V_r
    v_y (forward) = forward_l V_l + forward_r V_r
    w = turn_l V_l + turn_r V_r

It contains constant ICRs of two tracks with different radii (Baril et al., Evaluation of skid-steering
kinematic models for subarctic environments, CRV 2020; Okawara et al., Tightly-coupled LiDAR-IMU-wheel
odometry with an online calibration of a kinematic model for skid-steering robots, IEEE Access 2024).

Symbols and axes are the paper's (see `icreckon.estimator.motion.icr`).
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.state import PARAMETER_COUNT
from icreckon.estimator.motion.icr import IndexValues, Number, PaperTwist
from icreckon.estimator.motion.motion_model import (
    BodySlip,
    Gravity,
    Motion,
    TwistDerivatives,
    Unremembering,
    VehicleConstants,
    at_least,
    is_zero,
    sign,
)

PARAMETER_NAMES: Final = ("right_l", "right_r", "forward_l", "forward_r", "turn_l", "turn_r")
TURN_L, TURN_R = 4, 5
# The right track turns the vehicle left, the left one right: least coefficient of either [1/m].
LEAST_TURN = 1e-3
SLOWEST_TURN = 1e-9  # slower turns have no ICR [rad/s]


@dataclass(frozen=True)
class LinearMotion(Unremembering):
    """Linear motion model; see `MotionModel`."""

    vehicle: VehicleConstants
    taught_by_imu: ClassVar[tuple[int, ...]] = (TURN_L, TURN_R)

    @property
    def bounds(self) -> Floats:
        """Bounds (n, 10) of the parameters, as in `MotionModel`."""
        rows = np.zeros((2, PARAMETER_COUNT + 1))
        rows[0, [TURN_L, -1]] = -1.0, LEAST_TURN
        rows[1, [TURN_R, -1]] = 1.0, LEAST_TURN
        return rows

    def steering_efficiency(self, parameters: Any) -> float:
        """Typical steering efficiency index [-], as in `MotionModel`."""
        return float(steering_efficiency(parameters, self.vehicle))

    def linearise(
        self, V_l: Number, V_r: Number, parameters: Any, slip: BodySlip, gravity: Gravity
    ) -> tuple[Motion, TwistDerivatives]:
        """Motion and derivatives of its twist, as in `MotionModel`."""
        return linearise(V_l, V_r, parameters, slip, gravity, self.vehicle)


def steering_efficiency(parameters: Any, vehicle: VehicleConstants) -> Number:
    """Steering efficiency index [-] of the mean of both turning coefficients."""
    return 2.0 / (vehicle.gauge * (parameters[TURN_R] - parameters[TURN_L]))


def coefficients(indices: IndexValues, gauge: float) -> Floats:
    """Coefficients (6,) of constant ICRs, from their indices."""
    turn = 1.0 / (gauge * indices.eta)
    right, back = indices.zeta * turn, indices.epsilon * turn
    return np.array([-right, right, 0.5 + back, 0.5 - back, -turn, turn])


def linearise(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    slip: BodySlip,
    gravity: Gravity,  # noqa: ARG001 - all motion models have it
    vehicle: VehicleConstants,
) -> tuple[Motion, TwistDerivatives]:
    """Compute the motion and the derivatives of its twist; it has no force of inertia."""
    v_x = parameters[0] * V_l + parameters[1] * V_r
    v_y = parameters[2] * V_l + parameters[3] * V_r
    w = parameters[4] * V_l + parameters[5] * V_r
    zero = 0.0 * V_l
    per_w = sign(w) / at_least(abs(w.real), SLOWEST_TURN)
    eta = steering_efficiency(parameters, vehicle) + 0.0 * is_zero(w)
    indices = IndexValues(v_x * per_w, (0.5 * (V_l + V_r) - v_y) * per_w, eta)
    unused = (zero, zero, zero)  # the model has six parameters of nine
    by_parameters = (
        (V_l, V_r, zero, zero, zero, zero, *unused),
        (zero, zero, V_l, V_r, zero, zero, *unused),
        (zero, zero, zero, zero, V_l, V_r, *unused),
    )
    by_speeds = tuple((parameters[row], parameters[row + 1]) for row in (0, 2, 4))
    by_slip = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    by_gravity = ((zero, zero), (zero, zero), (zero, zero))
    twist = PaperTwist(v_x + slip[0], v_y + slip[1], w + slip[2])
    derivatives = TwistDerivatives(by_parameters, by_speeds, by_slip, by_gravity)
    return Motion(twist, indices, zero, zero), derivatives
