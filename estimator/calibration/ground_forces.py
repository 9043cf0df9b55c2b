"""Forces that the ground balances along a log, for the fit of index models.

A filter estimates twist and gravity along the ground; the forces lag as in
`icreckon.estimator.motion.lagged_index_model`. So the gains are fitted to inertia and gravity together,
and a slope is not taken for inertia. A robot that turns meets a slope from all sides: gravity that is
constant in its own axes over all turns is an offset of the accelerometers.
"""

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.run import run

# Filter that estimates the twist: its parameters hardly matter, since the gyro measures the yaw rate.
VARIANT = "constant-online"
LEAST_TURNING = 1e-9  # least sum of squared yaw rates [rad²/s²]


class GroundForces(NamedTuple):
    """Forces of one log, over its vehicle's mass or weight."""

    times: Floats  # (k,) seconds since the log's start
    lateral: Floats  # (k,) S over the mass, the signed specific force [m/s²]
    along: Floats  # (k,) A, the force along the tracks as a share of the weight [-]
    slope: float  # slope of the ground, root mean square [rad]


def ground_forces(log: Log, robot: Robot, scale: float, latency: float) -> GroundForces:
    """Estimate the forces along a log; truth and fixes are not used.

    The robot has the calibrated mounting of its IMU. True track speeds are the logged ones times `scale`
    [-], earlier by `latency` [s].
    """
    stamps = log.tracks.stamps - round(latency / NANOSECOND)
    tracks = TrackSpeedSeries(stamps, scale * log.tracks.speeds)
    estimate = run(Log(log.name, tracks, log.imu), robot, VARIANT)
    times = np.asarray((estimate.stamps - log.start) * NANOSECOND, dtype=float)
    forward, _, w = estimate.trajectory.twists.T
    x_CM, lag = robot.constants.x_CM, robot.vehicle.load_lag
    newest = np.searchsorted(tracks.stamps, estimate.stamps, side="right") - 1
    speeds = tracks.speeds[np.maximum(newest, 0)]
    mean_speeds = speeds.mean(axis=1)
    acceleration = (mean_speeds - _lagged(times, mean_speeds, lag)) / lag
    weights, gravity = w * w, estimate.states[:, s.GRAVITY]
    # Less the accelerometers' offset: the mean in the robot's axes, weighted by the squared yaw rate.
    gravity = gravity - weights @ gravity / max(float(weights.sum()), LEAST_TURNING)
    along = (acceleration - gravity[:, 0]) / GRAVITY
    lateral = _lagged(times, -w * (forward + x_CM * w), lag) + gravity[:, 1]
    slope = float(np.sqrt((gravity**2).sum(axis=1).mean())) / GRAVITY
    return GroundForces(
        times, np.clip(lateral, -GRAVITY, GRAVITY), np.clip(along, -1.0, 1.0), slope
    )


def _lagged(times: Floats, values: Floats, time_constant: float) -> Floats:
    """Values (k,), each the mean since the time before, behind a first-order lag [s]."""
    decays = np.exp(-np.diff(times, prepend=times[0]) / time_constant)
    result, last = np.empty_like(values), values[0]
    for k, (decay, value) in enumerate(zip(decays.tolist(), values.tolist(), strict=True)):
        last = value + decay * (last - value)
        result[k] = last
    return result
