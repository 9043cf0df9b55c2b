"""The algebra of `estimator.filter.ekf`, for numba: in place, and without what is zero.

A twist model here is arrays that are written to: the twist (3,), its derivatives by the state (3, SIZE)
and by the track speeds (3, 2). Of a transition only the rows of the pose and the decay of the slip differ
from the identity. Covariances are kept symmetric to the last bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.motion.bounds import BOUND_ROUNDS, ROUNDING
from icreckon.estimator.motion.propagation import fading, gauss_markov_noise, step_on_se2
from icreckon.estimator.scalar_engine.motion_kernel import fits_model, linearise
from icreckon.estimator.tracing.jit_kernel import entry

SIZE = s.SIZE
POSE_END = s.POSE.stop
SLIP, FAST, PARAMETERS = s.SLIP.start, s.FAST_SLIP.start, s.PARAMETERS.start
# From the paper's axes: forward is its second, left minus its first.
PAPER_AXIS = (1, 0, 2)
PAPER_SIGN = (1.0, -1.0, 1.0)


def fill_twist(
    x: Floats,
    kind: int,
    constants: Floats,
    memory: Floats,
    left: float,
    right: float,
    slip_share: float,
    twist: Floats,
    jacobian: Floats,
    by_speeds: Floats,
) -> Any:
    """Work out the twist model, see `IcrEkf.twist_model`; returns the motion."""
    scale = 1.0 + x[s.TRACK_SCALE]
    forward = slip_share * x[SLIP] + x[FAST]
    sideways = slip_share * x[SLIP + 1] + x[FAST + 1]
    turning = slip_share * x[SLIP + 2] + x[FAST + 2]
    p = PARAMETERS
    parameters = (x[p], x[p + 1], x[p + 2], x[p + 3], x[p + 4], x[p + 5], x[p + 6], x[p + 7])
    motion, by = linearise(
        kind,
        constants,
        memory,
        left * scale,
        right * scale,
        parameters,
        (-sideways, forward, turning),
    )
    in_paper = (motion.twist.v_x, motion.twist.v_y, motion.twist.w)
    jacobian[:] = 0.0
    for i in range(3):
        axis, sign = PAPER_AXIS[i], PAPER_SIGN[i]
        twist[i] = sign * in_paper[axis]
        for j in range(3):
            by_slip = sign * PAPER_SIGN[j] * by.by_slip[axis][PAPER_AXIS[j]]
            jacobian[i, SLIP + j] = slip_share * by_slip
            jacobian[i, FAST + j] = by_slip
        for j in range(8):
            jacobian[i, PARAMETERS + j] = sign * by.by_parameters[axis][j]
        by_left, by_right = sign * by.by_speeds[axis][0], sign * by.by_speeds[axis][1]
        jacobian[i, s.TRACK_SCALE] = by_left * left + by_right * right
        by_speeds[i, 0], by_speeds[i, 1] = scale * by_left, scale * by_right
    return motion


def move(
    x: Floats,
    P: Floats,
    dt: float,
    twist: Floats,
    jacobian: Floats,
    sigma: tuple[float, float, float],
    time_constant: float,
    walk: Floats,
    pose_rows: Floats,
    with_pose: Floats,
) -> Any:
    """Propagate over `dt` seconds at the mean twist of the step, see `IcrEkf.predict_motion`.

    Args:
        x: (SIZE,) the state.
        P: (SIZE, SIZE) its covariance.
        dt: of the step [s].
        twist: (3,) mean of the step.
        jacobian: (3, SIZE) its derivative.
        sigma: standard deviation of the slip.
        time_constant: of the slip [s].
        walk: (SIZE,) random-walk densities of the states.
        pose_rows: (3, SIZE) overwritten with those of the transition.
        with_pose: (3, SIZE) overwritten with those of the noise.

    Returns:
        What the step adds to the pose.
    """
    decay, _ = fading(dt, time_constant)
    integral, cross, final = gauss_markov_noise(dt, time_constant)
    step, by_yaw, by_motion = step_on_se2(x[s.YAW], (twist[0] * dt, twist[1] * dt, twist[2] * dt))
    by_state = np.zeros((3, SIZE))
    for i in range(3):
        for k in range(3):
            for j in range(SIZE):
                by_state[i, j] += by_motion[i][k] * jacobian[k, j]
        for j in range(SIZE):
            pose_rows[i, j] = by_state[i, j] * dt
            with_pose[i, j] = by_state[i, j] * (walk[j] * walk[j]) * (0.5 * dt * dt)
        pose_rows[i, i] += 1.0
        for j in range(3):
            with_pose[i, SLIP + j] += by_motion[i][j] * (sigma[j] * sigma[j]) * cross
    pose_rows[0, s.YAW] += by_yaw[0]
    pose_rows[1, s.YAW] += by_yaw[1]
    cubed = dt * dt * dt / 3.0
    for i in range(3):
        for k in range(i, 3):
            walked = slipped = 0.0
            for j in range(SIZE):
                walked += by_state[i, j] * by_state[k, j] * (walk[j] * walk[j])
            for j in range(3):
                slipped += by_motion[i][j] * by_motion[k][j] * (sigma[j] * sigma[j])
            with_pose[i, k] = with_pose[k, i] = walked * cubed + slipped * integral
    _transform(P, pose_rows, decay)
    for i in range(3):
        for j in range(SIZE):
            P[i, j] += with_pose[i, j]
            if j >= POSE_END:
                P[j, i] = P[i, j]
    for i in range(SIZE):
        P[i, i] += walk[i] * walk[i] * dt
    for i in range(3):
        P[SLIP + i, SLIP + i] += sigma[i] * sigma[i] * final
        x[i] += step[i]
        x[SLIP + i] *= decay
    return step


def _transform(P: Floats, pose_rows: Floats, decay: float) -> None:
    """P becomes F P F', of which F the rows of the pose and the decay of the slip are given."""
    carried = np.zeros((3, SIZE))
    for i in range(3):
        for k in range(SIZE):
            share = pose_rows[i, k]
            if share != 0.0:
                for j in range(SIZE):
                    carried[i, j] += share * P[k, j]
    of_pose = np.empty((3, 3))
    for i in range(3):
        for k in range(i, 3):
            of_pose[i, k] = of_pose[k, i] = inner(carried[i], pose_rows[k])
    for i in range(SLIP, SLIP + 3):
        for j in range(SIZE):
            P[i, j] *= decay
        for j in range(SIZE):
            P[j, i] *= decay
        for k in range(3):
            carried[k, i] *= decay
    for i in range(3):
        for j in range(3):
            P[i, j] = of_pose[i, j]
        for j in range(POSE_END, SIZE):
            P[i, j] = P[j, i] = carried[i, j]


