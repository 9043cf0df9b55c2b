"""Running one filter variant over many logs, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.errors import BatchError, EstimatorError
from icreckon.estimator.batch.inputs import has_absurd_readings, has_heading, measured_of
from icreckon.estimator.batch.runs import work_through_runs
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.schedule import steps_of
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.robot.robot_file import Robot, require_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant


def run_many(
    logs: Sequence[Log],
    robot: Robot,
    variant: str,
    *,
    settings: Settings | None = None,
    every: float = 0.1,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> list[Trajectory]:
    """Run a filter variant over logs that were recorded at the same times, hundreds of times as fast.

    What comes out is what `run` and a `PoseEstimator` say, to rounding. The logs are those of a Monte
    Carlo study, say: each with its own measurements, at stamps that all of them share; only track speeds
    may be missing here and there.

    Args:
        logs: the measurements; their truth is not looked at.
        robot: the robot.
        variant: name of a filter variant.
        settings: of the filters.
        every: time between the estimates that are kept, at the next IMU sample [s].
        start: pose at the start: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].

    Returns:
        The trajectory of each log.

    Raises:
        EstimatorError: there are no logs, `every` is no time, or no such variant.
        BatchError: the variant or the logs cannot be worked through side by side; the message says why.
    """
    require_robot(robot)
    if not logs:
        raise EstimatorError("there are no logs to run over")
    if not every > 0.0:
        raise EstimatorError(f"every must be a time of more than 0 s, found {every!r}")
    filters = BatchFilter(robot, find_variant(variant), settings or Settings())
    for log in logs:
        if has_absurd_readings(log, robot.vehicle.max_track_speed):
            raise BatchError(
                f"the log {log.name!r} holds readings that no such sensor gives, which filters side by "
                "side do not look for; use run"
            )
    everything = measured_of(logs, robot)
    ticks = _kept_stamps(everything.imu_stamps, every)
    heading = has_heading(everything.fixes)
    stamps = everything.track_stamps, everything.imu_stamps, everything.fix_stamps
    steps = steps_of(*stamps, ticks, heading=heading)
    found: list[Trajectory] = []
    for first in range(0, len(logs), filters.width):
        # A group that is not full runs its last log more than once.
        group = [min(first + lane, len(logs) - 1) for lane in range(filters.width)]
        measured = everything._replace(
            tracks=everything.tracks[group],
            rates=everything.rates[group],
            forces=everything.forces[group],
            fixes=everything.fixes[group],
        )
        (worked,) = work_through_runs(
            [filters],
            [measured],
            steps,
            start=np.array(start, dtype=float),
            start_sigma=np.array(start_sigma, dtype=float),
            keep=True,
        )
        estimates = np.asarray(worked.estimates)[: len(ticks)]
        count = min(filters.width, len(logs) - first)
        found += [_trajectory(ticks, estimates[:, :, lane]) for lane in range(count)]
    return found


def _kept_stamps(imu: Stamps, every: float) -> Stamps:
    """The IMU samples that come next to whole multiples of a time since the first [s]."""
    wanted = np.arange(imu[0], imu[-1] + 1, max(1, int(every / NANOSECOND)))
    return np.asarray(imu[np.unique(np.searchsorted(imu, wanted))])


def _trajectory(stamps: Stamps, estimates: Floats) -> Trajectory:
    """Of estimates (n, 18), see `estimator.engine.work.ESTIMATE`."""
    return Trajectory(
        stamps,
        estimates[:, :3],
        _symmetric(estimates[:, 3:9]),
        estimates[:, 9:12],
        _symmetric(estimates[:, 12:18]),
    )


def _symmetric(upper: Floats) -> Floats:
    """(n, 3, 3) of the entries (n, 6) on the diagonal and above it, row by row."""
    return np.asarray(upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))
