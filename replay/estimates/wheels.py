"""First estimates of wheels, units and standstills from a log, without a filter."""

import math
import re
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Floats, Indexes, Stamps
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.base.lag_search import BLOCKS, jackknife_sigma, without_blocks
from icreckon.estimator.log.failed_sensors import stuck_sides
from icreckon.estimator.log.lag import turned
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.scores import are_within, even_grid, interpolate_poses, pieces
from icreckon.estimator.log.series import (
    FixSeries,
    ImuSeries,
    PoseSeries,
    TrackSpeedSeries,
    running_integral,
)
from icreckon.replay.estimates import imu_mounting
from icreckon.replay.estimates.fix_wander import fit_fixes
from icreckon.replay.estimates.imu_mounting import Mounting, YawRates
from icreckon.replay.mapping.naming import sides
from icreckon.replay.mapping.topics import TopicMap
from icreckon.replay.reading.conversions import STANDARD_GRAVITY

CLEAR_SIGN = 0.3  # least correlation of tracks and gyro that shows the sign of turning [-]
FAST_TURNING = 6.0  # yaw rate that a ground robot hardly exceeds [rad/s]
GRAVITY = 9.81
COUNTS_OF_G = (2048, 4096, 8192, 16384)  # counts of a g, of ranges from 16 to 2 g and 16 bits
COUNT_OF_GYRO = 0.000133  # usual size of a count, of a range of 250 deg/s and 16 bits [rad/s]
WRONG_GRAVITY = 0.03  # relative error of the mean specific force from which it is suspicious [-]
DEGREES = (20.0, 180.0)  # ratio to odometry's yaw rates that means degrees (57.3 without slip)
TOO_MUCH_TURNING = 2.5  # factor by which slip hardly makes odometry overestimate the yaw rate [-]
LARGEST_TURNING = 1.0  # largest turning within a window at which its path is assumed an arc [rad]
WINDOWS = {"truth": 2.0, "fixes": 10.0}  # time over which distances are compared [s], by source
FEWEST_WINDOWS = 5
MEDIAN_ERROR = 1.25  # standard error of a median of normal errors over that of their mean [-]
LARGEST_HOLE = 1.0  # windows with a gap longer than this, and than three samples, are left out [s]
TURN_WINDOW = 2.0  # time over which turning by tracks and gyro is compared [s]
FEWEST_TURNS = 20  # such windows from which on the effective track has a standard error
MOST_UNCERTAIN = 0.2  # least standard error of one that is not shown, over its value [-]
WHEEL_RADII = (0.01, 0.5)  # plausible wheel radii [m]
WIDEST, WIDEST_IN_RADII = 3.0, 12.0  # largest effective track [m], and over the wheel radius [-]
MOST_RADII = 30.0  # effective track over wheel radius from which speeds are in rpm, not rad/s [-]
METRES = re.compile(r"(?i)m_?p_?s|m_s|m/s|[ck]?m\b|kmh")  # words of speeds over ground
HEADING_ROUNDS = 3  # rounds in which the offset of a heading and the place of the robot agree
COURSE_LENGTH, COURSE_TIME, CLEAR_COURSE = 0.5, 5.0, 0.8
"""Course over ground: least distance [m], longest time [s]; least mean vector of its offsets [-]."""


class Estimate(NamedTuple):
    """Estimate by a log."""

    value: float
    sigma: float | None  # standard error, None if unknown
    source: str  # "gyro", "truth", "fixes" or "accelerometer"

    @property
    def error(self) -> str:
        """Standard error as text, such as " ± 0.012"; empty if unknown."""
        return "" if self.sigma is None else f" ± {self.sigma:.2g}"

    def times(self, factor: float) -> Self:
        """Estimate and standard error times a factor."""
        sigma = None if self.sigma is None else self.sigma * factor
        return self._replace(value=self.value * factor, sigma=sigma)


class WheelEstimates(NamedTuple):
    """Estimates of the wheels by ground distance and gyro; None if not observable."""

    # distance over ground over the distance by the tracks: the effective radius [m] if their speeds are
    # rates [rad/s], otherwise 1 [-]
    distance: Estimate | None = None
    # V_r - V_l over the yaw rate: effective track over effective radius [-] if track speeds are rates,
    # otherwise the effective track [m]
    track: Estimate | None = None


