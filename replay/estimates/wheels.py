"""First estimates of wheels, units and standstills from a log, without a filter."""

import math
import re
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.base.lag_search import BLOCKS, jackknife_sigma, without_blocks
from icreckon.estimator.log.failed_sensors import stuck_sides
from icreckon.estimator.log.lag import turned
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.scores import even_grid, interpolate_poses
from icreckon.estimator.log.series import ImuSeries, PoseSeries, TrackSpeedSeries, running_integral
from icreckon.replay.estimates import imu_mounting
from icreckon.replay.estimates.fix_wander import fit_fixes
from icreckon.replay.mapping.naming import sides
from icreckon.replay.mapping.topics import TopicMap
from icreckon.replay.reading.conversions import STANDARD_GRAVITY

CLEAR_SIGN = 0.3  # least correlation of tracks and gyro that shows the sign of turning [-]
FAST_TURNING = 6.0  # yaw rate that a ground robot hardly exceeds [rad/s]
GRAVITY = 9.81
COUNT_OF_GYRO = 0.000133  # usual size of a count, of a range of 250 deg/s and 16 bits [rad/s]
WRONG_GRAVITY = 0.03  # relative error of the mean specific force from which it is suspicious [-]
DEGREES = (20.0, 180.0)  # ratio to odometry's yaw rates that means degrees (57.3 without slip)
TOO_MUCH_TURNING = 2.5  # factor by which slip hardly makes odometry overestimate the yaw rate [-]
STRAIGHT = 1.0  # largest turning within a window at which its path is assumed an arc [rad]
WINDOWS = {"truth": 2.0, "fixes": 10.0}  # time over which distances are compared [s], by source
FEWEST_WINDOWS = 5
MEDIAN_ERROR = 1.25  # standard error of a median of normal errors over that of their mean [-]
TURN_WINDOW = 2.0  # time over which turning by tracks and gyro is compared [s]
FEWEST_TURNS = 20  # such windows from which on the effective track has a standard error
WHEEL_RADII = (0.01, 0.5)  # plausible ones [m]
WIDEST, WIDEST_IN_RADII = 3.0, 12.0  # effective tracks [m], over the wheel radius [-]
MOST_RADII = 30.0  # that of no wheels in rad/s, but in rpm [-]
METRES = re.compile(r"(?i)m_?p_?s|m_s|m/s|[ck]?m\b|kmh")  # words of speeds over ground
HEADING_ROUNDS = 3  # rounds in which the offset of a heading and the place of the robot agree
COURSE_LENGTH, COURSE_TIME, CLEAR_COURSE = 0.5, 5.0, 0.8
"""Course over ground: least distance [m], longest time [s]; least mean vector of its offsets [-]."""


class WheelEstimates(NamedTuple):
    """Estimates of the wheels from ground distance and gyro; None if unknown."""

    # distance over ground over that of the track speeds: the effective radius [m] if these are
    # rates [rad/s], otherwise 1 [-]
    distance_ratio: float | None
    distance_source: str  # source of the distance over ground, "truth" or "fixes"
    # V_r - V_l over the yaw rate: effective track over effective radius [-] if track speeds are
    # rates, otherwise the effective track [m]
    track_ratio: float | None
    distance_sigma: float | None = None  # standard error of `distance_ratio`, or None
    track_sigma: float | None = None  # standard error of `track_ratio`, or None


NO_WHEELS = WheelEstimates(None, "", None)


