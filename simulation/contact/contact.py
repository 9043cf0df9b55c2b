"""Contact of two tracks with hard ground: vertical loads and horizontal forces.

Symbols and axes are the paper's: X right, Y forward, Z up, origin at the centre of the tracks' contact
area; the twist is (v_x, v_y, w) of the origin, moments are about the origin, counter-clockwise positive.

A contact point at (x, y) on a track of speed V slips over the ground with

    s = (v_x - w y,  v_y + w x - V).

Its friction is, with u = (mu_x s_x, mu_y s_y), the load p of the point and a small regularising speed d,

    f = -p h (mu_x u_x, mu_y u_y) / q,     q^2 = u_x^2 + u_y^2 + mu_x mu_y d^2,

which for mu_x = mu_y = mu is Coulomb's -p mu s / |s|, and otherwise the friction of greatest dissipation
within the ellipse (f_x / mu_x)^2 + (f_y / mu_y)^2 = p^2 (Goyal, Ruina and Papadopoulos, Planar sliding
with dry friction, Wear 143, 1991). h = 1 - exp(-j / K) is the share of the friction that is mobilised by
the shear displacement j (Wong and Chiang, A general theory for skid steering of tracked vehicles on
firm ground, Proc. IMechE D 215, 2001); without a shear modulus h = 1.

Each track also carries its rolling resistance along its centreline, -f_r N v / sqrt(v^2 + d^2), where N
is the track's load and v the speed of that centreline over the ground.

Vertical loads are planar: p = weight (a + b x + c y), with a, b, c from the sum of the loads and the two
moments about the ground of the vehicle's weight and of a horizontal force at the centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from icreckon.estimator.base.checks import Positive, check_bounds
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.soil import Soil

if TYPE_CHECKING:
    from icreckon.simulation.contact.contact_forces import Ground

LEAST_TIPPING_SLOPE = 0.05  # tangent of the slope; who tips over on less has a mistake of units


class ContactGeometry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Contact points of the tracks; both tracks are alike."""

    gauge: Positive  # distance L between the track centrelines [m]
    positions: tuple[float, ...]  # forward coordinates of the contact points of a track, rising [m]
    weights: tuple[Positive, ...] = ()  # shares of an even load, on any scale; () for equal ones
    # outward offsets of the contact points from the centreline [m]; more than one spreads each position
    # evenly over the tread's width
    across: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        check_bounds(self)
        if len(self.positions) < 2 or not np.all(np.diff(self.positions) > 0.0):
            raise ValueError(f"positions must be two or more, rising, found {self.positions!r}")
        if self.weights and len(self.weights) != len(self.positions):
            raise ValueError(
                f"weights must be as many as positions ({len(self.positions)}), "
                f"found {len(self.weights)}"
            )
        if not self.across or not np.all(np.abs(self.across) < 0.5 * self.gauge):
            raise ValueError(
                f"across must be one or more offsets of less than half the gauge, "
                f"found {self.across!r}"
            )


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rigid vehicle on its tracks."""

    mass: Positive  # M [kg]
    x_CM: float = 0.0  # centre of mass, right of the origin [m]
    y_CM: float = 0.0  # centre of mass, forward of the origin [m]
    z_CM: float = 0.0  # centre of mass, above the ground [m]

    def __post_init__(self) -> None:
        check_bounds(self)
        if not np.all(np.isfinite([self.x_CM, self.y_CM, self.z_CM])) or self.z_CM < 0.0:
            raise ValueError(
                "the centre of mass must be finite and not below the ground, found "
                f"{(self.x_CM, self.y_CM, self.z_CM)!r}"
            )

    @property
    def weight(self) -> float:
        """Weight M g [N]."""
        return self.mass * GRAVITY


@dataclass(frozen=True)
class Contact:
    """Contact of a vehicle with the ground: soil, contact points, and body.

    Raises:
        ValueError: the centre of mass lies outside the contact's outline, or so high above it that the
            vehicle tips over on a slope of less than `LEAST_TIPPING_SLOPE`.
    """

    soil: Soil  # friction, rolling resistance, shear
    geometry: ContactGeometry  # the contact points
    body: Body  # mass and centre of mass, which must lie over the contact

    def __post_init__(self) -> None:
        half_width, rear, front = _outline(self.geometry)
        if not (abs(self.body.x_CM) < half_width and rear < self.body.y_CM < front):
            raise ValueError(
                f"the centre of mass ({self.body.x_CM!r}, {self.body.y_CM!r}) m lies outside the "
                f"contact, {-half_width!r} to {half_width!r} m right and {rear!r} to {front!r} m forward"
            )
        highest = min(half_width, 0.5 * (front - rear)) / LEAST_TIPPING_SLOPE
        if self.body.z_CM > highest:
            raise ValueError(
                f"the centre of mass is {self.body.z_CM!r} m above the ground, and beyond "
                f"{highest:.3g} m the vehicle tips over on a slope of {LEAST_TIPPING_SLOPE:.0%} "
                "(wanted in metres)"
            )


def equally_spaced(gauge: float, half_length: float, count: int) -> ContactGeometry:
    """Make evenly spaced contact points from end to end of each track.

    The gauge L is between the track centrelines, `half_length` half the length of a contact [m],
    `count` the number of points, at least 2.
    """
    positions = np.linspace(-half_length, half_length, count).tolist()
    return ContactGeometry(gauge, tuple(positions))


def ground(contact: Contact) -> Ground:
    """Convert a contact to the plain numbers of the compiled equations."""
    from icreckon.simulation.contact.contact_forces import Ground

    soil, geometry, body = contact.soil, contact.geometry, contact.body
    across = np.tile(geometry.across, len(geometry.positions))
    along = np.repeat(geometry.positions, len(geometry.across))
    weights = np.array(geometry.weights or (1.0,) * len(geometry.positions))
    weights = np.repeat(weights, len(geometry.across))
    right = 0.5 * geometry.gauge + across
    # Both tracks are alike; the left one comes first.
    x, y = np.concatenate([-right, right]), np.concatenate([along, along])
    shares = np.concatenate([weights, weights]) / (2.0 * weights.sum())
    basis = np.stack([np.ones_like(x), x, y])
    return Ground(
        x,
        y,
        shares,
        np.asarray(np.linalg.inv((shares * basis) @ basis.T), dtype=float),
        0.5 * geometry.gauge,
        _outline(geometry),
        np.array([soil.coefficients, soil.coefficients]),
        np.full(2, soil.rolling_resistance),
        soil.shear_modulus,
        soil.regularising_speed,
        soil.resistance_opposes == "travel",
        body.mass,
        body.weight,
        (body.x_CM, body.y_CM, body.z_CM),
    )


def _outline(geometry: ContactGeometry) -> tuple[float, float, float]:
    """Half width, rear and front end [m] of the rectangle around all contact points."""
    half = 0.5 * geometry.gauge + max(geometry.across)
    return half, geometry.positions[0], geometry.positions[-1]