def renew(x: Floats, P: Floats, covariance: Any) -> None:
    """See `IcrEkf.renew_fast_slip`; the covariance as three rows."""
    for i in range(FAST, FAST + 3):
        x[i] = 0.0
        for j in range(SIZE):
            P[i, j] = P[j, i] = 0.0
    for i in range(3):
        for j in range(3):
            P[FAST + i, FAST + j] = covariance[i][j]


def multiply(P: Floats, row: Floats, cross: Floats) -> None:
    """Write P row to `cross`."""
    cross[:] = 0.0
    for k in range(SIZE):
        share = row[k]
        if share != 0.0:
            for j in range(SIZE):
                cross[j] += share * P[k, j]


def inner(a: Floats, b: Floats) -> float:
    """Of two vectors."""
    total = 0.0
    for k in range(SIZE):
        total += a[k] * b[k]
    return total


def update(
    x: Floats,
    P: Floats,
    residual: float,
    cross: Floats,
    expected: float,
    kept: int,
    gain: Floats,
) -> None:
    """See `IcrEkf.update_scalar`.

    Args:
        x: (SIZE,) the state.
        P: (SIZE, SIZE) its covariance.
        residual: measured less predicted.
        cross: (SIZE,) P times the Jacobian of the prediction.
        expected: variance of the residual.
        kept: the states that are not to be moved, a bit each.
        gain: (SIZE,) overwritten with what was used.
    """
    half = np.empty(SIZE)
    for k in range(SIZE):
        gain[k] = 0.0 if (kept >> k) & 1 else cross[k] / expected
        half[k] = cross[k] - (0.5 * expected) * gain[k]
        x[k] += gain[k] * residual
    for i in range(SIZE):
        for j in range(SIZE):
            P[i, j] -= gain[i] * half[j] + gain[j] * half[i]


