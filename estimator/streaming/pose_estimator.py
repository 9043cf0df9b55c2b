"""Streaming pose estimator: measurements in one at a time; pose, twist, ICRs out."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.checks import require_kind, three_numbers
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.clones import MOST_MARKS, RelativeMotion
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.health import TOO_OLD, Health, Judged, ParameterHealth, add_arrivals
from icreckon.estimator.filter.process_noise import twist_covariance
from icreckon.estimator.filter.samples import RunRows, SampleArrays
from icreckon.estimator.log.input_checks import (
    RANKS,
    STREAMS,
    as_stamp,
    event_of,
    event_row,
    key_of,
    measurement_of,
    stamp_of_mark,
)
from icreckon.estimator.log.measurements import Mark, Measurement
from icreckon.estimator.motion.icr import IndexValues
from icreckon.estimator.motion.pose3d import Pose3d, Twist3d, pose3d_of
from icreckon.estimator.robot.robot_file import Robot, require_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import (
    find_variant,
    parameter_names,
    state_names,
    used_parameters,
)
from icreckon.estimator.streaming.late_measurements import History
from icreckon.estimator.streaming.latencies import Latencies, StampCorrection
from icreckon.estimator.streaming.outputs import IcrPoints, PredictedPose, Snapshot, icr_points
from icreckon.estimator.streaming.reckoning import Reckoning
from icreckon.estimator.streaming.save import (
    SavedEstimator,
    read_saved,
    require_sound,
    robot_constants,
    write_saved,
)
from icreckon.estimator.streaming.warm_up import warm_up


class PoseEstimator:
    """Dead reckoning of a skid-steer robot from track speeds, IMU and some fixes.

    Feed measurements as they come; read the estimate at any time. Poses are those of `base_link` in
    `odom`, twists are in `base_link` (REP-103). Use it from one thread at a time: share it between
    threads only with a lock about feeding and reading alike.

    The pose is continuous, as REP-105 requires of `odom`: tracks, IMU and body velocity correct the
    twist, which moves the pose, and only fixes make it jump. The stamp of the estimate is that of the
    newest IMU sample: track speeds are used at the next one, which measures their slip. Without an IMU
    they are used at once.

    Measurements may come in any order, as late as `Settings.history`. Each is processed at its own stamp
    (at equal stamps tracks, IMU, position, heading, body velocity, pose, zero velocity), and the filter
    is re-run over all later ones. The estimate is the same as if all had come in time. It changes as soon
    as a late measurement is fed.

    The constructor compiles all functions that `feed` calls: up to 20 s with an empty cache, less
    than a second in later processes (`icreckon prepare` compiles ahead, for an image). `feed` never waits
    for the compiler.

    Args:
        robot: the robot, see `load_robot`.
        variant: name of a filter variant, see `icreckon.estimator.robot.variants.VARIANTS`.
        settings: settings that are no property of the robot.
        start: pose at the first track speeds: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].
        latencies: latencies of the stamps that are fed; None if stamps are times of measurement, as in a
            `Log`; `Latencies.of(robot)` for raw stamps of a robot's drivers.

    Raises:
        EstimatorError: there is no such variant, an argument is invalid, or `Settings.considered` has a
            name that the variant has not.
    """

    def __init__(
        self,
        robot: Robot,
        variant: str = "inertia-online",
        *,
        settings: Settings | None = None,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
        latencies: Latencies | None = None,
    ) -> None:
        require_robot(robot)
        require_kind("settings", settings, Settings, or_none=True)
        require_kind("latencies", latencies, Latencies, or_none=True)
        start = three_numbers("start", start, "three finite numbers: x, y [m], yaw [rad]")
        start_sigma = three_numbers(
            "start_sigma",
            start_sigma,
            "three finite numbers, 0 or more: the standard deviations of x, y [m], yaw [rad]",
            least=0.0,
        )
        self.robot = robot
        self.variant = find_variant(variant)
        self.settings = settings if settings is not None else Settings()
        self._reckoning = Reckoning(robot, self.variant, self.settings, start, start_sigma)
        warm_up(self._reckoning.ekf.model, robot, self.variant, self.settings)
        self._history = History(self._reckoning, self.settings.history, self._watch)
        self._admission = self._reckoning.admission
        # Counts of measurements that do not reach the filter; no checkpoint of the filter resets them.
        self._arrivals = Health()
        self._stamps = StampCorrection(latencies or Latencies())
        self._streams = dict(STREAMS)
        self._is_fed = False  # a call of `feed` is in progress

    def __repr__(self) -> str:
        """One line: variant, robot, stamp and pose."""
        x, y, yaw = self.pose
        now = "no estimate yet" if self.stamp is None else f"stamp {self.stamp}"
        where = f"x {x:.3f} m, y {y:.3f} m, yaw {yaw:.3f} rad"
        return f"<PoseEstimator {self.variant.name!r} of {self.robot.name!r}, {now}: {where}>"

    @property
    def stamp(self) -> int | None:
        """Time of the estimate [ns]; None before the first track speeds or fix."""
        return self._reckoning.stamp

    @property
    def pose(self) -> Floats:
        """(3,) x, y [m], yaw [rad] of base_link in odom; yaw counts full turns."""
        return self._reckoning.ekf.x[s.POSE].copy()

    @property
    def pose_covariance(self) -> Floats:
        """(3, 3) covariance of `pose` in the axes of odom."""
        return self._reckoning.ekf.P[s.POSE, s.POSE].copy()

    @property
    def twist(self) -> Floats:
        """(3,) v_x forward, v_y left [m/s], w counter-clockwise [rad/s] of base_link."""
        return self._reckoning.model().twist.copy()

    @property
    def twist_covariance(self) -> Floats:
        """(3, 3) covariance of `twist`."""
        jacobian, fastest = self._reckoning.model().jacobian, self.robot.vehicle.max_track_speed
        return twist_covariance(jacobian, self._reckoning.ekf.P, fastest)

    @property
    def pose3d(self) -> Pose3d:
        """Pose with height, roll and pitch; the height begins at zero."""
        return pose3d_of(self.state, self.covariance)

    @property
    def twist3d(self) -> Twist3d:
        """Twist with the rates of roll and pitch; see `snapshot`."""
        return self.snapshot().twist3d

    @property
    def indices(self) -> IndexValues:
        """Sliding, eccentricity and steering efficiency of the present motion."""
        return self._reckoning.model().motion.indices

    @property
    def icrs(self) -> IcrPoints:
        """ICRs of the tracks in base_link by (28) to (30), of the present motion."""
        return icr_points(self.indices, self.robot.vehicle.track_gauge)

    @property
    def parameters(self) -> dict[str, float]:
        """Estimated parameters by name, in SI units; see `Indices` for the indices."""
        named = self._named(s.PARAMETERS)
        return {name: named[name] for name in used_parameters(self.variant)}

    @property
    def biases(self) -> dict[str, float]:
        """Biases and scales by their names in `STATE_NAMES`."""
        return self._named(s.BIASES)

    @property
    def state(self) -> Floats:
        """(SIZE,) copy of the filter's state, in the order of `STATE_NAMES`."""
        return self._reckoning.ekf.x[: s.SIZE].copy()

    @property
    def covariance(self) -> Floats:
        """(SIZE, SIZE) copy of the filter's covariance."""
        return self._reckoning.ekf.P[: s.SIZE, : s.SIZE].copy()

    @property
    def stands(self) -> bool:
        """True if the robot was found standing at the newest IMU sample."""
        return self._reckoning.stands

    @property
    def has_own_faults(self) -> bool:
        """True if it watches for faults that `add_fault` has added."""
        return bool(self._reckoning.own_faults.watched)

    @property
    def health(self) -> Health:
        """Counts of the measurements so far: a copy, which later ones do not change."""
        health = self._reckoning.health
        add_arrivals(health, self._arrivals)
        health.track_latency = self._stamps.health()
        return health

    def write_row(self, rows: RunRows, stamp: int) -> bool:
        """Fill the next row of a run if it is due before a measurement at a stamp [ns]."""
        return self._reckoning.write_row(rows, stamp)

    def newest_judged(self) -> list[tuple[str, Judged]]:
        """Newest innovation of each sensor with a gate, without a copy of `health`."""
        return self._reckoning.newest_judged()

    @property
    def parameter_health(self) -> dict[str, ParameterHealth]:
        """Uncertainty of each parameter, and its excitation by the present motion."""
        rows = self._reckoning.parameter_health().tolist()
        named = dict(zip(parameter_names(self.variant), rows, strict=True))
        return {name: ParameterHealth(*named[name]) for name in used_parameters(self.variant)}

    def snapshot(self) -> Snapshot:
        """State, twist and indices, with one evaluation of the motion model.

        Raises:
            EstimatorError: there was no measurement yet.
        """
        if self.stamp is None:
            raise EstimatorError("there is no estimate before the first measurement")
        return self._reckoning.snapshot()

    def pose_at(self, stamp: int) -> PredictedPose:
        """Predict the pose between two samples or a little ahead of the estimate.

        The twist is assumed constant, and the estimate does not change. For a past pose set a `mark`.

        Args:
            stamp: time [ns], up to `Settings.hold` after `stamp` of the estimate.

        Raises:
            EstimatorError: there was no measurement yet, or the stamp is no integer, before that of the
                estimate, or further ahead.
        """
        stamp, now = as_stamp("pose_at", stamp), self.stamp
        if now is None:
            raise EstimatorError("there is no estimate before the first measurement")
        ahead = (stamp - now) * NANOSECOND
        if not 0.0 <= ahead <= self.settings.hold:
            raise EstimatorError(
                f"no pose at {stamp}: it is {ahead:+.3g} s from the estimate, and "
                f"must be 0 to {self.settings.hold:g} s (Settings.hold) after it; for the past set a mark"
            )
        pose, H, R = self._reckoning.pose_ahead(stamp)
        # H may lack the wander of the fixes, which does not move the pose.
        size = H.shape[1]
        P = self._reckoning.ekf.P[:size, :size]
        return PredictedPose(stamp, pose, H @ P @ H.T + R)

    def _named(self, part: slice) -> dict[str, float]:
        """Values of a part of the state by name, in SI units."""
        names = state_names(self.variant)[part]
        return dict(zip(names, self._reckoning.ekf.x[part].tolist(), strict=True))

    def feed(self, measurement: Measurement) -> bool:
        """Update with one measurement.

        The latency of its stream is subtracted from its stamp. A measurement is rejected, and counted in
        `health`, if it is invalid (not finite or too large, bad variance, duplicate stamp), later than
        `Settings.history`, or outside of its gate. The estimate then changes at most by propagation to
        its stamp.

        Returns:
            True if the measurement was used; otherwise `health.rejections()` counts the reason.

        Raises:
            EstimatorError: not a measurement, not a number, its type was registered afterwards, two
                threads at once, or dozens of stamps within microseconds: they are not nanoseconds.
        """
        if self._is_fed:
            raise EstimatorError("two threads feed this estimator at once: hold a lock")
        self._is_fed = True
        try:
            plain, reason = self._admission.checked(measurement)
            return self._feed_plain(self._stamps.corrected(plain), reason)
        finally:
            self._is_fed = False

    @property
    def latencies(self) -> Latencies:
        """Latencies that are taken off the stamps."""
        return self._stamps.latencies

    def late(self, kind: type[Measurement]) -> int:
        """Latency that `feed` takes off the stamps of a type of measurements [ns]."""
        return self._stamps.late(kind)

    def feed_corrected(self, measurement: Measurement) -> bool:
        """Update with one measurement whose stamp is its time of measurement; see `feed`."""
        return self._feed_plain(*self._admission.checked(measurement))

    def _feed_plain(self, measurement: Measurement, objection: str | None) -> bool:
        """Update with a measurement in plain types; return True if it was used.

        `objection` is the reason why its values are invalid, None if they are not. A stamp that is far
        ahead or too old counts towards a step of the clock.
        """
        kind, admission, history = type(measurement), self._admission, self._history
        stream = self._streams.get(kind)
        if stream is None:
            raise EstimatorError(
                f"{kind.__name__} was registered after this estimator: make a new one"
            )
        key = measurement.stamp, RANKS[kind]
        in_order = history.is_newest(key)
        reason = objection or (None if in_order else history.objection(key))
        is_far = measurement.stamp - self._reckoning.record.stamp > admission.longest_gap
        if reason is None and (is_far or admission.witnesses):
            now = self._reckoning.stamp
            reason = admission.objection_to_stamp(stream, measurement.stamp, now)
        if reason:
            self._arrivals.sensor(stream).reject(reason)
            return reason == TOO_OLD and self._set_clock_back(admission.too_old(measurement))
        admission.behind.clear()
        if in_order:
            return history.append(key, measurement)
        self._arrivals.sensor(stream).late += 1
        return history.insert(key, measurement)

    def feed_samples(self, samples: SampleArrays, rows: RunRows) -> tuple[int, int, int]:
        """Update with plausible samples, newer than all measurements so far.

        Updates end before the first sample that needs more than a step. Returns the numbers of track
        speeds, of IMU samples, and of used measurements among them; the history begins after them.
        """
        tracks, imu, used = self._reckoning.take_samples(samples, rows)
        if tracks or imu:
            self._history.begin_anew(samples.newest(tracks, imu), self._reckoning.checkpoint())
        return tracks, imu, used

    def _watch(self, record: FilterRecord) -> None:
        """Watch the latency of the track speeds; `_stamps` is replaced by restoring."""
        self._stamps.watch(record)

    def set_clock(self, by: int) -> None:
        """Go on by a clock that is ahead of the one so far [ns]; no time passes."""
        by = as_stamp("clock", by)
        if self._history.has_begun:
            self._history.set_clock(by)
            self._arrivals.clock_steps += 1

    def _set_clock_back(self, behind: list[Measurement]) -> bool:
        """Set the clock so that rejected measurements follow; True if one was used then."""
        if not behind or not self._history.has_begun:
            return False
        interval_ns = round(self._reckoning.record.imu.interval / NANOSECOND)
        self.set_clock(behind[0].stamp - interval_ns - self._history.newest)
        is_one_used = False
        for measurement in behind:
            self._arrivals.sensor(STREAMS[type(measurement)]).take_back(TOO_OLD)
            is_one_used |= self.feed_corrected(measurement)
        return is_one_used

    @property
    def marks(self) -> tuple[int, ...]:
        """Stamps of the marks [ns]."""
        return self._reckoning.clones.stamps

    def mark(self, stamp: int | None = None) -> int:
        """Set a mark at the robot's pose, for `relative_motion`.

        A mark is set at its own stamp, as late as a measurement may be; older measurements that come
        later still count. Between two steps of the filter the twist is assumed constant. The estimate
        does not change.

        Args:
            stamp: time [ns], or None for that of the estimate.

        Returns:
            The stamp, which identifies the mark. There is one mark at a stamp: a second changes nothing.

        Raises:
            EstimatorError: there was no measurement yet, the stamp is no integer, older than the
                history or further ahead of the estimate than `Settings.hold`, or there are 20
                marks (`MOST_MARKS`) already.
        """
        now = self.stamp
        if now is None:
            raise EstimatorError("nothing can be marked before the first measurement")
        mark = Mark(now if stamp is None else stamp_of_mark(stamp))
        if mark.stamp in self.marks:
            return mark.stamp
        key = key_of(mark)
        ahead = (mark.stamp - now) * NANOSECOND
        reason = self._history.objection(key)
        if self._history.starts_after(key):
            reason = "before the first measurement"
        elif len(self.marks) >= MOST_MARKS:
            reason = f"{MOST_MARKS} are kept already; forget those that are no longer used"
        elif ahead > self.settings.hold:
            reason = f"{ahead:.3f} s ahead of the estimate; feed what was measured until then"
        if reason is not None:
            raise EstimatorError(f"no mark can be set at {mark.stamp}: {reason}")
        add = self._history.append if self._history.is_newest(key) else self._history.insert
        add(key, mark)
        return mark.stamp

    def relative_motion(self, from_stamp: int, to_stamp: int | None = None) -> RelativeMotion:
        """Motion of the robot from one mark to another, or to now.

        Its covariance does not contain the error that both poses have in common, such as earlier drift.
        Fixes since the first mark correct the motion: factors of a graph whose poses are fed back would
        count them twice, so take those from a second estimator without fixes.

        Args:
            from_stamp: stamp of a mark [ns].
            to_stamp: stamp of another mark [ns], or None for the time of the estimate.

        Raises:
            EstimatorError: there is no such mark.
        """
        start = stamp_of_mark(from_stamp)
        end = None if to_stamp is None else stamp_of_mark(to_stamp)
        return self._reckoning.clones.between(start, end, self.stamp or 0)

    def forget(self, stamp: int) -> None:
        """Drop the mark of a stamp [ns]; each costs time in every step.

        Raises:
            EstimatorError: there is no such mark.
        """
        mark = Mark(stamp_of_mark(stamp))
        self._reckoning.clones.place(mark.stamp)  # raises if there is none
        self._history.forget_mark(mark)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Save to a file, or replace it (`overwrite`); `restore` continues from there.

        Raises:
            EstimatorError: the file exists already, or cannot be written.
        """
        write_saved(Path(path), self._saved(), overwrite=overwrite)

    @classmethod
    def restore(cls, path: str | Path, robot: Robot, variant: str | None = None) -> PoseEstimator:
        """Restore a saved estimator.

        It continues as the saved one would have, to the last bit. Settings are those of the saved
        estimator.

        Args:
            path: file that `save` has written.
            robot: robot that it was saved for.
            variant: required variant, None for any.

        Raises:
            EstimatorError: the file is missing, damaged or of an unknown version, or it was saved for
                another robot or by another variant, or it holds values that no estimator has: variances
                below zero, states out of bounds.
        """
        require_robot(robot)
        saved = read_saved(Path(path))
        saved.require_fit(robot, variant, str(path), to_continue=True)
        estimator = cls(robot, saved.variant, settings=saved.settings)
        try:
            estimator._continue(saved)
        except (EstimatorError, KeyError, ValueError) as problem:
            raise EstimatorError(f"{path}: not as icreckon writes it: {problem}") from None
        return estimator

    def copy(self) -> PoseEstimator:
        """Copy the estimator; both continue alike, to the last bit, and independently."""
        twin = PoseEstimator(self.robot, self.variant.name, settings=self.settings)
        twin._continue(self._saved())
        return twin

    def restarted(
        self,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> PoseEstimator:
        """Start a new estimator with the parameters, biases and scales of this one.

        As `warm_start` without a file: pose, slip, clock and counts start again.

        Args:
            start: pose at the first track speeds: x, y [m], yaw [rad].
            start_sigma: its standard deviations [m, m, rad].

        Raises:
            EstimatorError: an argument is invalid.
        """
        robot, variant = self.robot, self.variant.name
        new = PoseEstimator(
            robot, variant, settings=self.settings, start=start, start_sigma=start_sigma
        )
        new._start_with(self._reckoning.checkpoint(), 0.0)
        new._stamps = StampCorrection(self.latencies, self._stamps.estimated)
        return new

    def _saved(self) -> SavedEstimator:
        """Content of a file from which `_continue` goes on."""
        self._reckoning.own_faults.require_files()
        self._watch(self._reckoning.record)
        return SavedEstimator(
            self.variant.name,
            robot_constants(self.robot),
            self.settings,
            self._reckoning.checkpoint().plain(),
            self._history.checkpoint(),
            self._arrivals.copy(),
            dict(self._admission.witnesses),
            self._stamps.latencies,
            self._stamps.estimated,
            tuple(map(event_row, self._admission.behind)),
            self._stamps.memory(),
        )

    def _continue(self, saved: SavedEstimator) -> None:
        """Check the content of a file, and go on from there."""
        for checkpoint in (saved.now, saved.history.checkpoint):
            require_sound(checkpoint, self._reckoning.ekf)
        for event in map(event_of, (*saved.history.measurements, *saved.behind)):
            reason = None if isinstance(event, Mark) else self._admission.objection(event)
            if reason is not None:
                raise EstimatorError(f"a measurement at {event.stamp}: {reason}")
        behind = [measurement_of(row) for row in saved.behind]
        for stream, count in Counter(STREAMS[type(late)] for late in behind).items():
            if saved.arrivals.sensor(stream).rejected.get(TOO_OLD, 0) < count:
                raise EstimatorError(f"{stream}: more is too old than was counted")
        self._reckoning.restore(saved.now)
        self._history.restore(saved.history)
        self._arrivals = saved.arrivals
        self._admission.witnesses = dict(saved.witnesses)
        self._admission.behind = behind
        self._stamps = StampCorrection(saved.latencies, saved.estimated_latency, saved.watch)

    def _start_with(self, checkpoint: FilterCheckpoint, off: float) -> None:
        """Start with parameters, biases and scales of a checkpoint made `off` seconds ago."""
        self._reckoning.warm_start(checkpoint, off)
        self._history = History(self._reckoning, self.settings.history, self._watch)

    @classmethod
    def warm_start(
        cls,
        path: str | Path,
        robot: Robot,
        variant: str | None = None,
        *,
        off: float,
        settings: Settings | None = None,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
        latencies: Latencies | None = None,
    ) -> PoseEstimator:
        """Start a new estimator with the parameters, biases and scales of a saved one.

        They start with their covariance; that of the biases grows by their random walk over the time in
        between. Pose, slip, clock and counts start again.

        Args:
            path: file that `save` has written.
            robot: robot that it was saved for; noise densities and slip may have changed since.
            variant: required variant, None for any.
            off: time since it was saved [s].
            settings: settings of the new estimator; None for those of the saved one.
            start: pose at the first track speeds: x, y [m], yaw [rad].
            start_sigma: its standard deviations [m, m, rad].
            latencies: latencies of the stamps; None for those of the saved one.

        Raises:
            EstimatorError: as for `restore`, or `off` is negative.
        """
        require_robot(robot)
        if not 0.0 <= off < np.inf:
            raise EstimatorError(f"off must be a time in seconds, zero or more, found {off!r}")
        saved = read_saved(Path(path))
        saved.require_fit(robot, variant, str(path), to_continue=False)
        settings = saved.settings if settings is None else settings
        estimator = cls(
            robot, saved.variant, settings=settings, start=start, start_sigma=start_sigma
        )
        try:
            require_sound(saved.now, estimator._reckoning.ekf, to_continue=False)
        except ValueError as problem:
            raise EstimatorError(f"{path}: not as icreckon writes it: {problem}") from None
        estimator._start_with(saved.now, off)
        wanted = saved.latencies if latencies is None else latencies
        estimated = saved.estimated_latency if wanted.estimate_tracks else 0.0
        estimator._stamps = StampCorrection(wanted, estimated)
        return estimator
