"""The filter variants that are compared: one code path, chosen by configuration.

A variant is an index model (what the eight parameters do in it, and which it uses) and whether those
are estimated on the way (`online`) or kept (`fixed`). What a model leaves unexplained, its slip, is part
of it: a poorer model needs more. The defaults here are for a robot whose file says nothing better in
`[slip]`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from estimator.errors import EstimatorError, nearest_hint
from estimator.frames import Floats
from estimator.friction_map import FrictionMap, friction_map
from estimator.friction_motion import FrictionMotion
from estimator.kinematics import GRAVITY
from estimator.motion import Form, InertiaMotion
from estimator.motion_model import MotionModel
from estimator.robot import Indices, Robot, Slip

# Shares of the weight: the largest lateral force of inertia in the paper's simulations.
TYPICAL_FORCE = 0.07

Model = Literal["differential", "constant", "inertia", "friction"]


@dataclass(frozen=True)
class Variant:
    """A filter variant: its name, its index model, and whether it estimates the parameters."""

    name: str
    model: Model
    online: bool


VARIANTS = {
    variant.name: variant
    for variant in (
        Variant("differential", "differential", online=False),
        Variant("constant-fixed", "constant", online=False),
        Variant("constant-online", "constant", online=True),
        Variant("inertia-fixed", "inertia", online=False),
        Variant("inertia-online", "inertia", online=True),
        Variant("friction-fixed", "friction", online=False),
        Variant("friction-online", "friction", online=True),
    )
}


class Adaptation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How far the parameters may be from where they start, and how fast they may move.

    In the inertia-based model `zeta1`, `epsilon1`, `eta1` and `eta2` are given as what they contribute
    to their index at a lateral force of inertia of 0.07 times the weight (the largest in the paper's
    simulations); in the friction model as they are, shares of the friction solution [-].

    Attributes:
        zeta0: standard deviation at the start [m].
        zeta1: [m] or [-].
        epsilon0: [m].
        epsilon1: [m] or [-].
        eta0: [-].
        eta1: [-].
        eta2: [-]; not used in the friction model.
        walk: random walk of each, as a share of the above per √s of turning [1/√s].
    """

    zeta0: float = 0.02
    zeta1: float = 0.02
    epsilon0: float = 0.03
    epsilon1: float = 0.05
    eta0: float = 0.4
    eta1: float = 0.1
    eta2: float = 0.1
    walk: float = 0.01


# Constant ICRs: the shares that Table II's RMS errors are of the RMS track-speed difference over the
# grid of that table (0.856 m/s), and of the yaw rate that goes with it; the ideal differential drive:
# what is left of the published model. The better models' are as much as they lack in transient motion.
# Sizes, time constants and walks were chosen by benchmarks/tune_variants.py.
DEFAULT_SLIP: dict[Model, Slip] = {
    "differential": Slip(turning_x=0.12, turning_y=0.05, turning_w=0.65, time_constant=1.0),
    "constant": Slip(turning_x=0.096, turning_y=0.019, turning_w=0.18, time_constant=0.5),
    "inertia": Slip(
        turning_x=0.09,
        turning_y=0.01,
        turning_w=0.16,
        driving_x=0.01,
        driving_y=0.006,
        driving_w=0.02,
        time_constant=0.5,
    ),
    "friction": Slip(
        turning_x=0.06,
        turning_y=0.01,
        turning_w=0.12,
        driving_x=0.01,
        driving_y=0.006,
        driving_w=0.02,
        time_constant=0.5,
    ),
}

DEFAULT_ADAPTATION: dict[Model, Adaptation] = {
    "differential": Adaptation(),
    "constant": Adaptation(epsilon0=0.1, walk=0.02),
    "inertia": Adaptation(walk=0.02),
    "friction": Adaptation(zeta1=0.3, epsilon1=0.3, eta1=0.3, walk=0.02),
}


def find_variant(name: str) -> Variant:
    """The variant of this name.

    Raises:
        EstimatorError: there is none; the message names the nearest.
    """
    try:
        return VARIANTS[name]
    except KeyError:
        raise EstimatorError(
            f"no filter variant {name!r}{nearest_hint(name, list(VARIANTS))}"
        ) from None


def initial_indices(robot: Robot, variant: Variant) -> Indices:
    """The parameters that a variant starts from.

    They are the robot file's, as far as the variant's model has them. The friction model starts from
    the friction solution itself; where the ground is not known (no `[soil]`), its variation about the
    constant ICRs, which are known better.

    Raises:
        EstimatorError: a friction variant's robot has no stationary motions on its ground.
    """
    match variant.model:
        case "differential":
            return Indices(H=robot.indices.H)
        case "constant":
            return robot.constant_indices
        case "inertia":
            return robot.indices
    known = robot.constant_indices
    if robot.soil is None:
        zeta, epsilon, eta = known.zeta0, known.epsilon0, known.eta0
    else:
        zeta, epsilon, eta = _friction_map(robot).reference
    return Indices(
        H=known.H, zeta0=zeta, zeta1=1.0, epsilon0=epsilon, epsilon1=1.0, eta0=eta, eta1=1.0
    )


def motion_model(
    robot: Robot, variant: Variant, form: Form = "smooth", *, slip_in_inertia: bool = False
) -> MotionModel:
    """The motion model of a variant.

    Args:
        robot: the robot.
        variant: the variant.
        form: see `estimator.motion.solve`; the friction model has no forms.
        slip_in_inertia: see there; the friction model does not look at the slip.

    Raises:
        EstimatorError: a friction variant's robot has no stationary motions on its ground.
    """
    if variant.model == "friction":
        return FrictionMotion(robot.constants, _friction_map(robot))
    return InertiaMotion(robot.constants, form, slip_in_inertia)


def _friction_map(robot: Robot) -> FrictionMap:
    return friction_map(robot.contact, robot.vehicle.max_track_speed)


def slip_of(robot: Robot, variant: Variant) -> Slip:
    """The slip residual of a variant: the robot file's `[slip.<variant>]`, or the default.

    Raises:
        EstimatorError: the robot file has slip for a variant that there is not.
    """
    for name in robot.slip:
        find_variant(name)
    return robot.slip.get(variant.name, DEFAULT_SLIP[variant.model])


def parameter_sigmas(robot: Robot, variant: Variant, adaptation: Adaptation) -> Floats:
    """Standard deviations at the start of the eight parameters (8,), in `Indices` order.

    Zero where the variant does not estimate the parameter. H has no gradient in the motion model: its
    spread is zero too, and it stays what the robot file says.
    """
    if not variant.online:
        return np.zeros(8)
    is_share = variant.model == "friction"
    force = 1.0 if is_share else TYPICAL_FORCE * robot.vehicle.mass * GRAVITY
    sigmas = np.array(
        [
            0.0,
            adaptation.zeta0,
            adaptation.zeta1 / force,
            adaptation.epsilon0,
            adaptation.epsilon1 / force,
            adaptation.eta0,
            adaptation.eta1 / force,
            adaptation.eta2 / force**2,
        ]
    )
    if variant.model == "constant":
        sigmas[[2, 4, 6, 7]] = 0.0
    if is_share:
        sigmas[7] = 0.0
    return sigmas
