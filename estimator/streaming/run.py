"""Run a filter over a log."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError, IcreckonError
from icreckon.estimator.base.records import NEVER
from icreckon.estimator.filter import samples as sample_arrays
from icreckon.estimator.filter.fault_table import FAULT_COLUMNS
from icreckon.estimator.filter.health import Health, Judged
from icreckon.estimator.filter.samples import COUNT, DUE, NEWEST, RunRows, SampleArrays
from icreckon.estimator.log.input_checks import LATEST
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import Measurement, TrackSpeeds
from icreckon.estimator.log.series import TrackSpeedSeries, require_part
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.motion.pose3d import spatial_of
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import state_names
from icreckon.estimator.sensors.measurement_models import IMU_SENSORS, innovation_components
from icreckon.estimator.streaming.lost import loss_of, stopped_by
from icreckon.estimator.streaming.outputs import Run, Singles, Snapshot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

PROGRESS_EVERY = 500  # number of measurements between two reports of progress
ONE_BY_ONE_NS = 100_000_000  # time of samples that are fed one by one where arrays stop [ns]


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


def work_through(
    log: Log,
    estimator: PoseEstimator,
    progress: Callable[[int], None] | None = None,
    *,
    at_row: Callable[[], None] | None = None,
) -> Run:
    """Feed a log to a new estimator, and record its estimates.

    `progress` is called from time to time with the stamp that was reached [ns], `at_row` after each row;
    measurements are then fed one by one.

    Raises:
        EstimatorError: a log without track speeds.
        LostFilter: the estimate is not finite, has negative variances, or is absurd.
    """
    if not len(log.tracks.stamps):
        raise EstimatorError(
            f"log {log.name!r} holds no track speeds: there is nothing to reckon with"
        )
    feeding = _Feeding(log, estimator, progress, at_row)
    samples = sample_arrays.samples_of(log)
    fastest = estimator.robot.vehicle.max_track_speed
    is_observed = at_row is not None or estimator.has_own_faults
    # NaN is found afterwards, see `icreckon.estimator.streaming.lost`.
    with np.errstate(all="ignore"):
        is_plain = sample_arrays.are_in_order(samples) and len(samples.imu_stamps) > 0
        is_plain = is_plain and not sample_arrays.has_absurd_readings(log, fastest)
        if is_plain and not is_observed:
            feeding.feed_arrays(samples)
        else:
            feeding.feed_each(log.measurements())
        finished = feeding.finished()
    lost = loss_of(finished, log.start)
    if lost is not None:
        raise lost
    return finished


@dataclass
class _Feeding:
    """Run in progress, with the arguments of `work_through`, and its rows so far."""

    log: Log
    estimator: PoseEstimator
    progress: Callable[[int], None] | None
    at_row: Callable[[], None] | None
    fed_count: int = 0

    def __post_init__(self) -> None:
        self.rows = Rows(len(self.log.tracks.stamps))

    def finished(self) -> Run:
        """Run of all measurements, with a row for the newest track speeds."""
        self._write_row_if_due(LATEST)
        return self._run_of_filled_rows()

    def _run_of_filled_rows(self) -> Run:
        """Run of the rows that are filled."""
        estimator, rows = self.estimator, self.rows
        names, count = state_names(estimator.variant), int(rows.arrays.progress[COUNT])
        return rows.finish(count, estimator.variant.name, names, estimator.health)

    def _write_row_if_due(self, stamp: int) -> None:
        """Write a row if one is due before a measurement at a stamp [ns]."""
        rows, estimator = self.rows, self.estimator
        row = int(rows.arrays.progress[COUNT])
        if estimator.write_row(rows.arrays, stamp):
            rows.innovations.put(row, estimator.newest_judged())
            if self.at_row is not None:
                self.at_row()

    def feed_each(self, measurements: Iterable[Measurement]) -> None:
        """Feed measurements one by one; an exception of the code raises `LostFilter`."""
        progress = self.rows.arrays.progress
        for measurement in measurements:
            stamp = measurement.stamp
            try:
                self._write_row_if_due(stamp)
                used = self.estimator.feed(measurement)
            except IcreckonError:
                raise
            except Exception as problem:
                so_far = self._run_of_filled_rows()
                raise stopped_by(problem, so_far, self.log.start, stamp) from problem
            if used and isinstance(measurement, TrackSpeeds):
                progress[DUE] = 1
            self.fed_count += 1
            if self.progress is not None and self.fed_count % PROGRESS_EVERY == 0:
                self.progress(stamp)

    def feed_arrays(self, samples: SampleArrays) -> None:
        """Feed track and IMU samples as arrays, between the log's other measurements."""
        log = self.log
        samples_alone = replace(log, fixes=None, others=(), truth=None)
        no_tracks = TrackSpeedSeries(sample_arrays.NO_STAMPS, np.zeros((0, 2)))
        others = replace(log, tracks=no_tracks, imu=None, truth=None)
        # None stands for the end of the log.
        for other in chain(others.measurements(), [None]):
            end = log.end if other is None else other.stamp
            waiting, samples = samples.split(end)
            while waiting.first is not None:
                waiting = self._feed_part(waiting)
                if waiting.first is not None:
                    # The next sample needs more than a step, or the filter has not begun.
                    until = min(waiting.first + ONE_BY_ONE_NS, end)
                    self.feed_each(samples_alone.between(waiting.first, until).measurements())
                    _, waiting = waiting.split(until)
            if other is not None:
                self.feed_each([other])

    def _feed_part(self, samples: SampleArrays) -> SampleArrays:
        """Feed samples up to one that needs more than a step; return those that are left."""
        rows, estimator = self.rows, self.estimator
        progress, judged = rows.arrays.progress, estimator.newest_judged()
        first_row = int(progress[COUNT])
        tracks, imu, _ = estimator.feed_samples(samples, rows.arrays)
        if progress[COUNT] > first_row:
            # Innovations of fixes before these samples belong to the first row since.
            rows.innovations.put(first_row, judged)
        if self.progress is not None and tracks + imu:
            self.progress(int(progress[NEWEST]))
        return samples.after(tracks, imu)