NO_WHEELS = WheelEstimates()


def wheel_estimates(
    log: Log, yaw_rates: YawRates, correlation: float | None, most_turning: float = LARGEST_TURNING
) -> WheelEstimates:
    """Estimate the effective radius and track; track speeds may be rates.

    The track needs a clear `correlation` of yaw rates and V_r - V_l. The radius needs a truth, or else
    fixes, and windows that turn by no more than `most_turning` [rad]. A stuck side shows neither.
    """
    if not imu_mounting.are_usable(log.tracks) or stuck_sides(log.tracks, None):
        return NO_WHEELS
    track = None
    if (correlation or 0.0) > imu_mounting.CLEAR_TURNING:
        track = _turning_ratio(log.tracks, yaw_rates)
    if log.truth is not None:
        distance = _distance_ratio(log, yaw_rates, "truth", log.truth.poses, 0.0, most_turning)
    elif log.fixes is None:
        distance = None
    elif (fit := fit_fixes(log, yaw_rates)) is not None:
        # Wander makes distances between fixes longer, but not the path that fits them.
        distance = Estimate(fit.scale, fit.scale_sigma, "fixes")
    else:
        places, variances = PoseSeries(log.fixes.stamps, log.fixes.poses), log.fixes.variances[:, 0]
        noise = float(np.sqrt(np.median(variances))) if len(variances) else 0.0
        distance = _distance_ratio(log, yaw_rates, "fixes", places, noise, most_turning)
    return WheelEstimates(distance, track)


def _turning_ratio(tracks: TrackSpeedSeries, yaw_rates: YawRates) -> Estimate | None:
    """Ratio of V_r - V_l to the yaw rate by linear regression; None if hardly seen."""
    # The regression is of the tracks on the gyro, whose noise hardly counts over a window.
    edges, is_whole = windows(TURN_WINDOW, tracks.stamps, yaw_rates.stamps)
    if is_whole.sum() < FEWEST_WINDOWS:
        return None
    curves = turned(*yaw_rates), turned(tracks.stamps, tracks.difference)
    turns, differences = (np.diff(np.interp(edges, c.stamps, c.values))[is_whole] for c in curves)

    def ratio(rows: Indexes) -> float:
        covariance = np.cov(turns[rows], differences[rows])
        return float(covariance[0, 1] / covariance[0, 0])

    if len(turns) < FEWEST_TURNS:
        return Estimate(ratio(np.arange(len(turns))), None, "gyro")
    with np.errstate(divide="ignore", invalid="ignore"):
        value, sigma = jackknifed(ratio, len(turns))
    if not np.isfinite(sigma):
        return Estimate(value, None, "gyro")
    return Estimate(value, sigma, "gyro") if sigma < MOST_UNCERTAIN * abs(value) else None


def windows(length: float, *streams: Stamps) -> tuple[Stamps, Flags]:
    """Edges (w + 1,) [ns] of windows [s], and mask (w,) of those without hole."""
    firsts, lasts = zip(*(one[[0, -1]] for one in streams), strict=True)
    edges = even_grid(max(firsts), min(lasts), step := round(length / NANOSECOND), streams[0])
    is_whole: Flags = np.diff(edges) == step
    for one in streams:
        longest = max(LARGEST_HOLE, 3.0 * float(np.ptp(one)) / max(1, len(one) - 1) * NANOSECOND)
        is_whole &= are_within(pieces(one, longest), one, edges[:-1], edges[1:])
    return edges, is_whole


def jackknifed(estimate: Callable[[Indexes], float], count: int) -> tuple[float, float]:
    """Estimate from `count` rows, and its standard error, by leaving out blocks."""
    rows = np.arange(count)
    without = np.array([estimate(kept) for kept in without_blocks(rows)])
    return estimate(rows), float(jackknife_sigma(without))