def wheel_estimates(
    log: Log, vertical: Floats | None, correlation: float | None, straight: float = STRAIGHT
) -> WheelEstimates:
    """Estimate the effective radius and track; track speeds may be rates.

    `vertical` (n,) is the rate about the vertical at the IMU's stamps [rad/s], `correlation` that with
    V_r - V_l. Windows that turn by more than `straight` [rad] do not count for the radius, which needs a
    truth, or else fixes. The track needs a clear correlation. A stuck side shows neither.
    """
    is_unusable = not imu_mounting.are_usable(log.tracks) or stuck_sides(log.tracks, None)
    if vertical is None or log.imu is None or is_unusable:
        return NO_WHEELS
    track_ratio = track_sigma = None
    if (correlation or 0.0) > imu_mounting.CLEAR_TURNING:
        track_ratio, track_sigma = _turning_ratio(log, vertical)
    noise = 0.0
    if log.truth is not None:
        source, places = "truth", log.truth.poses
    elif log.fixes is not None:
        source, places = "fixes", PoseSeries(log.fixes.stamps, log.fixes.poses)
        noise = float(np.sqrt(np.median(log.fixes.variances[:, 0]))) if len(places.stamps) else 0.0
        # Wander makes distances between fixes longer, and not the path that fits them.
        if (fit := fit_fixes(log, vertical)) is not None:
            return WheelEstimates(fit.scale, source, track_ratio, fit.scale_sigma, track_sigma)
    else:
        return WheelEstimates(None, "", track_ratio, track_sigma=track_sigma)
    ratio, sigma = _distance_ratio(log, vertical, places, noise, WINDOWS[source], straight)
    return WheelEstimates(ratio, source, track_ratio, sigma, track_sigma)


def _turning_ratio(log: Log, vertical: Floats) -> tuple[float | None, float | None]:
    """Ratio of V_r - V_l to the yaw rate by linear regression, and its standard error."""
    # The regression is of the tracks on the gyro, whose noise hardly counts over a window.
    assert log.imu is not None  # noqa: S101 - checked by the caller
    curves = turned(log.imu.stamps, vertical), turned(log.tracks.stamps, log.tracks.difference)
    imu, tracks = log.imu.stamps, log.tracks.stamps
    first, last = max(imu[0], tracks[0]), min(imu[-1], tracks[-1])
    edges = even_grid(first, last, round(TURN_WINDOW / NANOSECOND), tracks)
    if len(edges) < FEWEST_WINDOWS + 1:
        return None, None
    turns, differences = (np.diff(np.interp(edges, one.stamps, one.values)) for one in curves)

    def ratio(rows: NDArray[np.int_]) -> float:
        covariance = np.cov(turns[rows], differences[rows])
        return float(covariance[0, 1] / covariance[0, 0])

    if len(turns) < FEWEST_TURNS:
        return ratio(np.arange(len(turns))), None
    with np.errstate(divide="ignore", invalid="ignore"):
        value, sigma = jackknifed(ratio, len(turns))
    return value, sigma if np.isfinite(sigma) else None


def jackknifed(estimate: Callable[[NDArray[np.int_]], float], count: int) -> tuple[float, float]:
    """Estimate from `count` rows, and its standard error, by leaving out blocks."""
    rows = np.arange(count)
    without = np.array([estimate(kept) for kept in without_blocks(rows)])
    return estimate(rows), float(jackknife_sigma(without))


def _distance_ratio(
    log: Log, vertical: Floats, places: PoseSeries, noise: float, window: float, straight: float
) -> tuple[float | None, float | None]:
    """Distance over ground over that of the tracks, and its standard error."""
    # It is None if unknown, otherwise the median over windows [s] that turn by less than `straight` [rad]
    # and in which the robot clearly drives. Distances between places are chords, not arcs;
    # `noise` is the standard deviation of each coordinate [m].
    assert log.imu is not None  # noqa: S101 - checked by the caller
    stamps, positions = places.stamps, places.poses[:, :2]
    start, end = max(stamps[0], log.start), min(stamps[-1], log.end)
    edges = even_grid(start, end, round(window / NANOSECOND), stamps)
    if len(edges) < FEWEST_WINDOWS + 1:
        return None, None
    speed = log.tracks.speeds.mean(axis=1)
    tracks, imu = log.tracks.stamps, log.imu.stamps
    distance, turned, yaw = (
        np.diff(np.interp(edges, series, running_integral(series, rate)))
        for series, rate in ((tracks, speed), (imu, np.abs(vertical)), (imu, vertical))
    )
    x, y = (np.diff(np.interp(edges, stamps, column)) for column in positions.T)
    chords = np.hypot(x, y)
    # The chord of an arc of this yaw is shorter by the factor sinc.
    track_chords = np.abs(distance) * np.sinc(yaw / (2.0 * np.pi))
    has_positions = np.diff(np.searchsorted(stamps, edges)) >= 2
    drives = track_chords > 0.3 * np.abs(speed).max() * window
    counts = (turned < straight) & drives & has_positions
    if counts.sum() < FEWEST_WINDOWS:
        return None, None
    ratios = chords[counts] / track_chords[counts]
    relative_noise = noise / max(noise, float(np.median(chords[counts]))) if noise else 0.0
    # Noise across the path makes chords longer: the median is off by the square.
    longer = relative_noise**2
    by_noise = MEDIAN_ERROR * np.sqrt(2.0 / len(ratios)) * relative_noise
    if len(ratios) < 2 * BLOCKS:
        value = float(np.median(ratios))
        return value, value * float(np.hypot(by_noise, longer)) or None
    value, sigma = jackknifed(lambda rows: float(np.median(ratios[rows])), len(ratios))
    return value, float(np.hypot(max(sigma, value * by_noise), value * longer))


