"""Loads of the contact points in traced numbers, as planes over the contact.

Loads are those of `icreckon.estimator.motion.contact.vertical_loads`: planar over the points that touch,
and zero where the plane is below zero. Coordinates along the track are those of the nominal contact, so
that a plane does not depend on the estimated length.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from icreckon.estimator.motion.contact_forces import (
    ACTIVE_SET_ITERATIONS,
    ARMIJO,
    LINE_SEARCH_HALVINGS,
    NO_LOAD,
    RIDGE,
    TIPPING_MARGIN,
)
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.trace import Table, Traced, maximum, select

# Rounds of the search for the points that touch, with those of its line searches.
TOUCHING_ROUNDS = 2 * ACTIVE_SET_ITERATIONS
# Columns of a table of pairs of points: right of the origin, of the left and of the right track; forward;
# share of each of both in the load under even pressure.
PAIR_COLUMNS = 4

# Three numbers; and the upper triangle of a symmetric 3 by 3 matrix, row by row.
Plane = tuple[Any, ...]
Symmetric = tuple[Any, ...]


class ContactArea(NamedTuple):
    """Nominal contact points of both tracks.

    Attributes:
        pairs: table of pairs of points, `PAIR_COLUMNS` wide.
        even: inverse of all points' moments of 1, x, y.
        half_width: half the width of the rectangle around all points [m].
        rear: its rear end [m].
        front: its front end [m].
    """

    pairs: Table
    even: Symmetric
    half_width: Any
    rear: Any
    front: Any


class Pressing(NamedTuple):
    """Loads under weight and a force at the centre of mass, as planes a + b x + c y.

    A point's load is its share times the weight times the plane, where that is above zero.

    Attributes:
        plane: the plane [-].
        by_right: its derivative by the force to the right, times the weight [-].
        by_forward: its derivative by the force forward, times the weight [-].
        by_stretch: its derivative by the length of the contact, as a share of the nominal one.
    """

    plane: Plane
    by_right: Plane
    by_forward: Plane
    by_stretch: Plane


class PointLoad(NamedTuple):
    """Load of a point as a share of the weight, and derivatives as in `Pressing`."""

    load: Any
    by_right: Any
    by_forward: Any
    by_stretch: Any


def pressing(
    area: ContactArea, centre: Plane, stretch: Any, weight: Any, force: tuple[Any, Any]
) -> Pressing:
    """Loads under a force at the centre of mass.

    Args:
        area: the nominal contact.
        centre: x_CM, y_CM, z_CM [m].
        stretch: length of the contact, as a share of the nominal one.
        weight: force that presses on the ground [N].
        force: force at the centre of mass to the right and forward [N].
    """
    x_CM, y_CM, z_CM = centre
    arm, inside = z_CM / weight, 1.0 - TIPPING_MARGIN
    half, middle = area.half_width * inside, 0.5 * (area.rear + area.front)
    reach = 0.5 * (area.front - area.rear) * inside
    x, x_free = _held(x_CM + arm * force[0], 0.0, half)
    y, y_free = _held((y_CM + arm * force[1]) / stretch, middle, reach)
    point = (1.0, x, y)
    plane = _times(area.even, point)
    # The rectangle's corner with the lowest pressure.
    lowest = plane[0] + middle * plane[2] - area.half_width * abs(plane[1])
    lifts = lowest - 0.5 * (area.front - area.rear) * abs(plane[2]) < 0.0
    inverse = _inverse_of_touching(area, point, plane, lifts)
    by_x = tuple(x_free * z_CM * by for by in (inverse[1], inverse[3], inverse[4]))
    by_y = tuple(y_free * z_CM / stretch * by for by in (inverse[2], inverse[4], inverse[5]))
    by_stretch = tuple(-y * y_free / stretch * by for by in (inverse[2], inverse[4], inverse[5]))
    return Pressing(_times(inverse, point), by_x, by_y, by_stretch)


def point_load(of: Pressing, x: Any, y: Any, share: Any) -> PointLoad:
    """Load of a point of the nominal contact [m]."""
    pressure = _at(of.plane, x, y)
    # The contact of a point whose load is zero to rounding makes no difference.
    touching = select(pressure > NO_LOAD, share, 0.0)
    slopes = (touching * _at(slope, x, y) for slope in of[1:])
    return PointLoad(touching * pressure, *slopes)


def _held(place: Any, middle: Any, reach: Any) -> tuple[Any, Traced]:
    """Hold a coordinate within reach of the middle; 1 if it was there already, else 0."""
    outside = abs(place - middle) >= reach
    edge = middle + select(place > middle, reach, -reach)
    return select(outside, edge, place), trace.truth_as_number(~outside)


def _at(plane: Plane, x: Any, y: Any) -> Any:
    return plane[0] + plane[1] * x + plane[2] * y


def _times(matrix: Symmetric, vector: Plane) -> Plane:
    a, b, c, d, e, f = matrix
    x, y, z = vector
    return a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z


def _inverse_of_touching(area: ContactArea, point: Plane, plane: Plane, lifts: Traced) -> Symmetric:
    """Inverse of the moments of the points that touch; of all points where none lifts.

    The plane (a, b, c) of the points that touch minimises the dual function, half the sum of share
    times max(0, a + b x + c y)² less the plane at the centre of pressure. Newton's iteration finds it
    from the plane of loads of either sign; a round tests one point of its line search.

    Args:
        area: the contact.
        point: 1, and the centre of pressure [m].
        plane: plane of loads of either sign.
        lifts: truth value of each lane: points may lift off.
    """

    def dual(plane: Plane) -> tuple[Any, Plane, Symmetric]:
        """Dual function, its gradient, and the moments of the points that touch."""

        def terms(x_left: Any, x_right: Any, y: Any, share: Any) -> list[Any]:
            found: list[Any] = [0.0] * 7
            for x in (x_left, x_right):
                pressure = maximum(_at(plane, x, y), 0.0)
                active = select(pressure > 0.0, share, 0.0)
                of_point = (active, active * x, active * y)
                more = [0.5 * active * pressure * pressure, *of_point]
                more += [of_point[1] * x, of_point[1] * y, of_point[2] * y]
                found = [one + term for one, term in zip(found, more, strict=True)]
            return found

        half_square, *moments = trace.total(area.pairs, terms)
        full: Symmetric = tuple(moments)
        pressed = _times(full, plane)
        value = half_square - sum(one * by for one, by in zip(point, plane, strict=True))
        return value, tuple(a - b for a, b in zip(pressed, point, strict=True)), full

    def a_round(*now: Any) -> Any:
        goes_on, size, tries, before, descent, *vectors = now
        plane, step = vectors[:3], vectors[3:]
        trial = tuple(p + size * d for p, d in zip(plane, step, strict=True))
        value, gradient, moments = dual(trial)
        accepted = (value <= before + ARMIJO * size * descent + 1e-15) | (
            tries >= LINE_SEARCH_HALVINGS
        )
        steepest = _times(_inverse(area, moments), gradient)
        next_descent = -sum(d * g for d, g in zip(steepest, gradient, strict=True))
        largest = maximum(maximum(abs(gradient[0]), abs(gradient[1])), abs(gradient[2]))
        reach = maximum(area.front, -area.rear)
        # Planes that press on an edge are steep, and their sums round accordingly.
        steepness = abs(trial[0]) + abs(trial[1]) * area.half_width + abs(trial[2]) * reach
        settled = (largest <= NO_LOAD * (1.0 + steepness)) | (tries >= LINE_SEARCH_HALVINGS)
        unsettled = (goes_on > 0.5) & ~(accepted & settled)
        moves = accepted & (goes_on > 0.5)
        chosen = [
            trace.truth_as_number(unsettled),
            select(accepted, 1.0, 0.5 * size),
            select(accepted, 0.0, tries + 1.0),
            select(accepted, value, before),
            select(accepted, next_descent, descent),
            *(select(moves, new, old) for new, old in zip(trial, plane, strict=True)),
            *(select(accepted, -new, old) for new, old in zip(steepest, step, strict=True)),
        ]
        return chosen, unsettled

    begin = [1.0, 1.0, 0.0, 1e300 if Traced.bits == 64 else 1e30, 0.0, *plane, 0.0, 0.0, 0.0]
    found = trace.repeat(lifts, begin, a_round, TOUCHING_ROUNDS)

    def instead() -> Symmetric:
        _, _, moments = dual((found[5], found[6], found[7]))
        return _inverse(area, moments)

    return tuple(trace.where_needed(lifts, area.even, instead))


def _inverse(area: ContactArea, moments: Symmetric) -> Symmetric:
    """Inverse of moments of 1, x, y; with a ridge if the points are collinear."""
    n, s_x, s_y, xx, xy, yy = moments
    reach = 0.5 * (area.front - area.rear)
    across, along = area.half_width * area.half_width, reach * reach
    c_00, c_01, c_02 = xx * yy - xy * xy, xy * s_y - s_x * yy, s_x * xy - xx * s_y
    collinear = n * c_00 + s_x * c_01 + s_y * c_02 < RIDGE * across * along
    ridge = select(collinear, RIDGE, 0.0)
    n, xx, yy = n + ridge, xx + ridge * across, yy + ridge * along
    c_00, c_01, c_02 = xx * yy - xy * xy, xy * s_y - s_x * yy, s_x * xy - xx * s_y
    per = 1.0 / (n * c_00 + s_x * c_01 + s_y * c_02)
    c_11, c_12, c_22 = n * yy - s_y * s_y, s_x * s_y - n * xy, n * xx - s_x * s_x
    return c_00 * per, c_01 * per, c_02 * per, c_11 * per, c_12 * per, c_22 * per
