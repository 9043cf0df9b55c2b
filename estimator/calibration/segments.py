"""Segments of logs: integrated tracks and IMU, and averaged truth, for the fit.

A segment is a few seconds in which no stream has a gap. Track speeds and gyro are integrated over cells
of some 50 ms, the truth is averaged about the ends of segments (knots). Axes are those of REP-103.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Floats, Indexes, Stamps
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import relative, rotate
from icreckon.estimator.calibration.ground_forces import GroundForces
from icreckon.estimator.log import lag as log_lag
from icreckon.estimator.log.lag import Curve, NoLag
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import even_grid
from icreckon.estimator.log.series import ImuSeries, PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors.sensor_models import SensorModels

Series = tuple[Floats, Floats]  # times (t,) [s] and values (t, k)

CELL = 0.05  # approximate length of a cell [s]
LARGEST_GAP, LARGEST_TRUTH_GAP = 0.5, 1.0
"""A longer gap in track speeds or IMU samples, or in the truth, ends a piece of the log [s]."""
KNOT_WINDOW = 0.25  # truth within this time of a knot counts for it [s]
FEWEST_FOR_LINE, ASIDE = 4, 0.03
"""Least number of poses for a line, and most of the square of their mean time over its variance [-]."""
KEPT_KNOTS = 2  # lags whose truth at the knots is kept: the present ones, and these plus a step
STILL_SHARE = 0.005  # speeds up to this share of the fastest count as standstill [-]
LEAST_FINITE = 0.9  # least share of finite accelerometer readings; the others are interpolated [-]
LEAST_SHARED = 5.0  # least time that truth and IMU share [s]
LEAST_SEGMENTS = 10  # least number of moving segments for a calibration
LEAST_TURNING = 1.0  # least total rotation of the robot [rad]
SMALLEST_BLOCK, LARGEST_BLOCK, BLOCKS = 3, 8, 10
"""Least and largest number of moving segments in a block, which is left out or resampled as a whole, and
the least number of blocks if there are segments enough."""
FIXES_AS_TRUTH = (
    " (positions of RTK GPS can be it: rename [log.fixes] to [log.truth]; plain GPS is too rough)"
)
"""Advice for a log with fixes but without truth."""


@dataclass(frozen=True)
class Motion:
    """Continuous series of one log, as functions of the seconds since its start."""

    log: Log  # source of the series
    track_times: Floats  # (k,) times of the track speeds [s]
    track_distances: Floats  # (k, 2) distance of each track since the start [m]
    imu_times: Floats  # (i,) times of the IMU samples [s]
    turned: Floats  # (i,) integral of the uncorrected gyro rate about the vertical [rad]
    force_integral: Floats | None  # (i, 2) of the specific force forward and left [m/s], if any
    truth_times: Floats  # (t,) times of the truth, as stamped [s]
    truth: Floats  # (t, 3) x, y [m], yaw [rad], unwrapped
    lag: float  # initial estimate of the truth's lag [s]; 0 if none was found
    no_lag: NoLag | None  # reason why none was found; None if it was
    bias: float  # initial estimate of the gyro's bias [rad/s]
    forces: GroundForces | None = None  # None before they are estimated
    own_headings: bool = True  # False if the truth's headings are from the path of tracks and gyro


@dataclass(frozen=True)
class Recording:
    """Segments of all logs, one after the other."""

    motions: tuple[Motion, ...]  # the logs
    length: float  # length of a segment [s]
    log: Indexes  # (n,) index of each segment's log
    edges: Floats  # (n, m + 1) ends of its cells [s since the log's start]
    turned: Floats  # (n, m + 1) integral of the gyro at these ends [rad]
    moving: Flags  # (n,) True if the robot moves throughout the segment
    follows: Flags  # (n,) True if it begins at the end of the previous one
    block: Indexes  # (n,) index of its block; blocks are contiguous
    starts: Indexes  # (n,) knot at which it begins
    ends: Indexes  # (n,) knot at which it ends
    knot_log: Indexes  # (k,) log of each knot
    knot_times: Floats  # (k,) time of each knot [s]
    pair_knot: Indexes  # (p,) knot of each truth pose near a knot
    pair_pose: Indexes  # (p,) index of that pose in its log's truth
    paths: tuple[Series, ...]  # dead-reckoned path of each log: times (q,) [s], poses (q, 3)
    # Results of `knots` by the bytes of the lags: most calls change other parameters.
    _kept: dict[bytes, tuple[Floats, Floats, Floats]] = field(default_factory=dict, init=False)

    @property
    def cell(self) -> float:
        """Length of a cell [s]."""
        return float(self.length / (self.edges.shape[1] - 1))

    def speeds(self, latency: float) -> Floats:
        """Mean track speeds (n, m, 2) of each cell [m/s], corrected for a latency [s]."""
        series = [(motion.track_times, motion.track_distances) for motion in self.motions]
        distances = self._interpolate(self.edges + latency, series)
        return np.asarray(np.diff(distances, axis=1) / self.cell)

    def ground_forces(self) -> Floats:
        """Forces (n, m, 2) at middles of cells: S over mass [m/s²], P [-]; zero if unset."""
        middles = 0.5 * (self.edges[:, 1:] + self.edges[:, :-1])
        forces = [motion.forces for motion in self.motions]
        series = [own and (own.times, np.column_stack([own.lateral, own.along])) for own in forces]
        return self._interpolate(middles, series)

    def mean_force(self, marks: Indexes) -> Floats:
        """Mean specific force (n, b, 2) between marked cells [m/s²]; zero without one."""
        times = 0.5 * (self.edges[:, marks] + self.edges[:, marks + 1])
        pairs = [(motion.imu_times, motion.force_integral) for motion in self.motions]
        series = [None if integral is None else (at, integral) for at, integral in pairs]
        changes = np.diff(self._interpolate(times, series), axis=1)
        return np.asarray(changes / np.diff(times, axis=1)[..., None])

    def _interpolate(self, times: Floats, series: Sequence[Series | None]) -> Floats:
        """Series of each log (n, k, 2) at times of the segments (n, k); zero without one."""
        result = np.zeros((*times.shape, 2))
        for log, log_series in enumerate(series):
            if log_series is not None:
                is_of_log = self.log == log
                result[is_of_log] = _interpolated(times[is_of_log], *log_series)
        return result

    def knots(self, lags: Floats) -> tuple[Floats, Floats, Floats]:
        """Truth at the knots, corrected for the lag (logs,) of each log [s].

        It is the weighted mean of the truth poses near a knot, carried over to it by dead reckoning.

        Returns:
            Position (k, 2) [m], mean rotation matrix (k, 2, 2) by the yaw, and yaw (k,) [rad].
        """
        kept, key = self._kept, lags.tobytes()
        if key not in kept:
            if len(kept) == KEPT_KNOTS:
                kept.clear()
            kept[key] = self._knots(lags)
        return kept[key]

    def _knots(self, lags: Floats) -> tuple[Floats, Floats, Floats]:
        # Weighted means at the knots: x, y [m], cosine and sine of the yaw, yaw [rad].
        means = np.zeros((len(self.knot_times), 5))
        for log, motion in enumerate(self.motions):
            in_log = self.knot_log[self.pair_knot] == log
            knot, pose = self.pair_knot[in_log], self.pair_pose[in_log]
            knot_times, stamped_times = self.knot_times[knot], motion.truth_times[pose]
            times = stamped_times - lags[log]
            carried = _carried_over(motion.truth[pose], times, knot_times, self.paths[log])
            after_initial = stamped_times - motion.lag - knot_times
            weight = _weights_at_knots(knot, times - knot_times, after_initial, len(means))
            np.add.at(means, knot, weight[:, None] * carried)
        cos, sin = means[:, 2:4].T
        rotation = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], axis=1)
        return means[:, :2], rotation, means[:, 4]


def _interpolated(wanted: Floats, times: Floats, values: Floats) -> Floats:
    """Values (t, k) of times (t,) interpolated linearly at times (...): (..., k)."""
    return np.stack([np.interp(wanted, times, column) for column in values.T], axis=-1)


def _carried_over(poses: Floats, times: Floats, knot_times: Floats, path: Series) -> Floats:
    """Truth poses (p, 3), moved along a path from their times (p,) to knots (p,).

    The result (p, 5) is x, y [m], cosine and sine of the yaw before the move, and yaw [rad].
    """
    step = relative(_interpolated(times, *path), _interpolated(knot_times, *path))
    x, y, yaw = poses.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    moved_x = x + cos * step[:, 0] - sin * step[:, 1]
    moved_y = y + sin * step[:, 0] + cos * step[:, 1]
    return np.column_stack([moved_x, moved_y, cos, sin, yaw + step[:, 2]])


def _weights_at_knots(knot: Indexes, after: Floats, after_initial: Floats, knots: int) -> Floats:
    """Weights (p,) of truth poses in the value at their knots.

    Poses are `after` (p,) their knots [s]. The value at a knot is that of a regression line of its poses.
    If most of them lie on one side, a line would amplify noise, and it is their mean. `after_initial`
    (p,), by the initial lag, decides which: if the present lag did, residuals would jump as it changes.
    """
    poses_at, mean, variance = _moments(knot, after_initial, knots)
    has_line = (poses_at >= FEWEST_FOR_LINE) & (mean**2 < ASIDE * variance)
    poses_at, mean, variance = _moments(knot, after, knots)
    slope = np.where(has_line, mean / np.where(has_line, variance, 1.0), 0.0)
    return np.asarray((1.0 - slope[knot] * (after - mean[knot])) / poses_at[knot])


def _moments(knot: Indexes, after: Floats, knots: int) -> tuple[Floats, Floats, Floats]:
    """Number (k,) of the poses of each knot, and mean and variance of their times."""
    count = np.maximum(np.bincount(knot, minlength=knots), 1).astype(float)
    mean = np.bincount(knot, after, minlength=knots) / count
    return count, mean, np.bincount(knot, (after - mean[knot]) ** 2, minlength=knots) / count


def motion_of(log: Log, robot: Robot) -> Motion:
    """Make the continuous series of a log; `EstimatorError` if it has too little."""
    poses, imu = _truth_and_imu(log)
    imu_times = _seconds(imu.stamps, log.start)
    # Readings and track speeds are means since the one before.
    track_times = _seconds(log.tracks.stamps, log.start)
    track_steps = np.diff(track_times)[:, None] * log.tracks.speeds[1:]
    # The scale of the gyro is estimated: that of the file, which is in the mounting, is removed.
    by_gyros = robot.imu.gyro_scale * SensorModels(robot).mounting[0]
    gyro = log_lag.turned(imu.stamps, imu.angular_velocity @ by_gyros)
    heading = log_lag.heading_of(poses)
    found = log_lag.find_lag(heading, gyro, least=log_lag.LEAST_TURN)
    lag, no_lag = (0.0, found) if isinstance(found, NoLag) else (found.seconds, None)
    return Motion(
        log=log,
        track_times=track_times,
        track_distances=np.concatenate([np.zeros((1, 2)), np.cumsum(track_steps, axis=0)]),
        imu_times=imu_times,
        turned=gyro.values,
        force_integral=_integrated_force(imu, imu_times, robot),
        truth_times=_seconds(poses.stamps, log.start),
        truth=np.column_stack([poses.poses[:, :2], heading.values]),
        lag=lag,
        no_lag=no_lag,
        bias=_initial_bias(heading, gyro, lag),
    )


def _truth_and_imu(log: Log) -> tuple[PoseSeries, ImuSeries]:
    """Poses of the truth and IMU samples, if the log has enough of all streams."""
    if log.truth is None or len(log.truth.poses.stamps) < 2:
        raise EstimatorError(
            f"log {log.name!r} holds no pose truth, so nothing to calibrate from; name its topic in "
            f"[log.truth] of the robot file{FIXES_AS_TRUTH if log.fixes is not None else ''}"
        )
    if log.imu is None or len(log.imu.stamps) < 2:
        raise EstimatorError(
            f"log {log.name!r} holds no IMU samples; calibration needs a gyro: name its topic in "
            "[log.imu] of the robot file"
        )
    if len(log.tracks.stamps) < 2:
        raise EstimatorError(
            f"log {log.name!r} holds {len(log.tracks.stamps)} track speeds; name their topic in "
            "[log.tracks] of the robot file"
        )
    poses, imu = log.truth.poses, log.imu
    shared = min(imu.stamps[-1], poses.stamps[-1]) - max(imu.stamps[0], poses.stamps[0])
    if shared * NANOSECOND < LEAST_SHARED:
        raise EstimatorError(
            f"truth and IMU of log {log.name!r} share only {max(0.0, shared * NANOSECOND):.1f} s; "
            "nothing can be calibrated from that"
        )
    return poses, imu


def _seconds(stamps: Stamps, start: int) -> Floats:
    """Times (n,) of stamps since a start [ns] in seconds."""
    return np.asarray((stamps - start) * NANOSECOND, dtype=float)


def record(
    motions: Sequence[Motion], robot: Robot, length: float, *, difference: float, scale: float = 1.0
) -> Recording:
    """Cut logs into segments of equal length, one after another between gaps.

    Args:
        motions: the series of each log, with the lag to use.
        robot: robot model of the path along which truth is carried over to knots.
        length: length of a segment [s].
        difference: scale of the right track less that of the left, for that path [-].
        scale: scale of the track speeds, for that path [-].

    Raises:
        EstimatorError: too few segments that move, or too little turning.
    """
    log, begins, follows = _segments(motions, length)
    cells = max(2, round(length / CELL))
    edges = begins[:, None] + length / cells * np.arange(cells + 1)
    turned, fastest_in = np.empty_like(edges), np.empty(len(log))
    for number, motion in enumerate(motions):
        in_log = log == number
        turned[in_log] = np.interp(edges[in_log], motion.imu_times, motion.turned)
        distances = _interpolated(edges[in_log], motion.track_times, motion.track_distances)
        fastest_in[in_log] = np.abs(np.diff(distances, axis=1)).max(axis=(1, 2), initial=0.0)
    speeds = [np.diff(m.track_distances, axis=0).T / np.diff(m.track_times) for m in motions]
    fastest = max(float(np.abs(of_motion).max()) for of_motion in speeds)
    moving = fastest_in * cells / length > STILL_SHARE * fastest
    _require_motion(motions, length, turned, moving)
    # A segment that follows another begins at the knot at which that ends; others have two new knots.
    starts = np.cumsum(np.where(follows, 1, 2)) - 2
    ends = starts + 1
    knots = int(ends[-1]) + 1
    knot_log, knot_times = np.empty(knots, dtype=np.int64), np.empty(knots)
    knot_log[starts] = knot_log[ends] = log
    knot_times[starts], knot_times[ends] = edges[:, 0], edges[:, -1]
    pairs = [
        _poses_near_knots(motion, np.flatnonzero(knot_log == number), knot_times)
        for number, motion in enumerate(motions)
    ]
    return Recording(
        motions=tuple(motions),
        length=length,
        log=log,
        edges=edges,
        turned=turned,
        moving=moving,
        follows=follows,
        block=_blocks(log, moving),
        starts=starts,
        ends=ends,
        knot_log=knot_log,
        knot_times=knot_times,
        pair_knot=np.concatenate([knot for knot, _ in pairs]),
        pair_pose=np.concatenate([pose for _, pose in pairs]),
        paths=tuple(_path(motion, robot, scale, difference) for motion in motions),
    )


def _segments(motions: Sequence[Motion], length: float) -> tuple[Indexes, Floats, Flags]:
    """Log, begin [s] and `Recording.follows` (n,) of segments of a length [s]."""
    logs, begins, follows = [], [], []
    for number, motion in enumerate(motions):
        for low, high in _pieces(motion):
            places = np.arange(int((high - low) // length))
            logs.append(np.full(len(places), number))
            begins.append(low + length * places)
            follows.append(places > 0)
    if not sum(map(len, logs)):
        raise _too_short(motions, 0, length)
    return np.concatenate(logs), np.concatenate(begins), np.concatenate(follows)


def _require_motion(
    motions: Sequence[Motion], length: float, turned: Floats, moving: Flags
) -> None:
    """Reject too few moving segments, and too little turning by the gyro (n, m + 1)."""
    moved = int(moving.sum())
    if moved < LEAST_SEGMENTS:
        raise _too_short(motions, moved, length)
    turning = np.abs(np.diff(turned[moving], axis=1)).sum()
    if turning < LEAST_TURNING:
        raise EstimatorError(
            f"the robot turned {turning:.2g} rad in all, which shows no ICR; drive bends, circles and "
            "turns on the spot"
        )


def _too_short(motions: Sequence[Motion], found: int, length: float) -> EstimatorError:
    """Error for too few moving segments of a length [s]."""
    names = ", ".join(repr(motion.log.name) for motion in motions)
    return EstimatorError(
        f"only {found} segments of {length:g} s in which the robot moves and tracks, IMU and truth "
        f"have no holes, in {names}; at least {LEAST_SEGMENTS} are needed: drive longer, or choose "
        "shorter segments"
    )


def _blocks(log: Indexes, moving: Flags) -> Indexes:
    """Block (n,) of each segment: contiguous, of one log, alike in moving segments."""
    size = int(np.clip(moving.sum() // BLOCKS, SMALLEST_BLOCK, LARGEST_BLOCK))
    blocks, block, moving_in_block = np.zeros(len(log), dtype=np.int64), 0, 0
    for segment in range(len(log)):
        is_full = moving_in_block >= size and moving[segment]
        if segment and (log[segment] != log[segment - 1] or is_full):
            block, moving_in_block = block + 1, 0
        moving_in_block += int(moving[segment])
        blocks[segment] = block
    # A block of less than half the size joins the one before it.
    for last in range(block, 0, -1):
        in_last, first = np.asarray(blocks == last), int(np.argmax(blocks == last))
        if moving[in_last].sum() < (size + 1) // 2 and log[first] == log[first - 1]:
            blocks[in_last] = last - 1
    return np.asarray(np.unique(blocks, return_inverse=True)[1], dtype=np.int64)


def _poses_near_knots(
    motion: Motion, log_knots: Indexes, knot_times: Floats
) -> tuple[Indexes, Indexes]:
    """Pairs (p,) of knots of a log and truth poses within `KNOT_WINDOW`, or nearest."""
    knots, poses = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    body_times = motion.truth_times - motion.lag
    for knot in log_knots:
        time = knot_times[knot]
        low, high = np.searchsorted(body_times, [time - KNOT_WINDOW, time + KNOT_WINDOW])
        if low == high:
            low = np.abs(body_times - time).argmin()
            high = low + 1
        poses.append(np.arange(low, high))
        knots.append(np.full(high - low, knot))
    return np.concatenate(knots), np.concatenate(poses)


def _pieces(motion: Motion) -> list[tuple[float, float]]:
    """Intervals [s] without a gap in any stream, less `KNOT_WINDOW` at each end."""
    streams = (
        (motion.track_times, LARGEST_GAP),
        (motion.imu_times, LARGEST_GAP),
        (motion.truth_times - motion.lag, LARGEST_TRUTH_GAP),
    )
    low = max(float(times[0]) for times, _ in streams) + KNOT_WINDOW
    high = min(float(times[-1]) for times, _ in streams) - KNOT_WINDOW
    gaps = []
    for times, largest in streams:
        before = np.flatnonzero(np.diff(times) > largest)
        gaps += [(float(times[index]), float(times[index + 1])) for index in before]
    pieces = []
    # The gaps of different streams may overlap: the next piece begins after the latest end so far.
    for begin, end in sorted(gaps):
        if begin - KNOT_WINDOW > low:
            pieces.append((low, min(begin - KNOT_WINDOW, high)))
        low = max(low, end + KNOT_WINDOW)
    if high > low:
        pieces.append((low, high))
    return pieces


def _path(motion: Motion, robot: Robot, scale: float, difference: float) -> Series:
    """Times [s] and poses of dead reckoning by gyro and the robot's constant ICRs."""
    times = even_grid(motion.track_times[0], motion.track_times[-1], 0.02, motion.track_times)
    distances = _interpolated(times, motion.track_times, motion.track_distances)
    measured = np.interp(times, motion.imu_times, motion.turned)
    yaw = (measured - motion.bias * times) / robot.imu.gyro_scale
    indices = robot.constant_indices
    turned = np.diff(yaw)
    # Each track has half of the forward motion, with half of the difference of the scales.
    weights = scale * (0.5 + 0.25 * difference * np.array([-1.0, 1.0]))
    forward = np.diff(distances, axis=0) @ weights - turned * indices.epsilon0
    moves = np.stack([forward, -turned * indices.zeta0], axis=-1)
    steps = rotate(moves, 0.5 * (yaw[1:] + yaw[:-1]))
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return times, np.column_stack([places, yaw])


def _integrated_force(imu: ImuSeries, times: Floats, robot: Robot) -> Floats | None:
    """Integral (i, 2) of the levelled specific force [m/s]; None for too few readings."""
    readings = imu.linear_acceleration
    if readings is None:
        return None
    finite: Flags = np.asarray(np.isfinite(readings).all(axis=1))
    if finite.sum() < LEAST_FINITE * len(finite):
        return None
    levelled = readings[finite] @ robot.imu_rotation[:2].T
    filled = _interpolated(times, times[finite], levelled)
    changes = np.diff(times)[:, None] * filled[1:]
    return np.concatenate([np.zeros((1, 2)), np.cumsum(changes, axis=0)])


def _initial_bias(truth: Curve, gyro: Curve, lag: float) -> float:
    """Initial gyro bias [rad/s]: median of gyro less truth, which lags by `lag` [s]."""
    origin = int(truth.stamps[0])
    seconds = (truth.stamps - origin) * NANOSECOND
    starts = even_grid(0.0, seconds[-1] - log_lag.WINDOW, 0.25, seconds)
    turned_apart = gyro.changes(origin, starts - lag) - truth.changes(origin, starts)
    return float(np.median(turned_apart)) / log_lag.WINDOW