def move_inside(x: Floats, P: Floats, bounds: Floats, kept: int, considered: int) -> None:
    """See `IcrEkf.keep_inside_bounds`.

    Args:
        x: (SIZE,) the state.
        P: (SIZE, SIZE) its covariance.
        bounds: (n, 9) of the parameters.
        kept: the states that are not moved, a bit each.
        considered: those of them that nothing ever moves.
    """
    cross = np.empty(SIZE)
    for _ in range(BOUND_ROUNDS):
        moved = False
        for bound in range(len(bounds)):
            short = bounds[bound, 8]
            for k in range(8):
                short -= bounds[bound, k] * x[PARAMETERS + k]
            if short <= ROUNDING:
                continue
            cross[:] = 0.0
            for k in range(8):
                if not (considered >> (PARAMETERS + k)) & 1:
                    for j in range(SIZE):
                        cross[j] += bounds[bound, k] * P[PARAMETERS + k, j]
            spread = 0.0
            for k in range(8):
                if not (considered >> (PARAMETERS + k)) & 1:
                    spread += bounds[bound, k] * cross[PARAMETERS + k]
            if spread > 0.0:
                for j in range(SIZE):
                    if not (kept >> j) & 1:
                        x[j] += cross[j] * (short / spread)
                moved = True
        if not moved:
            break


def _predict(
    x: Floats,
    P: Floats,
    dt: float,
    twist: Floats,
    jacobian: Floats,
    slip_x: float,
    slip_y: float,
    slip_w: float,
    time_constant: float,
    walk: Floats,
    F: Floats,
    Q: Floats,
) -> Any:
    """`move`, with transition and noise written out (SIZE, SIZE)."""
    sizes_fit = fits_filter(x, P) and F.shape == (SIZE, SIZE) and Q.shape == (SIZE, SIZE)
    sizes_fit &= jacobian.shape == (3, SIZE) and twist.shape == (3,) and walk.shape == (SIZE,)
    if not sizes_fit:
        raise ValueError(WRONG_SIZE)
    pose_rows, with_pose = np.empty((3, SIZE)), np.empty((3, SIZE))
    sigma = (slip_x, slip_y, slip_w)
    step = move(x, P, dt, twist, jacobian, sigma, time_constant, walk, pose_rows, with_pose)
    decay, _ = fading(dt, time_constant)
    _, _, final = gauss_markov_noise(dt, time_constant)
    F[:] = 0.0
    Q[:] = 0.0
    for i in range(SIZE):
        F[i, i] = 1.0
    for i in range(3):
        F[SLIP + i, SLIP + i] = decay
        for j in range(SIZE):
            F[i, j] = pose_rows[i, j]
            Q[i, j] = Q[j, i] = with_pose[i, j]
    for i in range(SIZE):
        Q[i, i] += walk[i] * walk[i] * dt
    for i in range(3):
        Q[SLIP + i, SLIP + i] += sigma[i] * sigma[i] * final
    return step


def fits_filter(x: Floats, P: Floats) -> bool:
    """Compare the sizes of state and covariance with those of the filter."""
    return x.shape == (SIZE,) and P.shape == (SIZE, SIZE)


def _renew_by(x: Floats, P: Floats, covariance: Floats) -> None:
    if not (fits_filter(x, P) and covariance.shape == (3, 3)):
        raise ValueError(WRONG_SIZE)
    renew(x, P, covariance)


def _expected(P: Floats, row: Floats, variance: float) -> float:
    if not fits_filter(row, P):
        raise ValueError(WRONG_SIZE)
    cross = np.empty(SIZE)
    multiply(P, row, cross)
    return inner(row, cross) + variance


def _update_by(
    x: Floats,
    P: Floats,
    residual: float,
    row: Floats,
    variance: float,
    kept: int,
    cross: Floats,
    gain: Floats,
) -> float:
    if not (fits_filter(x, P) and row.shape == cross.shape == gain.shape == (SIZE,)):
        raise ValueError(WRONG_SIZE)
    multiply(P, row, cross)
    expected = inner(row, cross) + variance
    update(x, P, residual, cross, expected, kept, gain)
    return expected


def _fill_twist_of(
    x: Floats,
    kind: int,
    constants: Floats,
    memory: Floats,
    left: float,
    right: float,
    slip_share: float,
    twist: Floats,
    jacobian: Floats,
    by_speeds: Floats,
) -> Any:
    sizes_fit = x.shape == (SIZE,) and fits_model(kind, constants, np.empty((0, 9)), memory)
    sizes_fit &= twist.shape == (3,) and jacobian.shape == (3, SIZE) and by_speeds.shape == (3, 2)
    if not sizes_fit:
        raise ValueError(WRONG_SIZE)
    return fill_twist(
        x, kind, constants, memory, left, right, slip_share, twist, jacobian, by_speeds
    )


twist_entry = entry(_fill_twist_of)
predict_entry = entry(_predict)
renew_entry = entry(_renew_by)
expected_entry = entry(_expected)
update_entry = entry(_update_by)
