"""Run a filter over a log."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError, IcreckonError
from icreckon.estimator.filter.health import Health, Judged
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import TrackSpeeds
from icreckon.estimator.log.series import require_part
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.motion.pose3d import spatial_of
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import state_names
from icreckon.estimator.streaming.innovation_rows import InnovationRows
from icreckon.estimator.streaming.lost import loss_of, stopped_by
from icreckon.estimator.streaming.outputs import Run, Snapshot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

# Number of measurements between two reports of progress.
PROGRESS_EVERY = 500


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
        log: the measurements; its truth is not used.
        robot: the robot.
        variant: name of a filter variant.
        settings: settings of the pose estimator.
        start: pose at the start: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].
        progress: called from time to time with the stamp that was reached [ns].

    Raises:
        EstimatorError: no such variant, or a log without track speeds.
        LostFilter: the estimate is not finite, has negative variances, or is absurd.
    """
    require_part("log", log, Log)
    estimator = PoseEstimator(
        robot, variant, settings=settings, start=start, start_sigma=start_sigma
    )
    return work_through(log, estimator, progress)


# NaN is found afterwards, see `icreckon.estimator.streaming.lost`.
@np.errstate(all="ignore")
def work_through(
    log: Log,
    estimator: PoseEstimator,
    progress: Callable[[int], None] | None = None,
    *,
    at_row: Callable[[], None] | None = None,
) -> Run:
    """Feed a log to a new estimator, and record its estimates.

    Args:
        log: the measurements; its truth is not used.
        estimator: new estimator.
        progress: called from time to time with the stamp that was reached [ns].
        at_row: called after each row.

    Raises:
        EstimatorError: a log without track speeds.
        LostFilter: the estimate is not finite, has negative variances, or is absurd.
    """
    if not len(log.tracks.stamps):
        raise EstimatorError(
            f"log {log.name!r} holds no track speeds: there is nothing to reckon with"
        )
    rows = Rows(len(log.tracks.stamps))
    count, written = 0, None

    def write_row() -> None:
        nonlocal count, written
        rows.put(count, estimator.snapshot(), estimator.newest_judged())
        count, written = count + 1, estimator.stamp
        if at_row is not None:
            at_row()

    def finished() -> Run:
        names = state_names(estimator.variant)
        return rows.finish(count, estimator.variant.name, names, estimator.health)

    due, newest = False, log.start
    for number, measurement in enumerate(log.measurements()):
        try:
            if due and measurement.stamp > newest and estimator.stamp != written:
                write_row()
                due = False
            newest = measurement.stamp
            used = estimator.feed(measurement)
        except IcreckonError:
            raise
        except Exception as problem:
            raise stopped_by(problem, finished(), log.start, measurement.stamp) from problem
        due |= used and isinstance(measurement, TrackSpeeds)
        if progress is not None and number % PROGRESS_EVERY == 0:
            progress(measurement.stamp)
    if due and estimator.stamp != written:
        write_row()
    done = finished()
    lost = loss_of(done, log.start)
    if lost is not None:
        raise lost
    return done


class Rows:
    """Rows of a run, filled by the filters.

    Args:
        most: highest number of rows.

    Attributes:
        stamps: (n,) stamps of the estimates [ns].
        indices: (n, 3) zeta [m], epsilon [m], eta [-].
        states: (n, SIZE) states.
        sigmas: (n, SIZE) their standard deviations.
        pose_covariances: (n, 3, 3) covariances of the pose.
        twists: (n, 3) v_x, v_y [m/s], w [rad/s].
        twist_covariances: (n, 3, 3) their covariances.
        innovations: normalised innovations.
    """

    def __init__(self, most: int) -> None:
        self.stamps = np.zeros(most, dtype=np.int64)
        self.indices = np.zeros((most, 3))
        self.states = np.zeros((most, s.SIZE))
        self.sigmas = np.zeros((most, s.SIZE))
        self.pose_covariances = np.zeros((most, 3, 3))
        self.twists = np.zeros((most, 3))
        self.twist_covariances = np.zeros((most, 3, 3))
        self.innovations = InnovationRows(most)

    def put(self, row: int, estimate: Snapshot, judged: Iterable[tuple[str, Judged]] = ()) -> None:
        """Fill a row with an estimate and the newest innovation of each sensor."""
        self.innovations.put(row, judged)
        self.stamps[row] = estimate.stamp
        self.states[row] = estimate.state
        self.sigmas[row] = np.sqrt(np.diagonal(estimate.covariance))
        self.pose_covariances[row] = estimate.covariance[s.POSE, s.POSE]
        self.twists[row] = estimate.twist
        self.twist_covariances[row] = estimate.twist_covariance
        self.indices[row] = estimate.indices

    def finish(self, count: int, variant: str, state_names: tuple[str, ...], health: Health) -> Run:
        """Run of the first `count` rows."""
        filled = slice(0, count)
        states, sigmas = self.states[filled], self.sigmas[filled]
        trajectory = Trajectory(
            self.stamps[filled],
            states[:, s.POSE],
            self.pose_covariances[filled],
            self.twists[filled],
            self.twist_covariances[filled],
            *spatial_of(states, sigmas),
        )
        return Run(
            variant,
            trajectory,
            self.indices[filled],
            state_names,
            states,
            sigmas,
            health,
            *self.innovations.finish(count),
        )
