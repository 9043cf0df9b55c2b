"""Stationary twist of a tracked vehicle: all forces and moments balance.

The balance (`contact_forces.add_steady_balance`) is solved for many pairs of track speeds. Each stage is
Newton's iteration (compiled) with the analytic Jacobian and step halving on the norm of the balance:

1. from a kinematic guess, which solves most pairs in a few steps;
2. for the others, along a falling sequence of regularising speeds, from nearly viscous ground to the
   soil's own value (if one track's travel stops, or points lift off, the balance has kinks as narrow as
   the regularising speed);
3. for the rest (fast vehicles with a high centre of mass), along rising track speeds in constant ratio,
   from a crawl with negligible inertia to the full speeds: the motion that a vehicle reaches by slow
   acceleration;
4. if that motion ceases to exist in between, from guesses spread over all plausible twists.

Hard turns at high speed can have more than one stationary motion; one of them is found. A pair that no
stage solves is never dropped: it raises an error, or is marked in the result. With both tracks at rest,
friction holds the vehicle, and its twist is zero.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import PaperTwist
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.contact.contact import Contact, ground

# Largest residual of a solved state, as a share of the weight (moments: of the weight times half the
# gauge), and the largest that still counts as converged.
TOLERANCE = 1e-12
CONVERGED = 1e-10
DIRECT_STEPS = 20
# Continuation: the first regularising speed as a share of the largest track speed, the ratio of one to
# the next, and the tolerance of each but the last.
FIRST_REGULARISATION = 0.3
RATIO = 0.4
ROUGH_TOLERANCE = 1e-3
CONTINUATION_STEPS = 5
FINAL_STEPS = 80
SPEED_STEPS = (16, 64)  # rising speeds: numbers of steps, coarse first
# Spread guesses: yaw rates as shares of the ideal differential drive's; forward velocities off the mean
# track speed, and lateral ones, as shares of half the difference of the track speeds.
YAW_SHARES = np.linspace(0.1, 1.1, 11)
FORWARD_SHARES = np.linspace(-1.0, 1.0, 17)
LATERAL_SHARES = (-0.2, 0.0, 0.2)
TYPICAL_ETA = 2.5  # first guess: effective gauge over gauge of a typical skid-steer vehicle


@dataclass(frozen=True)
class SteadyMotion:
    """Stationary motions; every array has the broadcast shape of the track speeds."""

    V_l: Floats  # speed of the left track [m/s]
    V_r: Floats  # speed of the right track [m/s]
    twist: PaperTwist  # velocity of the origin in the paper's axes [m/s, rad/s]
    # largest component of the balance, as a share of the weight (moments: of the weight times half the
    # gauge) [-]
    residual: Floats
    converged: NDArray[np.bool_]  # True if the residual is at most `CONVERGED`
    # True if the force of inertia points outside the contact: the vehicle would tip
    tipping: NDArray[np.bool_]


def solve_steady(
    V_l: ArrayLike, V_r: ArrayLike, contact: Contact, *, strict: bool = True
) -> SteadyMotion:
    """Solve for the stationary motion of each pair of track speeds [m/s].

    They broadcast. If `strict`, a pair that does not converge is an error.

    Raises:
        SimulationError: a track speed is not finite, or (strict) some pairs did not converge.
    """
    left, right = np.broadcast_arrays(np.asarray(V_l, dtype=float), np.asarray(V_r, dtype=float))
    shape, V = left.shape, np.stack([left.ravel(), right.ravel()])
    if not np.isfinite(V).all():
        raise SimulationError("track speeds must be finite numbers, found NaN or infinity")
    solved = _solve(V, contact)
    # Adding zero turns -0.0 into 0.0, which tables would print with a sign.
    twist = PaperTwist(*(component.reshape(shape) + 0.0 for component in solved.twist))
    residual, tipping = solved.residual.reshape(shape), solved.tipping.reshape(shape)
    converged = residual <= CONVERGED
    failed = np.flatnonzero(~converged)
    if strict and failed.size:
        worst = failed[residual.flat[failed].argmax()]
        raise SimulationError(
            f"no stationary motion found for {failed.size} of {converged.size} pairs of track speeds; "
            f"worst at V_l = {left.flat[worst]:.6g} and V_r = {right.flat[worst]:.6g} m/s, where forces "
            f"of {residual.flat[worst]:.1e} times the weight are not balanced"
        )
    return SteadyMotion(left.copy(), right.copy(), twist, residual, converged, tipping)


def track_speed_grid(count: int = 21) -> tuple[Floats, Floats]:
    """Grid of evenly spaced track speeds in [-1, 1] [m/s].

    Returns V_l and V_r, each (count, count), with V_l along the first axis. The default is the paper's
    grid of 441 pairs (section II).
    """
    # Integers divided, so that equal, opposite and zero speeds are exactly that.
    speeds = np.arange(1 - count, count, 2) / (count - 1)
    V_l, V_r = np.meshgrid(speeds, speeds, indexing="ij")
    return V_l, V_r


class _Solved(NamedTuple):
    """Twists (3, n), largest component of the residual, and whether it tips (n,)."""

    twist: Floats
    residual: Floats
    tipping: NDArray[np.bool_]


def _solve(V: Floats, contact: Contact) -> _Solved:
    """Apply the module's stages in turn, each to the pairs that are not solved yet."""
    start = _guess(V, contact)
    solved = _newton(start, V, contact, DIRECT_STEPS, TOLERANCE)
    unsolved = np.flatnonzero(solved.residual > TOLERANCE)
    if unsolved.size:
        softened = _along_regularisation(start[:, unsolved], V[:, unsolved], contact)
        _keep_better(solved, unsolved, softened)
    for steps in SPEED_STEPS:
        unsolved = np.flatnonzero(solved.residual > CONVERGED)
        if not unsolved.size:
            break
        _keep_better(solved, unsolved, _along_speed(V[:, unsolved], contact, steps))
    for pair in np.flatnonzero(solved.residual > CONVERGED):
        _keep_better(solved, np.array([pair]), _from_spread_guesses(V[:, pair], contact))
    return solved


