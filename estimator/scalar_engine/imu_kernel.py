"""A step of the filter with an IMU sample at its end, all at once, for numba.

It does what `estimator.filter.filter` does one thing at a time, in the same order and with the same
numbers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.filter.ekf import IMU_KEPT
from icreckon.estimator.filter.gate import REACQUIRED, REJECTED, inflation, verdict
from icreckon.estimator.filter.process_noise import (
    fast_slip_density,
    share_of_walk,
    sideways_density,
    slip_at,
)
from icreckon.estimator.motion.propagation import fading
from icreckon.estimator.scalar_engine.ekf_kernel import (
    PARAMETERS,
    SIZE,
    fill_twist,
    inner,
    move,
    move_inside,
    multiply,
    renew,
    update,
)
from icreckon.estimator.scalar_engine.motion_kernel import fits_model, steering_efficiency
from icreckon.estimator.sensors.sensor_models import (
    STANDSTILL_VARIANCE,
    ImuConstants,
    TrackChange,
    accelerometer_forecast,
    gyro_variance,
    shift,
)
from icreckon.estimator.tracing.jit_kernel import entry

KEPT = sum(1 << index for index in IMU_KEPT)
NOT_ASKED = -1
# Numbers of the robot: those of the slip, four of the IMU, threshold and patience of the gates.
NUMBERS = 14


class SlipNumbers(NamedTuple):
    """The numbers of `estimator.robot.robot_file.Slip`."""

    turning_x: float
    turning_y: float
    turning_w: float
    driving_x: float
    driving_y: float
    driving_w: float
    time_constant: float
    white_time: float


def imu_step(
    x: Floats,
    P: Floats,
    kind: int,
    constants: Floats,
    bounds: Floats,
    memory: Floats,
    regressors: Floats,
    regressors_share: float,
    numbers: Floats,
    walks: Floats,
    considered: int,
    stands: bool,
    pushed: bool,
    dt: float,
    smooth_left: float,
    smooth_right: float,
    left: float,
    right: float,
    mean_left: float,
    mean_right: float,
    left_density: float,
    right_density: float,
    gap_density: float,
    acceleration_left: float,
    acceleration_right: float,
    window: float,
    speed_variance: float,
    age: float,
    interval: float,
    rate: float,
    force: float,
    with_force: bool,
    gyro_rejected: int,
    accelerometer_rejected: int,
) -> Any:
    """Draw the fast slip, take the gyro and the accelerometer, and propagate.

    Args:
        x: (SIZE,) the state.
        P: (SIZE, SIZE) its covariance.
        kind: of the motion model.
        constants: of the motion model, see `estimator.scalar_engine.motion_kernel`.
        bounds: (n, 9) of the parameters.
        memory: of the motion model.
        regressors: (3, 8) derivatives by the parameters, which follow those of the moment ...
        regressors_share: ... by this share.
        numbers: of the robot, see `estimator.scalar_engine.compiled_step`.
        walks: (2, SIZE) random walks of the biases, and of the parameters at their full rate, per √s.
        considered: the states that nothing moves, a bit each.
        stands: whether the robot was found standing.
        pushed: whether it may be turning with its tracks at rest.
        dt: of the step [s].
        smooth_left: smoothed speed of the left track [m/s].
        smooth_right: of the right.
        left: speed of the left track to go by at the start of the step [m/s].
        right: of the right.
        mean_left: mean speed of the left track over the step [m/s].
        mean_right: of the right.
        left_density: of the error of the left track's speed [m²/s].
        right_density: of the right.
        gap_density: of what the speeds may have changed by in a gap [m²/s].
        acceleration_left: of the left track [m/s²].
        acceleration_right: of the right.
        window: time that these are an average of [s].
        speed_variance: of each track's speed, from its sensor's noise [m²/s²].
        age: of what the track speeds are an average of [s].
        interval: time between IMU samples [s].
        rate: as the gyros say [rad/s].
        force: specific force to the left, as the accelerometers say [m/s²].
        with_force: whether the accelerometers are to be used.
        gyro_rejected: rejections in a row of the gyro's gate.
        accelerometer_rejected: of the accelerometer's.

    Returns:
        Of the gyro: verdict, residual, the variance that this should have, and its NIS; the same of the
        accelerometer, with `NOT_ASKED` for a verdict where it was not.

    Raises:
        ValueError: an array has the wrong size.
    """
    sizes_fit = x.shape == (SIZE,) and P.shape == (SIZE, SIZE) and walks.shape == (2, SIZE)
    sizes_fit &= regressors.shape == (3, 8) and numbers.shape == (NUMBERS,)
    if not (sizes_fit and fits_model(kind, constants, bounds, memory)):
        raise ValueError(WRONG_SIZE)
    slip = SlipNumbers(
        numbers[0],
        numbers[1],
        numbers[2],
        numbers[3],
        numbers[4],
        numbers[5],
        numbers[6],
        numbers[7],
    )
    imu = ImuConstants(numbers[8], numbers[9], numbers[10], numbers[11])
    threshold, patience = numbers[12], int(numbers[13])
    kept = KEPT | considered
    gauge = constants[0]
    acceleration = (acceleration_left, acceleration_right)
    change = TrackChange(acceleration, window, speed_variance, age)
    twist, jacobian, by_speeds = np.empty(3), np.empty((3, SIZE)), np.empty((3, 2))
    row, cross, gain = np.empty(SIZE), np.empty(SIZE), np.empty(SIZE)

    eta = steering_efficiency(kind, constants, x[s.PARAMETERS])
    sigma = slip_at(smooth_left, smooth_right, slip, gauge, eta, pushed)
    x[s.FAST_SLIP] = 0.0
    fill_twist(x, kind, constants, memory, left, right, 1.0, twist, jacobian, by_speeds)
    for i in range(3):
        for j in range(8):
            now = jacobian[i, PARAMETERS + j]
            regressors[i, j] += regressors_share * (now - regressors[i, j])
    _put(regressors, jacobian)
    density = fast_slip_density(
        by_speeds, left_density, right_density, slip.white_time, sigma[2], gap_density
    )
    renew(x, P, _divided(density, dt))
    linearised_at = x.copy()

    if stands:
        for axis in range(3):
            row[:] = jacobian[axis]
            residual = 0.0 - twist[axis] - shift(row, x, linearised_at)
            multiply(P, row, cross)
            expected = inner(row, cross) + STANDSTILL_VARIANCE[axis]
            update(x, P, residual, cross, expected, kept, gain)
        fill_twist(x, kind, constants, memory, left, right, 1.0, twist, jacobian, by_speeds)
        _put(regressors, jacobian)
        linearised_at[:] = x

    scale = 1.0 + x[s.GYRO_SCALE]
    for k in range(SIZE):
        row[k] = scale * jacobian[2, k]
    row[s.GYRO_BIAS] += 1.0
    row[s.GYRO_SCALE] += twist[2]
    residual = rate - scale * twist[2] - x[s.GYRO_BIAS]
    variance = gyro_variance(imu, interval, by_speeds[2], change)
    of_gyro = _gated(
        x,
        P,
        residual,
        row,
        variance,
        threshold,
        gyro_rejected,
        patience,
        s.SLIP_W,
        kept,
        cross,
        gain,
    )

    of_accelerometer = (NOT_ASKED, 0.0, 0.0, 0.0)
    if with_force and not stands:
        eta = steering_efficiency(kind, constants, x[s.PARAMETERS])
        sigma = slip_at(smooth_left, smooth_right, slip, gauge, eta, pushed)
        rough = sideways_density(sigma[1], slip.time_constant)
        forecast = accelerometer_forecast(imu, interval, twist, by_speeds, change, rough)
        for k in range(SIZE):
            row[k] = forecast.by_w * jacobian[2, k] + forecast.by_v_x * jacobian[0, k]
        row[s.ACCELEROMETER_BIAS] += 1.0
        predicted = forecast.predicted + linearised_at[s.ACCELEROMETER_BIAS]
        of_accelerometer = _gated(
            x,
            P,
            force - predicted - shift(row, x, linearised_at),
            row,
            forecast.variance,
            threshold,
            accelerometer_rejected,
            patience,
            s.ACCELEROMETER_BIAS,
            kept,
            cross,
            gain,
        )
    move_inside(x, P, bounds, kept, considered)

    eta = steering_efficiency(kind, constants, x[s.PARAMETERS])
    sigma = slip_at(smooth_left, smooth_right, slip, gauge, eta, pushed)
    turning = share_of_walk(smooth_left, smooth_right)
    walk = np.empty(SIZE)
    for k in range(SIZE):
        walk[k] = walks[0, k] + walks[1, k] * turning
    share = fading(dt, slip.time_constant).mean
    fill_twist(
        x,
        kind,
        constants,
        memory,
        mean_left,
        mean_right,
        share,
        twist,
        jacobian,
        by_speeds,
    )
    _put(regressors, jacobian)
    pose_rows, with_pose = np.empty((3, SIZE)), np.empty((3, SIZE))
    time_constant = slip.time_constant
    move(x, P, dt, twist, jacobian, sigma, time_constant, walk, pose_rows, with_pose)
    return of_gyro, of_accelerometer


def _put(regressors: Floats, jacobian: Floats) -> None:
    """Write the smoothed derivatives by the parameters (3, 8) into those by the state (3, SIZE)."""
    for i in range(3):
        for j in range(8):
            jacobian[i, PARAMETERS + j] = regressors[i, j]


def _gated(
    x: Floats,
    P: Floats,
    residual: float,
    row: Floats,
    variance: float,
    threshold: float,
    rejected: int,
    patience: int,
    reopen: int,
    kept: int,
    cross: Floats,
    gain: Floats,
) -> Any:
    """See `estimator.filter.update.update`; returns the verdict, residual, its variance, and its NIS."""
    multiply(P, row, cross)
    foretold = expected = inner(row, cross) + variance
    nis = residual * residual / expected
    found = verdict(nis, threshold, rejected, patience)
    if found == REJECTED:
        return found, residual, foretold, nis
    if found == REACQUIRED:
        wider = inflation(residual * residual, expected)
        if (kept >> reopen) & 1:
            variance += wider * (row[reopen] * row[reopen])
        else:
            P[reopen, reopen] += wider
        multiply(P, row, cross)
        expected = inner(row, cross) + variance
    update(x, P, residual, cross, expected, kept, gain)
    return found, residual, foretold, nis


def _divided(density: Any, dt: float) -> Any:
    xx, xy, xw = density[0]
    _, yy, yw = density[1]
    ww = density[2][2]
    return (
        (xx / dt, xy / dt, xw / dt),
        (xy / dt, yy / dt, yw / dt),
        (xw / dt, yw / dt, ww / dt),
    )


imu_step_entry = entry(imu_step)