def standstills(log: Log) -> list[tuple[float, float]]:
    """Standstills of a second or more: (start, end) since the log's start [s]."""
    times = (np.array(imu_mounting.stops(log.tracks)).reshape(-1, 2) - log.start) * NANOSECOND
    return [(start, end) for start, end in times.tolist() if end - start >= 1.0]


def turning_suspicion(log: Log, vertical: Floats, gauge: float = 1.0) -> list[str]:
    """Compare the spread of the odometry's yaw rate with the gyro's; note a misfit."""
    # `vertical` (n,) is the rate about the vertical at the IMU's stamps [rad/s], `gauge` [m] the one with
    # which track speeds were computed from the twist.
    odometry = float(log.tracks.difference.std()) / gauge
    gyro = float((vertical - vertical.mean()).std())
    if not (odometry > 0.0 and gyro > 0.0):
        return []
    lowest, highest = DEGREES
    if lowest < gyro / odometry < highest:
        return [f"the gyro reads {gyro / odometry:.0f} times the odometry's yaw rate; in deg/s?"]
    if odometry / gyro > TOO_MUCH_TURNING:
        return [
            f"the odometry's yaw rate is {odometry / gyro:.1f} times the gyro's, more than slip "
            "explains; is the gauge of its controller known?"
        ]
    return []


def units_and_sides(
    mapping: TopicMap,
    log: Log,
    known: Collection[str],
    notes: list[str],
    read_tracks: Callable[..., Log],
) -> dict[str, dict[str, Any]]:
    """Keys of [log] tables for an IMU in deg/s or g, and for sides without names.

    `known` are the tables that a person filled in, `read_tracks` reads the tracks of a robot with a
    highest speed `fastest`. Adds a note on each.
    """
    keys: dict[str, dict[str, Any]] = {}
    if log.imu is None:
        return keys
    units: dict[str, Any] = {}
    fast = fast_turning(log.imu)
    mounting = imu_mounting.estimate_mounting(log)
    force = 0.0
    if mounting is not None and mounting.specific_force is not None:
        force = float(np.linalg.norm(mounting.specific_force))
    if counts := counts_of_g(force):
        units = {
            "rate_unit": COUNT_OF_GYRO,
            "acceleration_unit": round(STANDARD_GRAVITY / counts, 9),
        }
        notes.append(
            f"the mean specific force is {force:.4g}: taken for counts, {counts} of a g; rate_unit is "
            "that of a gyro with 131 counts of a deg/s (range 250 deg/s): correct it for another"
        )
    # Limits of what is plausible in rad/s and deg/s, and in mdps.
    in_degrees = math.degrees(FAST_TURNING)
    for unit, least, most in (
        ("deg/s", FAST_TURNING, in_degrees),
        ("mdps", 10.0 * in_degrees, 1e3 * in_degrees),
    ):
        if least < fast < most and not units:
            units["rate_unit"] = unit
            notes.append(
                f"the gyro reads {fast:.3g} and more for 1 % of the time: taken for {unit}"
            )
    for unit in ("g", "mg"):
        if force and unit_of_gravity(force) == f"; in {unit}?":
            units["acceleration_unit"] = unit
            notes.append(f"the mean specific force is {force:.4g}: taken for {unit}")
    if units:
        keys["imu" if mapping.imu else "columns.imu"] = units
    if mounting is not None and not {"tracks", "columns.tracks"} & {*known}:
        vertical = imu_mounting.vertical_rate(log.imu, mounting)
        of_tracks, log = _sides_by_turning(mapping, log, vertical, notes, read_tracks)
        of_tracks |= _unit_by_size(mapping, log, vertical, notes)
        if of_tracks:
            keys["tracks" if mapping.tracks else "columns.tracks"] = of_tracks
    return keys


