"""Index models fitted to a motion that is known: least squares of the twist over track speeds.

Each function takes a robot and gives it back with the part of its file that the model needs replaced. The
sum of squares is of v_x, v_y and w times the track gauge, all in m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.motion.icr import GRAVITY, PaperTwist
from icreckon.estimator.motion.index_model import solve
from icreckon.estimator.robot.robot_file import ConstantIcr, Indices, Robot
from icreckon.estimator.robot.variants import TYPICAL_FORCE

# Fewer turning samples than this show no index.
FEWEST = 20
# A sample turns where the tracks differ by this share of the largest speed.
TURNING = 0.01


@dataclass(frozen=True)
class KnownMotion:
    """Track speeds and the twist that went with them.

    Attributes:
        V_l: (n,) speed of the left track [m/s].
        V_r: (n,) speed of the right track [m/s].
        twist: (n,) each, in the paper's axes [m/s, m/s, rad/s].
    """

    V_l: Floats
    V_r: Floats
    twist: PaperTwist

    def turning(self) -> KnownMotion:
        """The samples in which the robot turns.

        Raises:
            EstimatorError: they are too few to fit anything, or not all numbers are finite.
        """
        if not np.isfinite(np.stack([self.V_l, self.V_r, *self.twist])).all():
            raise EstimatorError("the known motion holds NaN or infinite values; leave those out")
        difference = np.abs(self.V_r - self.V_l)
        top = max(float(np.abs(self.V_l).max()), float(np.abs(self.V_r).max()))
        at = difference > TURNING * top
        if np.count_nonzero(at) < FEWEST:
            raise EstimatorError(
                f"only {np.count_nonzero(at)} of {at.size} samples turn, which shows no index; "
                "use a motion with turns"
            )
        return KnownMotion(
            self.V_l[at], self.V_r[at], PaperTwist(*(part[at] for part in self.twist))
        )


def fit_constant(robot: Robot, motion: KnownMotion) -> Robot:
    """The robot with the constant ICRs that fit best.

    Args:
        robot: gives the gauge.
        motion: what is known.

    Raises:
        EstimatorError: too little turns, or the best fit is no skid-steer vehicle.
    """
    known, gauge = motion.turning(), robot.vehicle.track_gauge
    D, V_m = known.V_r - known.V_l, 0.5 * (known.V_l + known.V_r)
    # w = D / (L eta): v_x, V_m - v_y and w are each proportional to D.
    per_w = float(D @ known.twist.w / (D @ D))
    by_zeta = float(D @ known.twist.v_x / (D @ D))
    by_epsilon = float(D @ (V_m - known.twist.v_y) / (D @ D))
    if not per_w > 0.0:
        raise EstimatorError(
            "the robot turns against its tracks; check which is left, and the sign of the yaw rate"
        )
    zeta, epsilon, half = by_zeta / per_w, by_epsilon / per_w, 0.5 / per_w
    half = max(half, 0.5 * gauge)
    try:
        icr = ConstantIcr(epsilon - half, epsilon + half, zeta)
    except ValueError as error:
        raise EstimatorError(f"the fitted ICRs make no sense: {error}") from error
    return msgspec.structs.replace(robot, constant_icr=icr)


def fit_inertia(robot: Robot, motion: KnownMotion) -> Robot:
    """The robot with the inertia-based parameters that fit best; H stays.

    Args:
        robot: gives mass, gauge and centre of mass, and where to start.
        motion: what is known.

    Raises:
        EstimatorError: too little turns, or the best fit is no skid-steer vehicle.
    """
    from scipy.optimize import least_squares

    known = motion.turning()
    # The gains are fitted as what they contribute at a typical force of inertia.
    force = TYPICAL_FORCE * robot.vehicle.mass * GRAVITY
    units = np.array([1.0, 1.0, force, 1.0, force, 1.0, force, force**2])

    def residuals(scaled: Floats) -> Floats:
        parameters = np.concatenate([[robot.indices.H], scaled]) / units
        found = solve(known.V_l, known.V_r, parameters, robot.constants).twist
        return _difference(found, known.twist, robot)

    start = (robot.indices.as_array()[:8] * units)[1:]
    low = np.full(7, -np.inf)
    low[4] = 1.0
    best = least_squares(residuals, np.maximum(start, low), bounds=(low, np.inf), x_scale=0.1)
    values = np.concatenate([[robot.indices.H], best.x]) / units
    # The motion was fitted without a shift by the force along the tracks.
    indices = Indices(*(float(value) for value in values), epsilon_F=0.0)
    return msgspec.structs.replace(robot, indices=indices)


def _difference(found: PaperTwist, known: PaperTwist, robot: Robot) -> Floats:
    gauge = robot.vehicle.track_gauge
    return np.concatenate(
        [found.v_x - known.v_x, found.v_y - known.v_y, gauge * (found.w - known.w)]
    )
