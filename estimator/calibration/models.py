"""Motion models to compare: their parameters, and the twist with its derivatives.

Track speeds in, twist of base_link out (REP-103: v_x forward, v_y left). Parameters are in the units of
the robot file.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.motion.bounds import ETA0
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.motion.lagged_index_model import linearise
from icreckon.estimator.motion.motion_model import LEVEL, NO_SLIP, VehicleConstants
from icreckon.estimator.robot.robot_file import ConstantIcr, Indices, Robot
from icreckon.estimator.robot.variants import (
    TYPICAL_FORCE,
    find_variant,
    initial_parameters,
    vehicle_constants,
)

MODELS = ("differential", "constant", "inertia")
"""Names, from the simplest to the most complex: a later one must be better to be chosen."""
THRESHOLD = 0.15  # threshold error of an index, or of a length as a share of the gauge [-]
MIDDLE_THRESHOLD = 0.05
"""Threshold error of the turning centre's place, as a share of the gauge [-]: it is near the middle, and
a short log does not separate it from the place of the truth's point."""
NO_MASS = (1.0, 0.0, 0.0)  # mass [kg] and centre of mass [m] of a model without forces


class Parameter(NamedTuple):
    """Parameter of a model."""

    name: str  # name in the robot file
    unit: str  # "m", "1/N", ...; "-" for none
    start: float  # initial value, from the robot file
    threshold: float  # standard error above which it is unobservable, in the unit
    rank: int  # among parameters that replace each other, the highest is held first


class LinearisedTwist(NamedTuple):
    """Twists and their derivatives for (...,) cells."""

    twist: Floats  # (..., 3) v_x, v_y [m/s], w [rad/s]
    by_parameters: Floats  # (..., 3, p) derivatives by the parameters
    by_speeds: Floats  # (..., 3, 2) derivatives by the left and right track speed


@dataclass(frozen=True)
class Model:
    """Index model with some free parameters; the other indices are fixed."""

    name: str  # one of `MODELS`
    parameters: tuple[Parameter, ...]  # none, those of constant ICRs, or all but H
    vehicle: VehicleConstants  # constants of the vehicle
    places: tuple[int, ...]  # places of the parameters in `Indices`
    H: float  # H of the robot file [-]

    def linearise(self, speeds: Floats, values: Floats, forces: Floats) -> LinearisedTwist:
        """Compute twists with derivatives.

        Args:
            speeds: (..., 2) track speeds [m/s].
            values: (p,) parameters.
            forces: (..., 2) forces that the ground balances, see `Recording.ground_forces`.
        """
        # The memory holds gravity, too.
        vehicle, V_l, V_r = self.vehicle, speeds[..., 0], speeds[..., 1]
        memory = (vehicle.mass * forces[..., 0], 0.0, GRAVITY * forces[..., 1], 1.0)
        parameters = self.all_parameters(values)
        motion, by = linearise(V_l, V_r, parameters, NO_SLIP, LEVEL, vehicle, memory)

        def in_rep103(rows: Any) -> Floats:
            """Array (..., 3, c) forward, left, yaw of three rows of c entries in paper axes."""
            whole = [[np.broadcast_to(entry, V_l.shape) for entry in row] for row in rows]
            right, forward, yaw = (np.stack(entries, axis=-1) for entries in whole)
            return np.stack([forward, -right, yaw], axis=-2)

        by_parameters = in_rep103(by.by_parameters)[..., list(self.places)]
        twist = in_rep103([[component] for component in motion.twist])[..., 0]
        return LinearisedTwist(twist, by_parameters, in_rep103(by.by_speeds))

    def inside(self, values: Floats) -> Floats:
        """Nearest valid parameters (p,): eta0 is at least 1."""
        result = values.copy()
        if ETA0 in self.places:
            place = self.places.index(ETA0)
            result[place] = max(result[place], 1.0)
        return result

    def all_parameters(self, values: Floats) -> Floats:
        """All parameters (9,), in the order of `Indices`."""
        result = Indices(H=self.H).as_array()
        result[list(self.places)] = values
        return result

    def put_into(self, robot: Robot, values: Floats) -> Robot:
        """Robot with these parameters (p,) in its file."""
        if not self.places:
            return robot
        indices = Indices(*(float(value) for value in self.all_parameters(self.inside(values))))
        if self.name == "inertia":
            return msgspec.structs.replace(robot, indices=indices)
        # A file's rounding must not bring the ICRs nearer to each other than the gauge.
        half = 0.5 * self.vehicle.gauge * max(indices.eta0, 1.0 + 1e-6)
        try:
            icr = ConstantIcr(indices.epsilon0 - half, indices.epsilon0 + half, indices.zeta0)
        except ValueError as error:
            raise EstimatorError(
                f"the ICRs that fit best make no sense: {error}; check which track is left, the "
                "IMU's mounting and the gauge"
            ) from error
        return msgspec.structs.replace(robot, constant_icr=icr)


def model_of(name: str, robot: Robot) -> Model:
    """Make a model of `MODELS` by its name, with starts by the robot file."""
    gauge = robot.vehicle.track_gauge
    if name == "differential":
        return Model(name, (), VehicleConstants(gauge, *NO_MASS), (), 1.0)
    start = robot.constant_indices.as_array()
    places: tuple[int, ...] = (1, 3, ETA0)  # places of zeta0, epsilon0, eta0
    if name == "inertia":
        # All but H, which acts in the literal form only.
        start = initial_parameters(robot, find_variant("inertia-fixed"))
        places = tuple(range(1, len(start)))
    force, length_error = TYPICAL_FORCE * robot.vehicle.mass * GRAVITY, THRESHOLD * gauge
    middle_error, eta_error = MIDDLE_THRESHOLD * gauge, THRESHOLD * max(1.0, start[ETA0])
    # Units and thresholds, by rank. A gain has the threshold of its index at a typical force.
    table = (
        ("eta0", "-", eta_error),
        ("zeta0", "m", middle_error),
        ("epsilon0", "m", middle_error),
        ("zeta1", "m/N", length_error / force),
        ("epsilon1", "m/N", length_error / force),
        ("epsilon_F", "m", length_error / TYPICAL_FORCE),
        ("eta1", "1/N", eta_error / force),
        ("eta2", "1/N²", eta_error / force**2),
    )
    names = Indices.__struct_fields__
    by_name = {
        key: Parameter(key, unit, float(start[names.index(key)]), threshold, rank)
        for rank, (key, unit, threshold) in enumerate(table)
    }
    parameters = tuple(by_name[names[place]] for place in places)
    return Model(name, parameters, vehicle_constants(robot, name), places, robot.indices.H)