def _sides_by_turning(
    mapping: TopicMap, log: Log, vertical: Floats, notes: list[str], read_tracks: Callable[..., Log]
) -> tuple[dict[str, Any], Log]:
    """Keys of the tracks for sides without names, by the gyro, and the log with them."""
    tracks, topics = mapping.track_keys, mapping.tracks
    if tracks is None or not tracks.left:
        return {}, log
    are_apart = topics is not None and topics.right_topic is not None
    names = (topics.topic, topics.right_topic) if topics and are_apart else tracks.names
    if any(sides([*filter(None, names)])):
        return {}, log
    driven = log.tracks
    if len(names) > 2:
        # Wheels of a side are kept where they differ by more than a share of the highest speed.
        driven = read_tracks(fastest=float(np.abs(driven.speeds).max())).tracks
    left, right = driven.left_wheels, driven.right_wheels
    if left is None or right is None:
        left, right = (column[:, None] for column in driven.speeds.T)
        left, right = left.repeat(len(tracks.left), axis=1), right.repeat(len(tracks.right), axis=1)
    turning = np.interp(driven.stamps, log.imu.stamps, vertical) if log.imu else vertical
    speeds = np.column_stack([left, right])
    found = sides_of(speeds, turning)
    is_right = np.arange(len(names)) >= len(tracks.left)
    is_backward, shown = np.zeros(len(names), bool), "and nothing shows whether it is"
    if found is not None:
        (is_right, is_backward), shown = found, "by the gyro"

    def listed_where(mask: NDArray[np.bool_]) -> str:
        return ", ".join(repr(name) for name, is_one in zip(names, mask, strict=True) if is_one)

    note = f"tracks: taken for the left side: {listed_where(~is_right)}, {shown}"
    backward = listed_where(is_backward)
    notes.append(f"{note}; counting backward: {backward}" if backward else note)
    if found is None:
        return {}, log
    speeds = speeds * np.where(is_backward, -1.0, 1.0)
    means = np.column_stack([speeds[:, is_right == side].mean(axis=1) for side in (False, True)])
    log = replace(log, tracks=TrackSpeedSeries(driven.stamps, means))
    with_signs = zip(tracks.names, is_backward, strict=True)
    signed = np.array([f"-{name}" if back else name for name, back in with_signs], object)
    by_side = [tuple(signed[is_right == side]) for side in (False, True)]
    keys: dict[str, Any] = {"left": by_side[0], "right": by_side[1]}
    if topics is not None and are_apart and is_right[0]:
        keys |= {"topic": topics.right_topic, "right_topic": topics.topic}
    return keys, log


