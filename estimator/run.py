"""Running a filter over a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimator import state as s
from estimator.errors import EstimatorError
from estimator.frames import Floats
from estimator.health import Health
from estimator.log import Log, Stamps
from estimator.measurements import TrackSpeeds
from estimator.pose_estimator import PoseEstimator
from estimator.robot import Robot
from estimator.settings import Settings
from estimator.trajectory import Trajectory

# How many measurements pass between two reports of progress.
PROGRESS_EVERY = 500


@dataclass(frozen=True)
class Run:
    """One variant's run over a log, sampled after each pair of track speeds.

    Attributes:
        variant: name of the filter variant.
        trajectory: poses and twists with covariances.
        indices: (n, 3) zeta [m], epsilon [m], eta [-] of the motion at that time.
        states: (n, SIZE) the filter's state, see `estimator.state`.
        state_sigmas: (n, SIZE) standard deviations of the state.
        health: what became of the measurements.
    """

    variant: str
    trajectory: Trajectory
    indices: Floats
    states: Floats
    state_sigmas: Floats
    health: Health

    @property
    def stamps(self) -> Stamps:
        """(n,) [ns]."""
        return self.trajectory.stamps


def run(
    log: Log,
    robot: Robot,
    variant: str,
    *,
    settings: Settings | None = None,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
    progress: Callable[[int], None] | None = None,
) -> Run:
    """Run one filter variant over a log, from its first measurement to its last.

    Args:
        log: the measurements; its truth is not looked at.
        robot: the robot.
        variant: name of a filter variant.
        settings: of the pose estimator.
        start: pose at the start: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].
        progress: called now and then with the stamp [ns] that was reached.

    Raises:
        EstimatorError: no such variant, or a log without track speeds.
    """
    if not len(log.tracks.stamps):
        raise EstimatorError(
            f"log {log.name!r} holds no track speeds: there is nothing to reckon with"
        )
    estimator = PoseEstimator(
        robot, variant, settings=settings, start=start, start_sigma=start_sigma
    )
    recorder = _Recorder(len(log.tracks.stamps))
    due, newest = False, log.start
    for count, measurement in enumerate(log.measurements()):
        if due and measurement.stamp > newest and estimator.stamp != recorder.newest:
            recorder.record(estimator)
            due = False
        newest = measurement.stamp
        used = estimator.feed(measurement)
        due |= used and isinstance(measurement, TrackSpeeds)
        if progress is not None and count % PROGRESS_EVERY == 0:
            progress(measurement.stamp)
    if due and estimator.stamp != recorder.newest:
        recorder.record(estimator)
    return recorder.finish(variant, estimator.health)


class _Recorder:
    """Rows of a run, filled one at a time."""

    def __init__(self, rows: int) -> None:
        self._count = 0
        self._stamps = np.zeros(rows, dtype=np.int64)
        self._indices = np.zeros((rows, 3))
        self._states = np.zeros((rows, s.SIZE))
        self._sigmas = np.zeros((rows, s.SIZE))
        self._pose_covariances = np.zeros((rows, 3, 3))
        self._twists = np.zeros((rows, 3))
        self._twist_covariances = np.zeros((rows, 3, 3))

    @property
    def newest(self) -> int | None:
        """Stamp of the newest row [ns]."""
        return int(self._stamps[self._count - 1]) if self._count else None

    def record(self, estimator: PoseEstimator) -> None:
        """Take down the estimate of now."""
        row, self._count = self._count, self._count + 1
        estimate = estimator.snapshot()
        self._stamps[row] = estimate.stamp
        self._states[row] = estimate.state
        self._sigmas[row] = np.sqrt(np.diagonal(estimate.covariance))
        self._pose_covariances[row] = estimate.covariance[s.POSE, s.POSE]
        self._twists[row] = estimate.twist
        self._twist_covariances[row] = estimate.twist_covariance
        self._indices[row] = estimate.indices

    def finish(self, variant: str, health: Health) -> Run:
        """The run, as far as it was filled."""
        kept = slice(0, self._count)
        trajectory = Trajectory(
            self._stamps[kept],
            self._states[kept, s.POSE],
            self._pose_covariances[kept],
            self._twists[kept],
            self._twist_covariances[kept],
        )
        return Run(
            variant,
            trajectory,
            self._indices[kept],
            self._states[kept],
            self._sigmas[kept],
            health,
        )