def _keep_better(solved: _Solved, pairs: NDArray[np.intp], candidate: _Solved) -> None:
    """Overwrite solutions of pairs for which the candidate has a smaller residual."""
    is_better = candidate.residual < solved.residual[pairs]
    for values, better in zip(solved, candidate, strict=True):
        values[..., pairs[is_better]] = better[..., is_better]


def _along_regularisation(start: Floats, V: Floats, contact: Contact) -> _Solved:
    """Newton's iteration along a falling sequence of regularising speeds."""
    target = contact.soil.regularising_speed
    speed, twist = FIRST_REGULARISATION * max(float(np.abs(V).max()), target), start
    while speed > target:
        soil = msgspec.structs.replace(contact.soil, regularising_speed=speed)
        softer = replace(contact, soil=soil)
        twist = _newton(twist, V, softer, CONTINUATION_STEPS, ROUGH_TOLERANCE).twist
        speed *= RATIO
    return _newton(twist, V, contact, FINAL_STEPS, TOLERANCE)


def _along_speed(V: Floats, contact: Contact, steps: int) -> _Solved:
    """Newton's iteration along rising track speeds, each from the last motion, scaled."""
    twist = _guess(V, contact)
    for step in range(1, steps):
        share = step / steps
        twist = _newton(share * twist, share * V, contact, FINAL_STEPS, TOLERANCE).twist / share
    return _newton(twist, V, contact, FINAL_STEPS, TOLERANCE)


def _from_spread_guesses(pair: Floats, contact: Contact) -> _Solved:
    """Best solution for one pair of track speeds (2,) from spread guesses."""
    left, right = pair
    difference = np.abs(right - left)
    yaw, forward, lateral = np.meshgrid(YAW_SHARES, FORWARD_SHARES, LATERAL_SHARES)
    w = yaw.ravel() * (right - left) / contact.geometry.gauge
    v_x = contact.body.y_CM * w + 0.5 * difference * lateral.ravel()
    v_y = pair.mean() + 0.5 * difference * forward.ravel()
    guesses, repeated_V = np.stack([v_x, v_y, w]), np.repeat(pair[:, None], w.size, axis=1)
    solved = _newton(guesses, repeated_V, contact, FINAL_STEPS, TOLERANCE)
    if solved.residual.min() > CONVERGED:
        solved = _along_regularisation(guesses, repeated_V, contact)
    best = [int(solved.residual.argmin())]
    return _Solved(solved.twist[:, best], solved.residual[best], solved.tipping[best])


def _newton(start: Floats, V: Floats, contact: Contact, steps: int, tolerance: float) -> _Solved:
    """Newton's iteration with step halving; the best twists, solved or not."""
    from icreckon.simulation.contact.contact_forces import newton_of_many

    twist, residual = np.array(start.T, order="C"), np.full(V.shape[1], np.inf)
    tipping, V = np.zeros(V.shape[1], dtype=bool), np.ascontiguousarray(V.T)
    newton_of_many(ground(contact), V, steps, tolerance, twist, residual, tipping)
    return _Solved(twist.T, residual, tipping)


def _guess(V: Floats, contact: Contact) -> Floats:
    """Twist (3, n) of a typical vehicle; its centre of mass moves straight ahead."""
    left, right = V
    w = (right - left) / (TYPICAL_ETA * contact.geometry.gauge)
    return np.stack([contact.body.y_CM * w, V.mean(axis=0), w])
