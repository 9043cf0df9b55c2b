"""Terrain and payload along the path of a simulated vehicle.

`Terrain` is the shape of the ground of a whole run: a plane, rolling ground, kerbs, or all of them. The
vehicle moves on it in three dimensions. A `Patch` covers a rectangle of odom, a span of time, or both,
and changes friction, rolling resistance or slope there. A `Payload` is put on the vehicle and taken off
again. Without terrain, slopes of patches are planes: the vehicle stays planar, and gravity gets a part
along the ground.
"""

from collections.abc import Iterable, Sequence
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.checks import Bound, NotNegative, OnRobot, Positive
from icreckon.estimator.base.frames import rep103_to_paper
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.base.field_types import settle_types
from icreckon.simulation.contact.contact import Body

EVERYWHERE = (-float("inf"), float("inf"))
STEEPEST = 60.0  # [deg]
# Limit of rolling ground, and of the ramp that a kerb is to a vehicle [deg].
STEEPEST_ROLLING = 30.0
SHORTEST_WAVE = 4.0  # shortest waves, over the length on which a vehicle touches the ground [-]
HEAVIEST = 1e6  # heaviest payload [kg]
PATCH_WIDTH = 13  # numbers of a patch in the equations; `surface_kernel` lists them


# Keys of `[terrain]` that act only together with one of other keys, and the ground without those.
NEEDS = {
    "uphill_deg": (("slope_deg", "rolling_deg", "kerb_height"), "level ground has no direction"),
    "wavelength": (("rolling_deg",), "the ground does not roll"),
    "kerb_every": (("kerb_height",), "there are no kerbs"),
}