def _distance_ratio(
    log: Log,
    yaw_rates: YawRates,
    source: str,
    places: PoseSeries,
    noise: float,
    most_turning: float,
) -> Estimate | None:
    """Distance between places over the distance by the tracks; None if unknown.

    The median over windows that turn by less than `most_turning` [rad] while the robot clearly drives.
    `noise` is the standard deviation of each coordinate of the places [m].
    """
    window, stamps = WINDOWS[source], places.stamps
    edges, is_whole = windows(window, log.tracks.stamps, yaw_rates.stamps)

    def changes(of_stamps: Stamps, values: Floats) -> Floats:
        """Changes (w,) over the windows."""
        return np.diff(np.interp(edges, of_stamps, values))

    imu, rates = yaw_rates
    speed = log.tracks.speeds.mean(axis=1)
    distance = changes(log.tracks.stamps, running_integral(log.tracks.stamps, speed))
    turning = changes(imu, running_integral(imu, np.abs(rates)))
    yaw = changes(imu, running_integral(imu, rates))
    # Distances between places are chords, shorter than an arc of this yaw by the factor sinc.
    chords = np.hypot(*(changes(stamps, column) for column in places.poses[:, :2].T))
    track_chords = np.abs(distance) * np.sinc(yaw / (2.0 * np.pi))
    has_positions = np.diff(np.searchsorted(stamps, edges)) >= 2
    drives = track_chords > 0.3 * np.abs(speed).max() * window
    counts = (turning < most_turning) & drives & has_positions & is_whole
    if counts.sum() < FEWEST_WINDOWS:
        return None
    ratios = chords[counts] / track_chords[counts]
    relative_noise = noise / max(noise, float(np.median(chords[counts]))) if noise else 0.0
    # Noise across the path makes chords longer: the median is off by the square.
    longer = relative_noise**2
    by_noise = MEDIAN_ERROR * np.sqrt(2.0 / len(ratios)) * relative_noise
    if len(ratios) < 2 * BLOCKS:
        value = float(np.median(ratios))
        return Estimate(value, value * float(np.hypot(by_noise, longer)) or None, source)
    value, sigma = jackknifed(lambda rows: float(np.median(ratios[rows])), len(ratios))
    return Estimate(value, float(np.hypot(max(sigma, value * by_noise), value * longer)), source)


def standstills(log: Log) -> list[tuple[int, int, bool]]:
    """Ends [ns] of each stop of both tracks, and whether gyros turn in it."""
    imu, stops = log.imu, imu_mounting.stops(log.tracks)
    if imu is None:
        return [(*stop, False) for stop in stops]
    stamps, rates = imu.stamps, imu.angular_velocity
    return [(*stop, imu_mounting.turns_in(stop, stamps, rates)) for stop in stops]


def turning_suspicion(tracks: TrackSpeedSeries, yaw_rates: YawRates, gauge: float = 1.0) -> str:
    """Note on yaw rates of the odometry that do not fit the gyro's; empty if they do.

    `gauge` [m] is the one with which track speeds were computed from the odometry's twist.
    """
    odometry = float(tracks.difference.std()) / gauge
    gyro = float((yaw_rates.rates - yaw_rates.rates.mean()).std())
    if not (odometry > 0.0 and gyro > 0.0):
        return ""
    lowest, highest = DEGREES
    if lowest < gyro / odometry < highest:
        return f"the gyro reads {gyro / odometry:.0f} times the odometry's yaw rate; in deg/s?"
    if odometry / gyro > TOO_MUCH_TURNING:
        return (
            f"the odometry's yaw rate is {odometry / gyro:.1f} times the gyro's, more than slip "
            "explains; is the gauge of its controller known?"
        )
    return ""


def units_and_sides(
    mapping: TopicMap,
    log: Log,
    filled_in: Collection[str],
    notes: list[str],
    read_tracks: Callable[..., Log],
) -> dict[str, dict[str, Any]]:
    """Keys of [log] tables: units of IMU and tracks, and sides that no name shows.

    `filled_in` are the tables that a person filled in, `read_tracks` reads the tracks of a robot with a
    highest speed `fastest`. Adds a note on each.
    """
    mounting = imu_mounting.estimate_mounting(log)
    keys: dict[str, dict[str, Any]] = {}
    if log.imu is None:
        return keys
    if units := _imu_units(log.imu, mounting, notes):
        keys["imu" if mapping.imu else "columns.imu"] = units
    if mounting is not None and not {"tracks", "columns.tracks"} & {*filled_in}:
        yaw_rates = imu_mounting.vertical_rate(log.imu, mounting)
        track_keys, log = _sides_by_turning(mapping, log, yaw_rates, notes, read_tracks)
        track_keys |= _unit_by_size(mapping, log, yaw_rates, notes)
        if track_keys:
            keys["tracks" if mapping.tracks else "columns.tracks"] = track_keys
    return keys