def sides_of(wheels: Floats, turning: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """Sides of wheels by the turning of the robot; None if it does not show them.

    Args:
        wheels: (n, k) speeds, also of wheels that count backward.
        turning: (n,) yaw rate at their stamps [rad/s].

    Returns:
        Whether each wheel is a right one, and whether it counts backward (k,). Motors that are mounted in
        mirror image may all count backward: then the robot drives forward for most of the way.
    """
    rate = turning - turning.mean()
    if not rate.any():
        return None
    by_turning = wheels.T @ rate / (rate @ rate)
    along = wheels - np.outer(rate, by_turning)
    by_speed = np.linalg.eigh(along.T @ along)[1][:, -1]
    rest = wheels - np.outer(along @ by_speed, by_speed)
    shares = [np.abs(part).min() / np.abs(part).max() for part in (by_turning, by_speed)]
    clear = [abs(np.corrcoef(column, rate)[0, 1]) for column in rest.T if column.std()]
    if len(clear) < wheels.shape[1] or min(*clear, *shares) < CLEAR_SIGN:
        return None
    is_backward = by_speed < 0.0
    surplus = 2 * is_backward.sum() - len(is_backward)
    if surplus > 0 or (surplus == 0 and float((wheels @ by_speed).sum()) < 0.0):
        is_backward = ~is_backward
    is_right = (by_turning > 0.0) != is_backward
    return (is_right, is_backward) if 2 * is_right.sum() == len(is_right) else None


def _unit_by_size(
    mapping: TopicMap, log: Log, vertical: Floats, notes: list[str]
) -> dict[str, Any]:
    """Unit of track speeds that no name states: rad/s or rpm if m/s are implausible."""
    tracks = mapping.track_keys
    if tracks is None or not tracks.left or tracks.unit != "m/s" or METRES.search(tracks.left[0]):
        return {}
    turning = None
    if log.imu is not None:
        turning = imu_mounting.turning_correlation(log.tracks, log.imu, vertical)
    found = wheel_estimates(log, vertical, abs(turning or 0.0))
    smallest, largest = WHEEL_RADII
    if (radius := found.distance_ratio) is not None:
        is_rate = smallest < radius < largest
        reason = f"the distance over ground is {radius:.2g} times theirs"
    else:
        track = abs(found.track_ratio or 0.0)
        is_rate = WIDEST < track < WIDEST_IN_RADII
        reason = f"in m/s the effective track would be {track:.2g} m"
    if not is_rate:
        return {}
    unit, in_radii = "rad/s", abs(found.track_ratio or 0.0)
    if in_radii > MOST_RADII:
        unit, reason = "rpm", f"in rad/s the effective track would be {in_radii:.0f} wheel radii"
    notes.append(f"tracks: taken for {unit}: {reason}")
    return {"unit": unit}


def fast_turning(imu: ImuSeries) -> float:
    """Rate that the gyro exceeds for 1 % of the time [rad/s]."""
    return float(np.percentile(np.abs(imu.angular_velocity), 99))


def counts_of_g(force: float) -> int:
    """Counts of a g, by a mean specific force in counts; 0 for another unit."""
    sizes = (2**bits for bits in range(11, 15))  # of ranges from 16 to 2 g, of 16 bits
    return next((size for size in sizes if abs(force - size) < 0.05 * size), 0)


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
    change_sigma: float  # standard error of that [deg]


def heading_offset(log: Log, antenna: Floats | None = None) -> HeadingOffset | None:
    """Offset of a heading in the frame of the fixes; None if not clear.

    Without fixes it is that in the frame of a truth with headings. `antenna` (2,) is the place of that of
    the fixes, forward and left [m], if it is not that of the log.
    """
    headings = [other for other in log.others if isinstance(other, HeadingFix)]
    if len(headings) < 2:
        return None
    stamps = np.array([heading.stamp for heading in headings])
    yaws = np.unwrap([heading.yaw for heading in headings])
    if log.fixes is None:
        return _mean_offset(stamps, yaws, *_true_yaws(log, stamps))
    arms = log.fixes.lever_arms[:, :2] if antenna is None else antenna
    at_fixes, found = np.interp(log.fixes.stamps, stamps, yaws), None
    # The middle of the robot drives to where it heads; where it is depends on the heading itself.
    for _ in range(HEADING_ROUNDS):
        offset = 0.0 if found is None else np.radians(found.value)
        middles = log.fixes.poses[:, :2] - rotate(arms, at_fixes + offset)
        found = _mean_offset(stamps, yaws, *_yaws_of_courses(log, middles))
        if found is None or not arms.any():
            return found
    return found


def _yaws_of_courses(log: Log, middles: Floats) -> tuple[list[int], list[float]]:
    """Times [ns] and yaws [rad] of courses, by the robot's middle (n, 2) at the fixes."""
    assert log.fixes is not None  # noqa: S101 - checked by the caller
    stamps, sigmas = log.fixes.stamps, np.sqrt(log.fixes.variances[:, 0])
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
    if times and len(log.tracks.stamps):
        # Tracks that drive backward.
        speeds = np.interp(times, log.tracks.stamps, log.tracks.speeds.sum(axis=1))
        yaws = (np.array(yaws) + np.where(speeds < 0.0, np.pi, 0.0)).tolist()
    return times, yaws


def _true_yaws(log: Log, stamps: Stamps) -> tuple[list[int], list[float]]:
    """Times [ns], of these stamps, at which a truth has a yaw, and these yaws [rad]."""
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