class Terrain(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Shape of the ground of a whole run: the sum of a plane, waves and kerbs.

    Attributes:
        slope_deg: steepness of a plane [deg].
        uphill_deg: direction in which the plane rises, in odom, 0 for x and 90 for y [deg]; waves run
            along it and across it, kerbs lie across it.
        rolling_deg: largest slope of rolling ground, two crossed sine waves [deg].
        wavelength: length of these waves [m].
        kerb_height: height of kerbs, which go up and down in turn [m].
        kerb_every: distance between them [m].

    Raises:
        SimulationError: a wrong type, or a number out of range.
    """

    slope_deg: Annotated[float, Bound("between 0 and 60 degrees", 0.0, STEEPEST)] = 0.0
    uphill_deg: Annotated[float, Bound("a finite number")] = 0.0
    rolling_deg: Annotated[float, Bound("between 0 and 30 degrees", 0.0, STEEPEST_ROLLING)] = 0.0
    wavelength: Positive = 20.0
    kerb_height: NotNegative = 0.0
    kerb_every: Positive = 10.0

    def __post_init__(self) -> None:
        settle_types(self, "{} of the terrain")

    @property
    def is_level(self) -> bool:
        """True if the ground is level everywhere."""
        return not (self.slope_deg or self.rolling_deg or self.kerb_height)


def refuse_idle_keys(terrains: Sequence[Terrain], given: Iterable[str], source: str) -> None:
    """Refuse keys of `[terrain]` that change nothing, as the wavelength without waves.

    A needed key that is written as zero counts as given, since a study may change it. `terrains` are the
    terrain, or those of the cells of a study, `given` the written keys; messages name their `source`.

    Raises:
        SimulationError: a key has no effect.
    """
    written = set(given)
    for key in sorted(written & set(NEEDS)):
        needed, without = NEEDS[key]
        is_used = any(getattr(terrain, other) for terrain in terrains for other in needed)
        if not is_used and written.isdisjoint(needed):
            names = " or ".join(needed)
            remedy = f"{without}: give {names}, or leave it out"
            raise SimulationError(f"{source}: [terrain] {key} has no effect, {remedy}")


PatchSlope = Annotated[
    float, Bound("between 0 and 60 degrees (uphill_deg is where it rises to)", 0.0, STEEPEST)
]


class Patch(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Ground unlike the robot's nominal one; None leaves a property unchanged.

    Attributes:
        x: from, to in odom [m]; the track's middle (for the slope, the vehicle's origin) counts.
        y: from, to in odom [m], as for x.
        time: from, to since the start of the run [s].
        edge: width over which the patch begins and ends [m].
        onset: time over which it begins and ends [s].
        friction: coefficient of friction, across and along the track [-].
        rolling_resistance: coefficient of rolling resistance [-].
        slope_deg: steepness of the plane [deg].
        uphill_deg: direction in which it rises, in odom, 0 for x and 90 for y [deg]; only with
            slope_deg, and 0 by default.

    Raises:
        SimulationError: a wrong type, a number out of range, uphill_deg without slope_deg, or a patch
            that changes nothing.
    """

    x: tuple[float, float] = EVERYWHERE
    y: tuple[float, float] = EVERYWHERE
    time: tuple[float, float] = EVERYWHERE
    edge: NotNegative = 0.2
    onset: NotNegative = 0.5
    friction: Positive | None = None
    rolling_resistance: NotNegative | None = None
    slope_deg: PatchSlope | None = None
    uphill_deg: Annotated[float, Bound("a finite number")] | None = None

    def __post_init__(self) -> None:
        settle_types(self, "{} of a patch")
        for name in ("x", "y", "time"):
            _require_rising(f"{name} of a patch", getattr(self, name))
        if self.uphill_deg is not None and self.slope_deg is None:
            raise SimulationError(
                f"a patch has uphill_deg = {self.uphill_deg!r} but no slope_deg; give both"
            )
        if self.friction is None and self.rolling_resistance is None and self.slope_deg is None:
            raise SimulationError(
                "a patch changes nothing; give it friction, rolling_resistance or slope_deg"
            )


class Payload(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Load on the vehicle for a span of time.

    Attributes:
        time: put on, taken off, since the start of the run [s].
        mass: mass of the load [kg].
        position: x forward, y left, z up of its centre of mass in base_link [m].

    Raises:
        SimulationError: a wrong type, or a number out of range.
    """

    time: tuple[float, float]
    mass: Annotated[float, Bound("a positive number of kg, 1e6 at most", 0.0, HEAVIEST, above=True)]
    position: tuple[OnRobot, OnRobot, OnRobot] = (0.0, 0.0, 0.3)

    def __post_init__(self) -> None:
        settle_types(self, "{} of a payload")
        _require_rising("time of a payload", self.time)
        if self.position[2] < 0.0:
            raise SimulationError(
                f"position of a payload must not be below the ground, found {self.position!r}"
            )


def _require_rising(what: str, span: tuple[float, float]) -> None:
    """Reject a span, named `what` in the message, whose end is not after its start."""
    low, high = span
    if not low < high:
        raise SimulationError(
            f"{what} must rise from its first to its second value, found {low!r} to {high!r}"
        )


def patch_rows(patches: tuple[Patch, ...]) -> Floats:
    """Rows (k, PATCH_WIDTH) of patches for `icreckon.simulation.truth.surface_kernel`."""
    nothing = float("nan")  # leaves a property unchanged
    rows = []
    for patch in patches:
        friction = nothing if patch.friction is None else patch.friction
        rolling = nothing if patch.rolling_resistance is None else patch.rolling_resistance
        downhill = (nothing, nothing)
        if patch.slope_deg is not None:
            pull = -GRAVITY * np.sin(np.radians(patch.slope_deg))
            uphill = np.radians(patch.uphill_deg or 0.0)
            downhill = (float(pull * np.cos(uphill)), float(pull * np.sin(uphill)))
        where = (*patch.x, *patch.y, *patch.time, patch.edge, patch.onset)
        rows.append((*where, friction, friction, rolling, *downhill))  # across and along: the same
    return np.array(rows, dtype=float).reshape(len(rows), PATCH_WIDTH)


def check_terrain(terrain: Terrain, contact_length: float) -> None:
    """Refuse ground that a contact of this length [m] does not touch as a plane.

    Raises:
        SimulationError: waves too short, or kerbs too high or too close, for a vehicle of that length.
    """
    # The steepest place of a kerb has twice its mean slope.
    highest = 0.5 * contact_length * np.tan(np.radians(STEEPEST_ROLLING))
    touches = f"the vehicle touches the ground over {contact_length:g} m"
    if terrain.kerb_height > highest:
        raise SimulationError(
            f"kerb_height of the terrain must be at most {highest:.3f} m: {touches}; found "
            f"{terrain.kerb_height!r}"
        )
    if terrain.kerb_height and terrain.kerb_every < contact_length:
        raise SimulationError(
            f"kerb_every of the terrain must be at least {contact_length:g} m: {touches}; found "
            f"{terrain.kerb_every!r}"
        )
    shortest = SHORTEST_WAVE * contact_length
    if terrain.rolling_deg and terrain.wavelength < shortest:
        raise SimulationError(
            f"wavelength of the terrain must be at least {shortest:g} m: {touches}, which is to be a "
            f"plane there; found {terrain.wavelength!r}"
        )


class Surface(NamedTuple):
    """Height field as plain numbers, for `icreckon.simulation.truth.surface_kernel`.

    The coordinate u runs along its direction, v to the left of it.
    """

    present: bool  # False for a run without terrain; nothing else counts then
    direction: tuple[float, float]  # cosine and sine of the direction of u in odom
    plane: float  # slope of the plane along u [-]
    waves: float  # largest slope of each of the waves along u and along v [-]
    wave_number: float  # of both waves [rad/m]
    # of the waves along u and along v [rad], and of the kerbs, as a share of their distance
    phases: tuple[float, float, float]
    kerb_height: float  # height of each kerb [m]; 0 for none
    kerb_every: float  # distance between kerbs, up and down in turn [m]
    kerb_length: float  # length over which a kerb rises [m]


LEVEL = Surface(False, (1.0, 0.0), 0.0, 0.0, 1.0, (0.0, 0.0, 0.0), 0.0, 1.0, 1.0)


def draw_surface(terrain: Terrain, contact_length: float, rng: Generator) -> Surface:
    """Make the height field of a terrain, with random phases of waves and kerbs.

    A kerb rises over the length of a track's contact with the ground [m].

    Raises:
        SimulationError: ground that the vehicle does not touch as a plane, see `check_terrain`.
    """
    check_terrain(terrain, contact_length)
    along, across, kerbs = rng.random(3)
    uphill = np.radians(terrain.uphill_deg)
    # Both waves are steepest at the same places, where their slopes add up at right angles.
    waves = np.tan(np.radians(terrain.rolling_deg)) / np.sqrt(2.0)
    # Kerbs go up and down in turn: their period is two distances.
    return Surface(
        True,
        (float(np.cos(uphill)), float(np.sin(uphill))),
        float(np.tan(np.radians(terrain.slope_deg))),
        float(waves),
        float(2.0 * np.pi / terrain.wavelength),
        (float(2.0 * np.pi * along), float(2.0 * np.pi * across), float(2.0 * kerbs)),
        terrain.kerb_height,
        terrain.kerb_every,
        contact_length,
    )


def loaded(body: Body, yaw_inertia: float, payloads: list[Payload]) -> tuple[Body, float]:
    """Body and yaw inertia of a vehicle with payloads; each payload is a point mass.

    Moments of inertia [kg m²] are about the vertical through the centre of mass of the body, bare or
    loaded.
    """
    masses = np.array([body.mass, *(payload.mass for payload in payloads)])
    centres = [(body.x_CM, body.y_CM, body.z_CM)]
    for payload in payloads:
        forward, left, up = payload.position
        centres.append((*rep103_to_paper(forward, left), up))
    mass = masses.sum()
    centre = masses @ np.array(centres) / mass
    squared_arms = ((np.array(centres) - centre)[:, :2] ** 2).sum(axis=1)
    x, y, z = centre.tolist()
    return Body(float(mass), x, y, z), float(yaw_inertia + masses @ squared_arms)