def _imu_units(imu: ImuSeries, mounting: Mounting | None, notes: list[str]) -> dict[str, Any]:
    """Keys for units of an IMU that are likelier than rad/s and m/s²."""
    units: dict[str, Any] = {}
    force = 0.0
    if mounting is not None and mounting.specific_force is not None:
        force = float(np.linalg.norm(mounting.specific_force))
    counts = next((size for size in COUNTS_OF_G if abs(force - size) < 0.05 * size), None)
    if counts is not None:
        notes.append(
            f"the mean specific force is {force:.4g}: taken for counts, {counts} of a g; rate_unit is "
            "that of a gyro with 131 counts of a deg/s (range 250 deg/s): correct it for another"
        )
        scale = round(STANDARD_GRAVITY / counts, 9)
        return {"rate_unit": COUNT_OF_GYRO, "acceleration_unit": scale}
    fast, in_degrees = fast_turning(imu), math.degrees(FAST_TURNING)
    for unit, lowest, highest in (
        ("deg/s", FAST_TURNING, in_degrees),
        ("mdps", 10.0 * in_degrees, 1e3 * in_degrees),
    ):
        if lowest < fast < highest:
            units["rate_unit"] = unit
            notes.append(
                f"the gyro reads {fast:.3g} and more for 1 % of the time: taken for {unit}"
            )
    for unit in ("g", "mg"):
        if unit_of_gravity(force) == f"; in {unit}?":
            units["acceleration_unit"] = unit
            notes.append(f"the mean specific force is {force:.4g}: taken for {unit}")
    return units


def _sides_by_turning(
    mapping: TopicMap,
    log: Log,
    yaw_rates: YawRates,
    notes: list[str],
    read_tracks: Callable[..., Log],
) -> tuple[dict[str, Any], Log]:
    """Keys of tracks whose names show no side, by the gyro, and the log with them."""
    tracks, topics = mapping.track_keys, mapping.tracks
    if tracks is None or not tracks.left:
        return {}, log
    names = tracks.names
    if topics is not None and topics.right_topic is not None:
        names = topics.topic, topics.right_topic
    if any(sides(names)):
        return {}, log
    driven = log.tracks
    if len(names) > 2:
        # Speeds of each wheel are kept where they differ by more than a share of the highest speed.
        driven = read_tracks(fastest=float(np.abs(driven.speeds).max())).tracks
    left, right = driven.left_wheels, driven.right_wheels
    if left is None or right is None:
        left, right = (column[:, None] for column in driven.speeds.T)
        left, right = left.repeat(len(tracks.left), axis=1), right.repeat(len(tracks.right), axis=1)
    wheels = np.column_stack([left, right])
    by_gyro = sides_of(wheels, np.interp(driven.stamps, *yaw_rates))
    if by_gyro is None:
        left_names = ", ".join(map(repr, names[: len(tracks.left)]))
        notes.append(
            f"tracks: taken for the left side: {left_names}, and nothing shows whether it is"
        )
        return {}, log
    is_right, is_backward = by_gyro
    all_names = np.array(names, object)
    left_names = ", ".join(map(repr, all_names[~is_right]))
    note = f"tracks: taken for the left side: {left_names}, by the gyro"
    if is_backward.any():
        note += f"; counting backward: {', '.join(map(repr, all_names[is_backward]))}"
    notes.append(note)
    wheels = wheels * np.where(is_backward, -1.0, 1.0)
    means = np.column_stack([wheels[:, ~is_right].mean(axis=1), wheels[:, is_right].mean(axis=1)])
    log = replace(log, tracks=TrackSpeedSeries(driven.stamps, means))
    fields = np.array(tracks.names, object)
    fields[is_backward] = [f"-{field}" for field in fields[is_backward]]
    keys: dict[str, Any] = {"left": tuple(fields[~is_right]), "right": tuple(fields[is_right])}
    if topics is not None and topics.right_topic is not None and is_right[0]:
        keys |= {"topic": topics.right_topic, "right_topic": topics.topic}
    return keys, log


