"""Filter variants to compare: one code path, selected by configuration.

A variant is a motion model (the role of the nine parameters, and those it uses) with parameters that are
estimated (`online`) or kept (`fixed`). The slip residual, which the model leaves unexplained, is part of
it: a poorer model needs more. The defaults here apply if the robot file has no `[slip]`.

`register` adds a variant with a motion model of one's own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.checks import Bounded, NotNegative
from icreckon.estimator.base.errors import EstimatorError, nearest_hint
from icreckon.estimator.base.state import PARAMETER_NAMES as INDEX_PARAMETERS
from icreckon.estimator.motion import linear_model
from icreckon.estimator.motion.icr import GRAVITY, IndexValues
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.motion.linear_model import LinearMotion
from icreckon.estimator.motion.motion_model import MotionModel, VehicleConstants
from icreckon.estimator.robot.robot_file import Indices, Robot, Slip

# The largest lateral force of inertia in the paper's simulations, as a share of the weight.
TYPICAL_FORCE = 0.07
LEAST_CREEP = 0.3  # least value of epsilon_F that scales its uncertainty [m]
# Places of the gains among the parameters: zeta1, epsilon1, eta1, eta2; and epsilon_F.
GAINS = (2, 4, 6, 7)
EPSILON_F = s.EPSILON_F - s.PARAMETERS.start
# Range of a track's distance from its ICR, as a share of half the contact's length; one beyond it is not
# of Coulomb friction, and counts as at its end.
LEAST_AWAY, MOST_AWAY = 0.5, 1.5

Model = Literal["gyro", "differential", "constant", "linear", "inertia"]


@dataclass(frozen=True)
class Variant:
    """Filter variant."""

    name: str  # its name
    # shipped model; parameters, initial values, adaptation and slip are those of this model
    model: Model
    online: bool  # True if it estimates the parameters
    # factory of its motion model for a robot; None for the motion model of `model`
    motion: Callable[[Robot], MotionModel] | None = None
    accelerometers: bool = True  # False if it does not use them, whatever the settings say


VARIANTS = {
    variant.name: variant
    for variant in (
        Variant("gyro", "gyro", online=False, accelerometers=False),
        Variant("differential", "differential", online=False),
        Variant("constant-fixed", "constant", online=False),
        Variant("constant-online", "constant", online=True),
        Variant("full-linear", "linear", online=True),
        Variant("inertia-fixed", "inertia", online=False),
        Variant("inertia-online", "inertia", online=True),
    )
}
"""Filter variants by name."""


class Adaptation(Bounded, frozen=True):
    """Prior standard deviations and random walks of the parameters.

    A parameter with standard deviation zero is not estimated: it keeps its initial value. `zeta1`,
    `epsilon1`, `eta1` and `eta2` are given as contributions to their index at a lateral force of inertia
    of 0.07 times the weight (the largest in the paper's simulations); `eta1` and `eta2` at the force of
    the robot's fastest bend if that is larger.

    Attributes:
        zeta0: prior standard deviation [m].
        zeta1: prior standard deviation [m].
        epsilon0: prior standard deviation [m].
        epsilon1: prior standard deviation [m].
        eta0: prior standard deviation [-].
        eta1: prior standard deviation [-].
        eta2: prior standard deviation [-].
        epsilon_F: prior standard deviation, as a share of its value by Coulomb friction [-].
        walk: random walk of each, as a share of the above per √s of turning [1/√s].
    """

    NAMES: ClassVar[str] = "Adaptation.{}"
    zeta0: NotNegative = 0.02
    zeta1: NotNegative = 0.02
    epsilon0: NotNegative = 0.03
    epsilon1: NotNegative = 0.05
    eta0: NotNegative = 0.4
    eta1: NotNegative = 0.1
    eta2: NotNegative = 0.1
    epsilon_F: NotNegative = 0.5
    walk: NotNegative = 0.01


# Constant ICRs: Table II's RMS errors as shares of the RMS track-speed difference over the grid of that
# table (0.856 m/s), and of the corresponding yaw rate; the ideal differential drive: its difference from
# the published model. The better models' are their errors in transient motion.
# Sizes, time constants and walks were chosen by benchmarks/tune_variants.py.
DEFAULT_SLIP: dict[Model, Slip] = {
    "differential": Slip(turning_x=0.12, turning_y=0.05, turning_w=0.65, time_constant=1.0),
    # The yaw rate is the gyro's: the tracks show little of it.
    "gyro": Slip(
        turning_x=0.05,
        turning_y=0.025,
        turning_w=2.0,
        driving_x=0.008,
        driving_y=0.005,
        driving_w=2.0,
        time_constant=1.0,
    ),
    "constant": Slip(turning_x=0.096, turning_y=0.019, turning_w=0.18, time_constant=0.5),
    "linear": Slip(turning_x=0.096, turning_y=0.019, turning_w=0.18, time_constant=0.5),
    "inertia": Slip(
        turning_x=0.09,
        turning_y=0.01,
        turning_w=0.16,
        driving_x=0.01,
        driving_y=0.006,
        driving_w=0.02,
        time_constant=0.5,
    ),
}

DEFAULT_ADAPTATION: dict[Model, Adaptation] = {
    "differential": Adaptation(),
    "gyro": Adaptation(),
    "constant": Adaptation(epsilon0=0.1, walk=0.1),
    "linear": Adaptation(epsilon0=0.1, walk=0.02),
    "inertia": Adaptation(walk=0.05),
}


def find_variant(name: str) -> Variant:
    """Find a variant by its name.

    Raises:
        EstimatorError: an unknown name; the message names the nearest.
    """
    variant = VARIANTS.get(name) if isinstance(name, str) else None
    if variant is None:
        raise EstimatorError(f"no filter variant {name!r}{nearest_hint(str(name), list(VARIANTS))}")
    return variant


def register(variant: Variant) -> None:
    """Add a variant; its name is valid wherever those of `VARIANTS` are.

    A motion model without a traced form (`icreckon.estimator.engine.model`) is evaluated in Python, with
    either engine, and cannot run side by side. Studies refuse each motion model that is not shipped.

    Raises:
        EstimatorError: the name is taken, or there is no such shipped model.
    """
    if variant.name in VARIANTS:
        raise EstimatorError(f"{variant.name!r}: there is such a variant already")
    if variant.model not in DEFAULT_SLIP:
        raise EstimatorError(
            f"no model named {variant.model!r}{nearest_hint(variant.model, list(DEFAULT_SLIP))}"
        )
    VARIANTS[variant.name] = variant


def default_adaptation(variant: str, **changes: float) -> Adaptation:
    """Default adaptation of a variant, with changes.

    `changes` are values of `Adaptation` by name, in its units.

    Raises:
        EstimatorError: an unknown variant or name, or an invalid value.
    """
    default = DEFAULT_ADAPTATION[find_variant(variant).model]
    names = list(default.__struct_fields__)
    for name in changes:
        if name not in names:
            raise EstimatorError(f"Adaptation has no {name!r}{nearest_hint(name, names)}")
    return msgspec.structs.replace(default, **changes)


def parameter_names(variant: Variant) -> tuple[str, ...]:
    """Names (9,) of a variant's parameters, `NO_NAME` for unused places."""
    is_linear = variant.model == "linear"
    names: tuple[str, ...] = linear_model.PARAMETER_NAMES if is_linear else INDEX_PARAMETERS
    return (*names, *[s.NO_NAME] * (len(INDEX_PARAMETERS) - len(names)))


def used_parameters(variant: Variant) -> tuple[str, ...]:
    """Names of the parameters that the variant's model uses."""
    return tuple(name for name in parameter_names(variant) if name != s.NO_NAME)


def state_names(variant: Variant | str) -> tuple[str, ...]:
    """Names (SIZE,) of the states of a variant, given itself or its name.

    Raises:
        EstimatorError: an unknown variant.
    """
    if not isinstance(variant, Variant):
        variant = find_variant(variant)
    names = list(s.STATE_NAMES)
    names[s.PARAMETERS] = parameter_names(variant)
    return tuple(names)


def initial_parameters(robot: Robot, variant: Variant) -> Floats:
    """Initial values of the nine parameters (9,) of a variant.

    Values are the robot file's, as far as the variant's model has them. Gains that the file lacks are
    those of Coulomb friction, see `coulomb_gains`.
    """
    match variant.model:
        case "differential":
            return Indices(H=robot.indices.H).as_array()
        case "gyro":
            return Indices(H=robot.indices.H, eta0=robot.constant_indices.eta0).as_array()
        case "constant":
            return robot.constant_indices.as_array()
        case "inertia":
            parameters = robot.indices.as_array()
            if robot.indices.epsilon_F is None:
                gains = coulomb_gains(robot)
                parameters[EPSILON_F] = gains.epsilon_F
                if not parameters[list(GAINS)].any():
                    parameters[s.ZETA1 - s.PARAMETERS.start] = gains.zeta1
            return parameters
        case "linear":
            _, zeta, _, epsilon, _, eta, *_ = robot.constant_indices.as_array()
            indices = IndexValues(zeta, epsilon, eta)
            six = linear_model.coefficients(indices, robot.vehicle.track_gauge)
            return np.concatenate([six, np.zeros(s.PARAMETER_COUNT - len(six))])


class CoulombGains(NamedTuple):
    """Gains of Coulomb friction at the contact points, see `coulomb_gains`."""

    zeta1: float  # [m/N]
    epsilon_F: float  # [m]
    zeta_F: float  # [m]


def coulomb_gains(robot: Robot) -> CoulombGains:
    """Gains of Coulomb friction at the contact points.

    In a turn a contact point at y along a track, whose ICR is a away from it, slides in proportion to
    (a, y). All points together push with the shares mean(a / r) and mean(y / r) of their friction along
    and across the track, r² = a² + y². A force along the tracks, as a share of the weight, shifts a by
    1 / (mu mean(y² / r³)); one across them, in N, shifts y_ICR by 1 / (mu M g mean(a² / r³)).

    A force forward, as a share of the weight, also presses on the rear: with the centre of mass at the
    height h, loads change by -h y / mean(y²) of themselves. Forces across the tracks are balanced about
    a y_ICR that is h mean(y² / r) / (mean(y²) mean(a² / r³)) further back.
    """
    vehicle, friction = robot.vehicle, robot.soil.friction
    half = vehicle.half_contact_length
    y = np.linspace(-half, half, vehicle.contact_points)
    away = 0.5 * (robot.constant_indices.eta0 - 1.0) * vehicle.track_gauge
    a = min(max(away, LEAST_AWAY * half), MOST_AWAY * half)
    r = np.hypot(a, y)
    across, along = float(np.mean(a * a / r**3)), float(np.mean(y * y / r**3))
    back = vehicle.centre_of_mass[2] * float(np.mean(y * y / r) / np.mean(y * y)) / across
    weight = vehicle.mass * GRAVITY
    return CoulombGains(1.0 / (friction * weight * across), 1.0 / (friction * along), back)


def vehicle_constants(robot: Robot, model: str) -> VehicleConstants:
    """Constants of the model; load moves the ICRs of the inertia-based one alone."""
    zeta_F = coulomb_gains(robot).zeta_F if model == "inertia" else 0.0
    return robot.constants._replace(zeta_F=zeta_F)


def motion_model(robot: Robot, variant: Variant) -> MotionModel:
    """Make the motion model of a variant."""
    if variant.motion is not None:
        return variant.motion(robot)
    if variant.model == "linear":
        return LinearMotion(robot.constants)
    return LaggedIndexMotion(vehicle_constants(robot, variant.model))


def slip_of(robot: Robot, variant: Variant) -> Slip:
    """Slip residual of a variant: the robot file's `[slip.<variant>]`, or the default.

    Raises:
        EstimatorError: the robot file has slip for an unknown variant.
    """
    for name in robot.slip:
        find_variant(name)
    return robot.slip.get(variant.name, DEFAULT_SLIP[variant.model])


def parameter_sigmas(robot: Robot, variant: Variant, adaptation: Adaptation) -> Floats:
    """Initial standard deviations of the nine parameters (9,), in state order.

    Parameters that the variant does not estimate have zero. H has no gradient in the motion
    model: its standard deviation is zero, too, and it keeps the robot file's value.
    """
    if not variant.online:
        return np.zeros(s.PARAMETER_COUNT)
    if variant.model == "linear":
        # Coefficients of both tracks to the right, forward and of the turn are about zeta0, epsilon0
        # and 1, over the gauge times eta0.
        eta0, turn = robot.constant_indices.eta0, 1.0 / robot.effective_track
        sizes = adaptation.zeta0 * turn, adaptation.epsilon0 * turn, adaptation.eta0 / eta0 * turn
        return np.array([*np.repeat(sizes, 2), 0.0, 0.0, 0.0])
    vehicle, force = robot.vehicle, TYPICAL_FORCE * robot.vehicle.mass * GRAVITY
    # In the fastest bend one track stands. There a prior for slow robots would let eta vary by 10.
    fastest = 0.5 * vehicle.mass * vehicle.max_track_speed**2 / robot.effective_track
    largest = max(force, min(fastest, vehicle.mass * GRAVITY))
    epsilon_F = coulomb_gains(robot).epsilon_F
    sigmas = np.array(
        [
            0.0,  # H
            adaptation.zeta0,
            adaptation.zeta1 / force,
            adaptation.epsilon0,
            adaptation.epsilon1 / force,
            adaptation.eta0,
            adaptation.eta1 / largest,
            adaptation.eta2 / largest**2,
            adaptation.epsilon_F * max(epsilon_F, LEAST_CREEP),
        ]
    )
    if variant.model == "constant":
        sigmas[[*GAINS, EPSILON_F]] = 0.0
    return sigmas
