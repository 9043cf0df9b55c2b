"""Step of the friction motion model and of its derivatives, in traced numbers.

The body's twist v about the origin follows the tracks by the forces F of
`icreckon.estimator.friction.forces`. A step of h seconds is implicit in the stiff part, friction, and
explicit in the slow parts, the loads and the force of inertia I:

    A (v' - v) = h (F(v', V, loads(q)) + I(v) + M g)
    q' = k q - (1 - k) F(v', V, loads(q)),  k = exp(-h / T)

A is the mass matrix about the origin, V are the track speeds, g is gravity along the ground (at most what
friction holds) and q is the force at the centre of mass that transfers load, with the lag T of a body
that rolls and pitches on its suspension. At given loads friction has a potential, so v' is the minimum of
a convex function, which Newton's iteration with a line search finds from any start. The friction's
regularising speed is that of `FrictionMotion`, well above that of the soil.

The derivatives of v and q by parameters and gravity are integrated, too (forward sensitivities, from the
implicit function theorem at each step), and those of v by the track speeds of the step alone.

Symbols and axes are the paper's. Jacobians are tuples of rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from icreckon.estimator.friction.forces import (
    Body,
    Matrix,
    Substep,
    Three,
    all_forces,
    body_at,
    forces,
    rolling_loads,
)
from icreckon.estimator.friction.layout import (
    AT_INPUTS,
    AT_SPEEDS,
    FRICTION,
    INPUTS,
    OF_SENSITIVITIES,
    OF_SPEEDS,
    OF_STATES,
    PARAMETERS,
    STARTED,
    STATES,
    TURN,
    X_CM,
    Y_CM,
)
from icreckon.estimator.friction.loads import pressing
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.trace import Table, Traced, maximum, minimum, select

# Highest number of rounds of Newton's iteration, with those of its line searches.
NEWTON_ROUNDS, LINE_SEARCHES = 100, 10
# Newton's iteration ends with a step below this [m/s, rad/s], by bits of a number. The error is below its
# square over the regularising speed then.
SETTLED = {64: 1e-7, 32: 1e-5}
# A Newton step that overshoots the minimum is shortened, unless its slope there is below this share of
# the initial slope.
OVERSHOOT = 0.5
# Gravity along the ground is at most this share of what friction holds: on steeper ground the robot would
# slide away, ever faster.
LARGEST_PULL = 0.9
# Slower turns do not determine indices [rad/s].
TURNS, LARGEST_ETA = 0.1, 20.0


class FrictionRows(NamedTuple):
    """Numbers of a friction model that a substep changes.

    Attributes:
        memory: (MEMORY,) see `icreckon.estimator.friction.layout`.
        carried: (4,) see `layout.CARRIED`.
    """

    memory: list[Any]
    carried: list[Any]


def substep(
    before: FrictionRows,
    inputs: Sequence[Any],
    V: tuple[Any, Any],
    constants: Mapping[str, Traced],
    pairs: Table,
    *,
    sheared: bool,
    estimated: Sequence[int] = range(INPUTS),
) -> FrictionRows:
    """Integrate a substep at constant track speeds.

    Args:
        before: numbers before it.
        inputs: (INPUTS,) present estimate of parameters and gravity.
        V: speeds of the left and the right track [m/s].
        constants: `layout.SUBSTEP_CONSTANTS` and `layout.BODY_CONSTANTS` by name.
        pairs: pairs of contact points, see `icreckon.estimator.friction.loads`.
        sheared: friction builds up with the shear displacement.
        estimated: places of the inputs by which derivatives are computed. Those by parameters whose
            constant `estimated` is 0 stay zero, so that variants share code.
    """
    memory, c = before.memory, constants
    h, keep = c["h"], c["keep"]
    y = list(memory[OF_STATES])
    flat = memory[OF_SENSITIVITIES]
    S = [[flat[INPUTS * row + k] for row in range(STATES)] for k in range(INPUTS)]
    # Updates since the last step change its final state.
    for k in range(INPUTS):
        change = inputs[k] - memory[AT_INPUTS.start + k]
        y = [one + slope * change for one, slope in zip(y, S[k], strict=True)]
    body = body_at(c, pairs, inputs[:PARAMETERS], sheared=sheared)
    start, q = (y[0], y[1], y[2]), (y[3], y[4])
    held = _held(body, inputs[PARAMETERS], inputs[PARAMETERS + 1])
    pulled = zip(_force_of_inertia(body, start), _pull(body, held.gravity), strict=True)
    inertia: Three = tuple(one + other for one, other in pulled)
    loads = pressing(body.area, body.centre, body.stretch, c["weight"], q)
    step = Substep(body, V, start, inertia, loads, rolling_loads(body, loads))
    # What the track speeds changed in the last substep, they change in this one, about.
    of_speeds = memory[OF_SPEEDS]
    change = [one - other for one, other in zip(V, memory[AT_SPEEDS], strict=True)]
    guess = tuple(
        start[k] + of_speeds[2 * k] * change[0] + of_speeds[2 * k + 1] * change[1] for k in range(3)
    )
    v = _minimise(step, h, guess)
    F = all_forces(step, v, q)
    inverse = _inverse(_minus(body.mass, h, F.by_twist))
    direct = _direct(step, v, h)
    direct[FRICTION] = tuple(h * one for one in _pull(body, held.by_friction))

    def carry(slopes: Sequence[Any], by_force: Three, momentum: Three) -> list[Any]:
        """Propagate the derivatives (STATES,) of the state by one quantity.

        `by_force` is the derivative of F by it at given twist and loads, and `momentum` that of
        h I - A (v' - v) at given twists.
        """
        by_load = zip(by_force, F.by_right, F.by_forward, strict=True)
        explicit = [by + r * slopes[3] + f * slopes[4] for by, r, f in by_load]
        of_inertia = _force_of_inertia(body, start, (slopes[0], slopes[1], slopes[2]))
        side = [
            h * (force + more) + other + _dot(row, slopes)
            for force, more, other, row in zip(
                explicit, of_inertia, momentum, body.mass, strict=True
            )
        ]
        rise = [_dot(row, side) for row in inverse]
        of_force = [one + _dot(row, rise) for one, row in zip(explicit, F.by_twist, strict=True)]
        return [*rise, *(keep * slopes[3 + k] - (1.0 - keep) * of_force[k] for k in range(2))]

    for k in estimated:
        if k < PARAMETERS:
            is_estimated = c[f"estimated{k}"]
            by_force = tuple(is_estimated * one for one in F.by_parameters[k])
            momentum = tuple(is_estimated * one for one in direct[k])
        else:
            by_force = (0.0, 0.0, 0.0)
            momentum = tuple(h * one for one in _pull(body, held.by_gravity[k - PARAMETERS]))
        S[k] = carry(S[k], by_force, momentum)
    after_B = []
    for track in range(2):
        rows = [of_speeds[2 * row + track] for row in range(3)] + before.carried[track::2]
        slopes = [select(c["is_first"] > 0.5, 0.0, row) for row in rows]
        after_B.append(carry(slopes, F.by_speeds[track], (0.0, 0.0, 0.0)))
    after = list(memory)
    after[OF_STATES] = [*v, *(keep * q[k] - (1.0 - keep) * F.values[k] for k in range(2))]
    after[OF_SENSITIVITIES] = [S[k][row] for row in range(STATES) for k in range(INPUTS)]
    after[OF_SPEEDS] = [after_B[track][row] for row in range(3) for track in range(2)]
    after[AT_INPUTS] = list(inputs)
    after[AT_SPEEDS] = list(V)
    after[TURN] = _indices(memory[TURN], v, V, c)
    after[STARTED] = 1.0
    return FrictionRows(after, [after_B[track][3 + k] for k in range(2) for track in range(2)])


def _force_of_inertia(body: Body, v: Three, slopes: Three | None = None) -> Three:
    """Force and moment of inertia I, or their derivatives for slopes of the twist."""
    M, (x, y, _), (v_x, v_y, w) = body.constants["mass"], body.centre, v
    if slopes is None:
        right, forward = M * w * (v_y + x * w), M * w * (y * w - v_x)
    else:
        s_x, s_y, s_w = slopes
        right = M * (s_w * (v_y + 2.0 * x * w) + w * s_y)
        forward = M * (s_w * (2.0 * y * w - v_x) - w * s_x)
    return right, forward, x * forward - y * right


class _Held(NamedTuple):
    """Gravity along the ground that friction holds, and its derivatives.

    Attributes:
        gravity: (2,) right and forward [m/s²].
        by_gravity: its derivatives by both components of all gravity.
        by_friction: its derivative by the friction [m/s²].
    """

    gravity: tuple[Any, Any]
    by_gravity: tuple[tuple[Any, Any], tuple[Any, Any]]
    by_friction: tuple[Any, Any]


def _held(body: Body, right: Any, forward: Any) -> _Held:
    """Limit gravity along the ground to `LARGEST_PULL` of the least friction."""
    left_track, right_track = body.friction[:2], body.friction[2:]
    limit = (LARGEST_PULL * GRAVITY) * minimum(minimum(*left_track), minimum(*right_track))
    square = right * right + forward * forward
    steep = square > limit * limit
    is_steep = trace.truth_as_number(steep)
    per_size = is_steep / select(steep, square, 1.0) ** 0.5
    share = select(steep, limit * per_size, 1.0)
    x, y = right * per_size, forward * per_size
    per_friction = limit / body.parameters[FRICTION]
    return _Held(
        (share * right, share * forward),
        ((share * (1.0 - x * x), -share * x * y), (-share * x * y, share * (1.0 - y * y))),
        (per_friction * x, per_friction * y),
    )


def _pull(body: Body, gravity: Sequence[Any]) -> Three:
    """Force and moment of gravity along the ground [m/s²]."""
    M, (x, y, _), (right, forward) = body.constants["mass"], body.centre, gravity
    return M * right, M * forward, M * (x * forward - y * right)


def _direct(step: Substep, v: Three, h: Any) -> list[Three]:
    """Derivatives of h I - A (v' - v) by the parameters: those of the centre of mass."""
    M, (x, y, _), (_, _, w) = step.body.constants["mass"], step.body.centre, step.start
    d_x, d_y, d_w = (one - other for one, other in zip(v, step.start, strict=True))
    right, forward, _ = step.inertia
    found: list[Three] = [(0.0, 0.0, 0.0)] * PARAMETERS
    by_x = h * (forward - y * M * w * w) - M * (d_y + 2.0 * x * d_w)
    by_y = h * (x * M * w * w - right) - M * (2.0 * y * d_w - d_x)
    found[X_CM] = h * M * w * w, -M * d_w, by_x
    found[Y_CM] = M * d_w, h * M * w * w, by_y
    return found


def _minimise(step: Substep, h: Any, guess: Three) -> Three:
    """Find the twist at the end of a substep, from a guess."""
    settled = SETTLED[Traced.bits]

    def a_round(*now: Any) -> Any:
        """Test a point along the present step; compute the next step, or shorten it."""
        goes_on, share, slope, tries = now[:4]
        v, move = now[4:7], now[7:]
        trial: Three = tuple(one - share * by for one, by in zip(v, move, strict=True))
        F, by_twist = forces(step, trial)
        gradient = [
            _dot(row, [one - other for one, other in zip(trial, step.start, strict=True)])
            - h * (force + more)
            for row, force, more in zip(step.body.mass, F, step.inertia, strict=True)
        ]
        there = -_dot(gradient, move)
        accepted = (there <= -OVERSHOOT * slope) | (tries >= LINE_SEARCHES)
        inverse = _inverse(_minus(step.body.mass, h, by_twist))
        newton = [_dot(row, gradient) for row in inverse]
        largest = maximum(maximum(abs(newton[0]), abs(newton[1])), abs(newton[2]))
        moves, ends = accepted & (goes_on > 0.5), accepted & (largest < settled)
        unsettled = (goes_on > 0.5) & ~ends
        last_step = [select(ends, by, 0.0) for by in newton]
        overshot = select(accepted, 1.0, slope - there)
        results = [
            trace.truth_as_number(unsettled),
            select(accepted, 1.0, share * maximum(0.1, slope / overshot)),
            select(accepted, -_dot(gradient, newton), slope),
            select(accepted, 1.0, tries + 1.0),
            *(select(moves, a - b, old) for a, b, old in zip(trial, last_step, v, strict=True)),
            *(select(accepted, new, old) for new, old in zip(newton, move, strict=True)),
        ]
        return results, unsettled

    # The first round computes the first step.
    begin = [1.0, 1.0, 0.0, 1.0, *guess, 0.0, 0.0, 0.0]
    found = trace.repeat(True, begin, a_round, NEWTON_ROUNDS)
    return found[4], found[5], found[6]


def _indices(
    before: Sequence[Any], v: Three, V: tuple[Any, Any], c: Mapping[str, Any]
) -> list[Any]:
    """Indices of the newest turns, averaged."""
    v_x, v_y, w = v
    turns = abs(w) > TURNS
    share = select(turns, c["turn_share"], 0.0)
    per_w = 1.0 / select(turns, w, 1.0)
    eta = (V[1] - V[0]) * per_w / (2.0 * c["half_gauge"])
    now = (
        v_x * per_w,
        (0.5 * (V[0] + V[1]) - v_y) * per_w,
        minimum(LARGEST_ETA, maximum(1.0, eta)),
    )
    return [one + share * (new - one) for one, new in zip(before, now, strict=True)]


def _dot(row: Sequence[Any], vector: Sequence[Any]) -> Any:
    return row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2]


def _minus(matrix: Matrix, factor: Any, other: Matrix) -> Matrix:
    """Matrix minus a multiple of another."""
    return tuple(
        tuple(one - factor * by for one, by in zip(row, by_row, strict=True))
        for row, by_row in zip(matrix, other, strict=True)
    )


def _inverse(matrix: Matrix) -> Matrix:
    """Inverse of a 3 by 3 matrix, zero if it is singular."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    first, second, third = e * i - f * h, f * g - d * i, d * h - e * g
    determinant = a * first + b * second + c * third
    singular = determinant == 0.0
    per = select(singular, 0.0, 1.0 / select(singular, 1.0, determinant))
    return (
        (first * per, (c * h - b * i) * per, (b * f - c * e) * per),
        (second * per, (a * i - c * g) * per, (c * d - a * f) * per),
        (third * per, (b * g - a * h) * per, (a * e - b * d) * per),
    )