def sides_of(wheels: Floats, turning: Floats) -> tuple[Flags, Flags] | None:
    """Sides of wheels by the turning of the robot; None if it does not show them.

    Args:
        wheels: (n, k) speeds, also of wheels that count backward.
        turning: (n,) yaw rate at their stamps [rad/s].

    Returns:
        Masks (k,) of the wheels of the right side, and of those that count backward. At most half of the
        wheels count backward; if it is half of them, the robot drives forward most of the way.
    """
    # Each wheel turns by a factor times the yaw rate, plus a factor times the forward speed, which is the
    # main component of the remainder. Signs of the second factors show which wheels count backward.
    rate = turning - turning.mean()
    if not rate.any():
        return None
    by_turning = wheels.T @ rate / (rate @ rate)
    along = wheels - np.outer(rate, by_turning)
    by_speed = np.linalg.eigh(along.T @ along)[1][:, -1]
    without_speed = wheels - np.outer(along @ by_speed, by_speed)
    shares = [np.abs(factors).min() / np.abs(factors).max() for factors in (by_turning, by_speed)]
    correlations = [abs(np.corrcoef(wheel, rate)[0, 1]) for wheel in without_speed.T if wheel.std()]
    if len(correlations) < wheels.shape[1] or min(*correlations, *shares) < CLEAR_SIGN:
        return None
    is_backward = by_speed < 0.0
    surplus = 2 * is_backward.sum() - len(is_backward)
    if surplus > 0 or (surplus == 0 and float((wheels @ by_speed).sum()) < 0.0):
        is_backward = ~is_backward
    is_right = (by_turning > 0.0) != is_backward
    return (is_right, is_backward) if 2 * is_right.sum() == len(is_right) else None


def _unit_by_size(
    mapping: TopicMap, log: Log, yaw_rates: YawRates, notes: list[str]
) -> dict[str, Any]:
    """Unit of track speeds that no name states: rad/s or rpm if m/s are implausible."""
    tracks = mapping.track_keys
    if tracks is None or not tracks.left or tracks.unit != "m/s" or METRES.search(tracks.left[0]):
        return {}
    correlation = imu_mounting.turning_correlation(log.tracks, yaw_rates)
    wheels = wheel_estimates(log, yaw_rates, abs(correlation or 0.0))
    # Effective track in units of the track speeds' length.
    width = abs(wheels.track.value) if wheels.track else 0.0
    smallest, largest = WHEEL_RADII
    if wheels.distance is not None:
        is_rate = smallest < wheels.distance.value < largest
        reason = f"the distance over ground is {wheels.distance.value:.2g} times theirs"
    else:
        is_rate = WIDEST < width < WIDEST_IN_RADII
        reason = f"in m/s the effective track would be {width:.2g} m"
    if not is_rate:
        return {}
    unit = "rad/s"
    if width > MOST_RADII:
        unit, reason = "rpm", f"in rad/s the effective track would be {width:.0f} wheel radii"
    notes.append(f"tracks: taken for {unit}: {reason}")
    return {"unit": unit}


def fast_turning(imu: ImuSeries) -> float:
    """Rate that the gyro exceeds for 1 % of the time [rad/s]."""
    return float(np.percentile(np.abs(imu.angular_velocity), 99))


def unit_of_gravity(force: float) -> str:
    """Question about the likely unit of a mean specific force; empty without a guess."""
    if force < imu_mounting.NO_GRAVITY:
        return ": gravity has been removed, use the accelerations before that or none"
    for unit, size in (("g", 1.0), ("mg", 1000.0), ("cm/s²", 981.0), ("ft/s²", 32.2)):
        if abs(force - size) <= 0.015 * size or (unit == "g" and abs(force - size) < 0.05):
            return f"; in {unit}?"
    return ""


