"""The indices of the friction solution as a table: smooth, and fast enough for a step of a filter.

Under Coulomb friction and without inertia, the stationary motion depends on the direction of (V_l, V_r)
alone, and inertia bends it about in proportion to the square of the speed. So the coordinates are

    t = V_m / (|V_m| + h)       the direction; V_m = (V_l + V_r) / 2, h = |V_r - V_l| / 2
    s = (V_l⁸ + V_r⁸)^(1/4)     the square of the magnitude; constant along squares with rounded corners

t is 1 straight forward, 1/2 and -1/2 where one track rests, 0 where they are opposed, and -1 straight
backward. Turns to the left and to the right have a table each, since rolling resistance gives epsilon and
eta other limits on the two sides of straight motion. That of right turns is the one of left turns of the
mirrored vehicle, so a symmetric vehicle gets exactly symmetric motions. The ends of t are solved close
beside straight motion. The smallest s is solved at a crawl, and from there each ring of nodes starts from
the one before: where hard turns have several stationary motions, the table holds the one that is reached
by speeding up. Where forces jump as a track stops (shear displacement, resistance that opposes the
track), the table is cut at t = -1/2 and 1/2 and may jump there.

Between the nodes it is bicubic, once continuously differentiable, with slopes that are limited as for
monotone interpolation (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980): the solution has kinks, where
the travel of a track reverses, and must not overshoot there. Beyond the largest s the indices stay.

The table is one of Coulomb friction: the soil's regularising speed is lowered to a small share of the
track speeds, since the indices of what creeps through it have no limit in straight motion. Soil with a
shear modulus creeps however slow it is driven; the creep in straight motion is not in the indices.

Symbols and axes are the paper's (see `kinematics`). Track speeds broadcast; floats give floats, and
complex numbers pass through, for complex-step differentiation, and numba compiles the same functions,
see `estimator.motion_model`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import msgspec
import numpy as np

from estimator.contact import Contact, Floats
from estimator.errors import EstimatorError
from estimator.kinematics import IndexValues, Number, PaperTwist
from estimator.motion_model import some
from estimator.steady import solve_steady

# Cells over the direction, a multiple of 4 so that t = -1/2, 0 and 1/2 are nodes, and over s.
DIRECTIONS = 320
RINGS = 32
# The table reaches this far beyond the fastest track speed.
REACH = 1.05
# The crawl, as a share of the fastest track speed: inertia is its square of what it is at full speed.
CRAWL = 1e-3
# How far beside straight motion (in t) its limits are solved, and those beside a track's stop.
EDGE = 1e-3
# The regularising speed as a share of the track speeds, well below the difference of these at EDGE.
SHARPNESS = 1e-5
# Both tracks below this are at rest [m/s].
AT_REST = 1e-12
# Monotone interpolation bounds slopes to this many times those of the neighbouring chords.
STEEPEST = 3.0
# From values and slopes at both ends of a cell to the coefficients of the powers.
HERMITE = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-3.0, -2.0, 3.0, -1.0], [2.0, 1.0, -2.0, 1.0]]
)


class MapPoint(NamedTuple):
    """The table at a pair of track speeds.

    Attributes:
        indices: zeta [m], epsilon [m], eta [-] of the friction solution.
        by_D: their derivatives by V_r - V_l, per m/s.
        by_V_m: their derivatives by (V_l + V_r) / 2, per m/s.
    """

    indices: IndexValues
    by_D: IndexValues
    by_V_m: IndexValues


class Table(NamedTuple):
    """The numbers of a table.

    Attributes:
        coefficients: (2 * DIRECTIONS * RINGS, 48) of the cells, left turns first, 16 for each index.
        cells_per_s: how many cells there are to a unit of s [s²/m²].
    """

    coefficients: Floats
    cells_per_s: float


class FrictionMap:
    """The table of one vehicle on one ground; see the module, and `friction_map`, which keeps them.

    Pickling and copying hand on what it was made from, not the numbers.

    Attributes:
        contact: the vehicle on its ground.
        top_speed: the fastest track speed [m/s].
        reference: zeta [m], epsilon [m], eta [-] at a crawl, the mean over all directions.
        table: its numbers.

    Raises:
        EstimatorError: some stationary motions were not found.
    """

    def __init__(self, contact: Contact, top_speed: float) -> None:
        self.contact = contact
        self.top_speed = top_speed
        to_the_left = _solve_turns(contact, top_speed)
        mirrored = _mirrored(contact)
        to_the_right = to_the_left if mirrored == contact else _solve_turns(mirrored, top_speed)
        coefficients = np.concatenate([_cells(to_the_left), _cells(to_the_right)])
        self.table = Table(coefficients, RINGS / _largest_s(top_speed))
        left, right = (
            np.concatenate([panel[:, 0] for panel in panels]).mean(axis=0)
            for panels in (to_the_left, to_the_right)
        )
        zeta, epsilon, eta = (0.5 * (left + right * (1.0, -1.0, 1.0))).tolist()
        self.reference = IndexValues(zeta, epsilon, eta)

    def __reduce__(self) -> tuple[Any, ...]:
        return friction_map, (self.contact, self.top_speed)

    def at(self, V_l: Number, V_r: Number) -> MapPoint:
        """Indices and their derivatives at track speeds [m/s].

        In straight motion (V_l = V_r) they are the mean of both sides' limits, which the twist does
        not show, and at rest those of opposed tracks, with derivatives of zero.
        """
        return look_up(self.table, V_l, V_r)


@lru_cache(maxsize=8)
def friction_map(contact: Contact, top_speed: float) -> FrictionMap:
    """The table for track speeds up to `top_speed` [m/s], made when first asked for.

    Raises:
        EstimatorError: some stationary motions were not found.
    """
    return FrictionMap(contact, top_speed)


def look_up(table: Table, V_l: Number, V_r: Number) -> MapPoint:
    """See `FrictionMap.at`."""
    D, V_m = V_r - V_l, 0.5 * (V_l + V_r)
    to_the_right = 1.0 * (D.real < 0.0)
    h = (0.5 - to_the_right) * D
    point = _turn(table, to_the_right, h, V_m)
    straight = D.real == 0.0
    if not some(straight):
        return point
    other = _turn(table, 1.0 - to_the_right, (1.0 - 2.0 * straight) * h, V_m)
    share = 0.5 * straight
    return MapPoint(
        _between(point.indices, other.indices, share),
        _between(point.by_D, other.by_D, share),
        _between(point.by_V_m, other.by_V_m, share),
    )


def _between(one: IndexValues, other: IndexValues, share: Number) -> IndexValues:
    return IndexValues(
        one.zeta + share * (other.zeta - one.zeta),
        one.epsilon + share * (other.epsilon - one.epsilon),
        one.eta + share * (other.eta - one.eta),
    )


def _turn(table: Table, to_the_right: Number, h: Number, V_m: Number) -> MapPoint:
    """The table of one side, h >= 0; right turns (1) are mirrored left turns (0)."""
    side = 1.0 - 2.0 * to_the_right
    forward = 1.0 - 2.0 * (V_m.real < 0.0)
    size = forward * V_m + h
    moves = 1.0 * (size.real > AT_REST)
    per_size = moves / (size + 1.0 - moves)
    t = V_m * per_size
    u = 1.0 - forward * t
    # The track speeds over their size, and s with its derivatives by h and V_m.
    left, right = t - u, t + u
    left_3, right_3 = left * left * left, right * right * right
    total = left_3 * left_3 * left * left + right_3 * right_3 * right * right
    root = total**0.25
    s = size * size * root
    slope = 2.0 * size * root / total
    by_left, by_right = slope * left_3 * left_3 * left, slope * right_3 * right_3 * right

    across = (t + 1.0) * (0.5 * DIRECTIONS)
    outward = s * table.cells_per_s
    inside = 1.0 * (outward.real < RINGS)
    outward = inside * outward + (1.0 - inside) * RINGS
    column, row = _cell(across, DIRECTIONS), _cell(outward, RINGS)
    c = cell_coefficients(table, (to_the_right * DIRECTIONS + column) * RINGS + row)
    x, y = across - column, outward - row
    x_h, x_V_m = -0.5 * DIRECTIONS * t * per_size, 0.5 * DIRECTIONS * u * per_size
    per_s = inside * moves * table.cells_per_s
    y_h, y_V_m = per_s * (by_right - by_left), per_s * (by_right + by_left)

    zeta, zeta_x, zeta_y = _bicubic(c, 0, x, y)
    epsilon, epsilon_x, epsilon_y = _bicubic(c, 16, x, y)
    eta, eta_x, eta_y = _bicubic(c, 32, x, y)
    per_D = 0.5 * side
    return MapPoint(
        IndexValues(zeta, side * epsilon, eta),
        IndexValues(
            per_D * (zeta_x * x_h + zeta_y * y_h),
            0.5 * (epsilon_x * x_h + epsilon_y * y_h),
            per_D * (eta_x * x_h + eta_y * y_h),
        ),
        IndexValues(
            zeta_x * x_V_m + zeta_y * y_V_m,
            side * (epsilon_x * x_V_m + epsilon_y * y_V_m),
            eta_x * x_V_m + eta_y * y_V_m,
        ),
    )


def _cell(position: Number, count: int) -> Any:
    """Which of `count` cells of size 1 a position from 0 to count lies in, as a float."""
    cell = position.real // 1.0
    return cell - 1.0 * (cell >= count)


def cell_coefficients(table: Table, cell: Any) -> Any:
    """The 48 coefficients of a cell, or of each of an array of cells."""
    if isinstance(cell, np.ndarray):
        return np.moveaxis(table.coefficients[cell.astype(int)], -1, 0)
    return table.coefficients[int(cell)].tolist()


def _bicubic(c: Any, first: int, x: Number, y: Number) -> tuple[Number, Number, Number]:
    """Value, derivative by x and by y of the sum of c[first + 4 i + j] x^i y^j."""
    a0, b0 = _cubic(c, first, y)
    a1, b1 = _cubic(c, first + 4, y)
    a2, b2 = _cubic(c, first + 8, y)
    a3, b3 = _cubic(c, first + 12, y)
    return (
        ((a3 * x + a2) * x + a1) * x + a0,
        (3.0 * a3 * x + 2.0 * a2) * x + a1,
        ((b3 * x + b2) * x + b1) * x + b0,
    )


def _cubic(c: Any, first: int, y: Number) -> tuple[Number, Number]:
    """Value and derivative of the sum of c[first + j] y^j."""
    c0, c1, c2, c3 = c[first], c[first + 1], c[first + 2], c[first + 3]
    return ((c3 * y + c2) * y + c1) * y + c0, (3.0 * c3 * y + 2.0 * c2) * y + c1


def _largest_s(top_speed: float) -> float:
    """The s of the corners of the square of track speeds that the table is for."""
    return float(2.0**0.25 * (REACH * top_speed) ** 2)


def _mirrored(contact: Contact) -> Contact:
    """The same with left and right exchanged; the ground and the contact points are symmetric."""
    body = contact.body
    return replace(contact, body=msgspec.structs.replace(body, x_CM=0.0 - body.x_CM))


def _solve_turns(contact: Contact, top_speed: float) -> list[Floats]:
    """Indices at the nodes of left turns: panels (directions, rings, 3), one after the other in t."""
    soil = contact.soil
    jumps = soil.shear_modulus > 0.0 or (
        soil.rolling_resistance > 0.0 and soil.resistance_opposes == "track"
    )
    quarter = DIRECTIONS // 4
    cuts = (0, quarter, 3 * quarter, DIRECTIONS) if jumps else (0, DIRECTIONS)
    panels = []
    for first, last in pairwise(cuts):
        nodes = 2.0 * np.arange(first, last + 1) / DIRECTIONS - 1.0
        nodes[0], nodes[-1] = nodes[0] + EDGE, nodes[-1] - EDGE
        panels.append(_solve_panel(contact, top_speed, nodes))
    return panels


def _solve_panel(contact: Contact, top_speed: float, t: Floats) -> Floats:
    """Indices (directions, rings, 3) of left turns at the directions t."""
    h = 1.0 - np.abs(t)
    left, right = t - h, t + h
    size = (left**8 + right**8) ** 0.125
    speeds = np.sqrt(np.linspace(0.0, _largest_s(top_speed), RINGS + 1))
    speeds[0] = CRAWL * top_speed
    indices = np.empty((len(t), RINGS + 1, 3))
    guess = None
    for ring, speed in enumerate(speeds):
        soil = msgspec.structs.replace(
            contact.soil,
            regularising_speed=min(contact.soil.regularising_speed, SHARPNESS * speed),
        )
        V_l, V_r = left * (speed / size), right * (speed / size)
        motion = solve_steady(V_l, V_r, replace(contact, soil=soil), guess=guess, strict=False)
        if not motion.converged.all():
            failed = np.flatnonzero(~motion.converged)
            raise EstimatorError(
                f"no stationary motion found for {failed.size} of {len(t)} directions at "
                f"{speed:.3g} m/s, the first (V_l, V_r) = ({V_l[failed[0]]:.6g}, "
                f"{V_r[failed[0]]:.6g}) m/s: the friction variants need a contact that has them; "
                "check the centre of mass, the soil and max_track_speed, or use other variants"
            )
        v_x, v_y, w = motion.twist
        gauge = contact.geometry.gauge
        indices[:, ring] = np.stack(
            [v_x / w, (0.5 * (V_l + V_r) - v_y) / w, (V_r - V_l) / (gauge * w)], axis=-1
        )
        if ring < RINGS:
            ratio = speeds[ring + 1] / speed
            guess = PaperTwist(v_x * ratio, v_y * ratio, w * ratio)
    return indices


def _cells(panels: list[Floats]) -> Floats:
    """Coefficients (DIRECTIONS * RINGS, 48) of the cells: 16 powers for each index."""
    return np.concatenate([_panel_cells(panel) for panel in panels])


def _panel_cells(f: Floats) -> Floats:
    f_t, f_s = _slopes(f), np.swapaxes(_slopes(np.swapaxes(f, 0, 1)), 0, 1)
    near, far = slice(None, -1), slice(1, None)
    corners = np.zeros((f.shape[0] - 1, f.shape[1] - 1, 3, 4, 4))
    for i, along_t in enumerate((near, far)):
        for j, along_s in enumerate((near, far)):
            at = along_t, along_s
            corners[..., 2 * i, 2 * j] = f[at]
            corners[..., 2 * i + 1, 2 * j] = f_t[at]
            corners[..., 2 * i, 2 * j + 1] = f_s[at]
    return np.asarray((HERMITE @ corners @ HERMITE.T).reshape(-1, 48))


def _slopes(f: Floats) -> Floats:
    """Slopes along the first axis, per cell: means of the chords, limited; zero at extremes."""
    chords = np.diff(f, axis=0)
    before, after = chords[:-1], chords[1:]
    limit = STEEPEST * np.minimum(np.abs(before), np.abs(after))
    middle = np.where(before * after > 0.0, np.clip(0.5 * (before + after), -limit, limit), 0.0)
    return np.concatenate([chords[:1], middle, chords[-1:]])