class InnovationRows:
    """Normalised innovations of at most `most` rows of a run, filled row by row.

    A row has the newest one of each sensor since the row before, even if it was rejected, or NaN.
    """

    def __init__(self, most: int) -> None:
        self._components = innovation_components()
        self._columns: dict[str, Singles] = {}
        self._most = most
        # Stamp of the newest innovation in a row, by sensor [ns].
        self._written: dict[str, int] = {}

    def put(self, row: int, judged: Iterable[tuple[str, Judged]]) -> None:
        """Fill a row with the newest innovations of fixes that no row has yet."""
        for sensor, (stamp, _, residual, covariance) in judged:
            if sensor in IMU_SENSORS or self._written.get(sensor) == stamp:
                continue
            self._written[sensor] = stamp
            for axis, name in enumerate(self._components[sensor]):
                variance = covariance[axis][axis]
                if variance > 0.0:
                    if name not in self._columns:
                        self._columns[name] = np.full(self._most, np.nan, np.float32)
                    self._columns[name][row] = residual[axis] / math.sqrt(variance)

    def finish(self, count: int, of_imu: Floats) -> tuple[tuple[str, ...], Singles]:
        """Names (k,) of components with innovations, and the first rows (count, k) [-]."""
        # `of_imu` (most, 3) has the innovations of the sensors of the IMU, NaN without any.
        for name, column in zip(IMU_SENSORS, of_imu.T, strict=True):
            if not np.isnan(column).all():
                self._columns[name] = column.astype(np.float32)
        components = chain.from_iterable(self._components.values())
        names = tuple(name for name in components if name in self._columns)
        rows = np.empty((count, len(names)), np.float32)
        for column, name in enumerate(names):
            rows[:, column] = self._columns[name][:count]
        return names, rows


class Rows:
    """Rows of a run, up to `most`; innovations of fixes are not part of `arrays`."""

    def __init__(self, most: int) -> None:
        self.arrays = RunRows(
            stamps=np.zeros(most, dtype=np.int64),
            states=np.zeros((most, s.SIZE)),
            sigmas=np.zeros((most, s.SIZE)),
            pose_covariances=np.zeros((most, 3, 3)),
            twists=np.zeros((most, 3)),
            twist_covariances=np.zeros((most, 3, 3)),
            indices=np.zeros((most, 3)),
            innovations=np.full((most, 3), np.nan),
            faults=np.zeros((most, len(FAULT_COLUMNS)), bool),
            judged=np.full(3, NEVER),
            progress=np.array([0, NEVER, 0, NEVER]),
        )
        self.innovations = InnovationRows(most)

    def put(self, row: int, estimate: Snapshot) -> None:
        """Fill a row with an estimate."""
        rows = self.arrays
        rows.stamps[row] = estimate.stamp
        rows.states[row] = estimate.state
        rows.sigmas[row] = np.sqrt(np.diagonal(estimate.covariance))
        rows.pose_covariances[row] = estimate.covariance[s.POSE, s.POSE]
        rows.twists[row] = estimate.twist
        rows.twist_covariances[row] = estimate.twist_covariance
        rows.indices[row] = estimate.indices

    def finish(self, count: int, variant: str, state_names: tuple[str, ...], health: Health) -> Run:
        """Run of the first `count` rows."""
        rows, filled = self.arrays, slice(0, count)
        states, sigmas = rows.states[filled], rows.sigmas[filled]
        trajectory = Trajectory(
            rows.stamps[filled],
            states[:, s.POSE],
            rows.pose_covariances[filled],
            rows.twists[filled],
            rows.twist_covariances[filled],
            *spatial_of(states, sigmas),
        )
        names, innovations = self.innovations.finish(count, rows.innovations)
        of_filter = rows.indices[filled], state_names, states, sigmas, health
        return Run(variant, trajectory, *of_filter, names, innovations, rows.faults[filled])