class HeadingOffset(NamedTuple):
    """Offset from measured heading to direction of driving."""

    value: float  # [deg]
    sigma: float  # its standard error [deg]
    change: float  # its linear change from the first course to the last [deg]
    change_sigma: float  # standard error of the change [deg]


def heading_offset(log: Log, antenna: Floats | None = None) -> HeadingOffset | None:
    """Offset of a heading from courses by the fixes; None if not clear.

    Without fixes it is the offset from a truth with headings. `antenna` (2,) is the place of the fixes'
    antenna, forward and left [m]; by default the place in the log.
    """
    headings = [other for other in log.others if isinstance(other, HeadingFix)]
    if len(headings) < 2:
        return None
    stamps = np.array([heading.stamp for heading in headings])
    yaws = np.unwrap([heading.yaw for heading in headings])
    if log.fixes is None:
        return _mean_offset(stamps, yaws, *_true_yaws(log, stamps))
    arms = log.fixes.lever_arms[:, :2] if antenna is None else antenna
    yaws_at_fixes, offset = np.interp(log.fixes.stamps, stamps, yaws), None
    # The middle of the robot drives to where it heads; where it is depends on the heading itself.
    for _ in range(HEADING_ROUNDS):
        turn = 0.0 if offset is None else np.radians(offset.value)
        middles = log.fixes.poses[:, :2] - rotate(arms, yaws_at_fixes + turn)
        offset = _mean_offset(stamps, yaws, *_yaws_of_courses(log.fixes, log.tracks, middles))
        if offset is None or not arms.any():
            return offset
    return offset


def _yaws_of_courses(
    fixes: FixSeries, tracks: TrackSpeedSeries, middles: Floats
) -> tuple[list[int], list[float]]:
    """Times [ns] and yaws [rad] of courses, by the robot's middle (n, 2) at the fixes."""
    stamps, sigmas = fixes.stamps, np.sqrt(fixes.variances[:, 0])
    times, yaws, begin = list[int](), list[float](), 0
    for row in range(1, len(stamps)):
        x, y = middles[row] - middles[begin]
        # NaN shows no course.
        if not np.hypot(x, y) >= max(COURSE_LENGTH, 5.0 * sigmas[begin], 5.0 * sigmas[row]):
            continue
        if (stamps[row] - stamps[begin]) * NANOSECOND < COURSE_TIME:
            times.append(int(stamps[row] + stamps[begin]) // 2)
            yaws.append(float(np.arctan2(y, x)))
        begin = row
    if times and len(tracks.stamps):
        # Tracks that drive backward.
        speeds = np.interp(times, tracks.stamps, tracks.speeds.sum(axis=1))
        yaws = (np.array(yaws) + np.where(speeds < 0.0, np.pi, 0.0)).tolist()
    return times, yaws


def _true_yaws(log: Log, stamps: Stamps) -> tuple[list[int], list[float]]:
    """Stamps [ns], of those given, that a truth with headings covers, and yaws [rad]."""
    truth = log.truth
    if truth is None or not truth.headings:
        return [], []
    known = truth.poses.stamps
    inside = stamps[(stamps >= known[0]) & (stamps <= known[-1])]
    yaws = interpolate_poses(truth.poses, inside)[:, 2].tolist() if len(inside) else []
    return inside.tolist(), yaws


def _mean_offset(
    stamps: Stamps, yaws: Floats, times: list[int], yaws_of_robot: list[float]
) -> HeadingOffset | None:
    """Offset of headings from yaws of the robot at some times [ns]; None if not clear."""
    if len(times) < FEWEST_WINDOWS:
        return None
    # As complex numbers, so that angles can be averaged.
    offsets = np.exp(1j * (np.array(yaws_of_robot) - np.interp(times, stamps, yaws)))
    mean = complex(offsets.mean())
    if abs(mean) < CLEAR_COURSE:
        return None
    about_mean = np.degrees(np.angle(offsets * np.conj(mean)))
    share = (np.array(times) - times[0]) / (times[-1] - times[0])
    change, _ = np.polyfit(share, about_mean, 1)
    error = float(about_mean.std()) / np.sqrt(len(times))
    change_sigma = error / float(share.std())
    return HeadingOffset(float(np.degrees(np.angle(mean))), error, float(change), change_sigma)
