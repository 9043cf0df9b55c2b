"""Mounting and noise of an IMU, estimated from a log.

Gravity gives the vertical; without accelerometers the axis does about which the gyro turns as the tracks
do. The track speeds give the forward direction, since the accelerometer must follow the changes of speed
and the centripetal acceleration, and the times of standstill.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Floats, Stamps, true_runs
from icreckon.estimator.base.frames import rpy_to_matrix
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries

STILL_SPEED = 0.005  # track speeds below this share of the fastest, spikes aside, count as zero [-]
SLOW_AT_GAP, LEAST_GAP = 0.1, 2.0  # highest share of the speed around a gap [s] that is a stop
STILL_MARGIN = 0.5  # time after a stop and before a start that does not count as standstill [s]
STILL_PART, MOST_TURNING_AT_REST = 0.5, 0.05
"""Time of a mean rate [s], and largest range of these at rest [rad/s]."""
ENOUGH_STILL = 2.0  # shortest standstill, less the margins, from which a bias is estimated [s]
ABSURD = 1e6  # implausible reading of an IMU, in rad/s or m/s², or of track speeds, in rad/s
SMOOTHING = 0.5  # time over which accelerations are averaged before they are compared [s]
NO_GRAVITY = 0.5  # mean specific force up to which gravity has been removed, in m/s² and in g
CLEAR_TURNING = 0.7  # smallest correlation of turning with V_r - V_l that is clear [-]
# Largest correlation of turning that is none [-]; least turning of tracks, over their speed [-], and of a
# gyro [rad/s], that is clear.
UNLIKE, TURNING_SHARE, TURNING_RATE = 0.3, 0.2, 0.1
CLEAR_SCORE = 0.4  # smallest sum of two correlations at which a yaw of the mount is accepted [-]


class YawRates(NamedTuple):
    """Rates about the vertical, by an IMU and its mounting."""

    stamps: Stamps  # (n,) those of the IMU [ns]
    rates: Floats  # (n,) [rad/s]


@dataclass(frozen=True)
class Mounting:
    """Mounting and noise of an IMU, estimated from a log."""

    rotation_rpy_deg: tuple[float, float, float]  # [deg]; a yaw by the tracks is a multiple of 90
    up_shown_by: str  # evidence of the vertical: "gravity", "turning", or "" for none
    yaw_shown_by: str  # evidence of the yaw: "tracks", "tf_static", or "" for none: set to 0
    specific_force: Floats | None  # (3,) mean in the IMU's axes [m/s²], None without accelerometers
    still_seconds: float  # duration of standstill in the log [s]
    gyro_axes: str  # "z" if the other two gyros always read zero, otherwise "xyz"
    turning_correlation: float | None  # of yaw rate and V_r - V_l, or None if one is constant
    gyro_bias: Floats | None  # (3,) mean rates at standstill in the IMU's axes [rad/s], or None
    gyro_noise_density: float | None  # of the vertical rate at standstill [rad/s/√Hz], or None
    # of the horizontal specific force while driving, beyond the tracks' motion [m/s²/√Hz], or None
    accelerometer_noise_density: float | None


def estimate_mounting(log: Log) -> Mounting | None:
    """Estimate mounting and noise of an IMU; None without one or if it is absurd."""
    imu = log.imu
    if imu is None or len(imu.stamps) < 2:
        return None
    rates, forces = imu.angular_velocity, imu.linear_acceleration
    if any(table is not None and np.abs(table).max() > ABSURD for table in (rates, forces)):
        return None
    force = None if forces is None else forces.mean(axis=0)
    # Upward direction in the IMU's axes.
    up, shown_by = force, "gravity"
    if up is None or np.linalg.norm(up) < NO_GRAVITY:
        up, shown_by = turning_axis(log.tracks, imu), "turning"
    if up is None:
        up, shown_by = np.array([0.0, 0.0, 1.0]), ""
    x, y, z = up
    roll = float(np.degrees(np.arctan2(y, z)))
    pitch = float(np.degrees(np.arctan2(-x, np.hypot(y, z))))
    levelling = rpy_to_matrix(np.radians(roll), np.radians(pitch), 0.0)
    gyro_axes = "xyz" if rates[:, :2].any() else "z"
    yaw_rates = YawRates(imu.stamps, rate_about(levelling[2], rates, gyro_axes))
    is_still = standstill(log.tracks, imu.stamps, rates)
    step = float(np.median(np.diff(imu.stamps))) * NANOSECOND
    yaw = accelerometer_noise = None
    if forces is not None and shown_by == "gravity":
        horizontal = forces @ levelling[:2].T
        yaw = forward_yaw(log.tracks, yaw_rates, horizontal)
        accelerometer_noise = _density_while_driving(
            log.tracks, yaw_rates, horizontal, ~is_still, step
        )
    still_seconds = float(is_still.sum()) * step
    has_stood = still_seconds >= ENOUGH_STILL
    return Mounting(
        rotation_rpy_deg=(roll, pitch, 0.0 if yaw is None else yaw),
        up_shown_by=shown_by,
        yaw_shown_by="" if yaw is None else "tracks",
        specific_force=force,
        still_seconds=still_seconds,
        gyro_axes=gyro_axes,
        turning_correlation=turning_correlation(log.tracks, yaw_rates),
        gyro_bias=rates[is_still].mean(axis=0) if has_stood else None,
        gyro_noise_density=density(yaw_rates.rates, is_still, step) if has_stood else None,
        accelerometer_noise_density=accelerometer_noise,
    )


def are_usable(tracks: TrackSpeedSeries) -> bool:
    """Test for at least two track speeds, none of them beyond `ABSURD`."""
    return len(tracks.stamps) > 1 and bool(np.abs(tracks.speeds).max() <= ABSURD)


def turning_axis(tracks: TrackSpeedSeries, imu: ImuSeries) -> Floats | None:
    """Unit axis (3,) of an IMU about which it turns as the tracks do; None if unclear."""
    if not are_usable(tracks):
        return None
    difference, rates = (
        np.interp(imu.stamps, tracks.stamps, tracks.difference),
        imu.angular_velocity,
    )
    covariance = (rates - rates.mean(axis=0)).T @ (difference - difference.mean())
    size = float(np.linalg.norm(covariance))
    if size == 0.0:
        return None
    axis = covariance / size
    correlation = turning_correlation(tracks, YawRates(imu.stamps, rates @ axis))
    return axis if correlation is not None and correlation > CLEAR_TURNING else None


def forward_yaw(tracks: TrackSpeedSeries, yaw_rates: YawRates, horizontal: Floats) -> float | None:
    """Estimate the yaw of a levelled mount to the next 90 deg; None if not observable.

    Of four candidates the result [deg] is the one whose forward axis follows the change of the tracks'
    mean speed v, and whose left axis follows v times the yaw rate; all are averaged over half a second.
    `horizontal` (n, 2) is the specific force in the levelled axes [m/s²].
    """
    if not are_usable(tracks):
        return None
    stamps = yaw_rates.stamps
    seconds = (stamps - stamps[0]) * NANOSECOND
    width = max(1, round(SMOOTHING / float(np.median(np.diff(seconds)))))  # samples of an average
    if len(stamps) < 20 * width:
        return None

    def smooth(values: Floats) -> Floats:
        return np.convolve(values, np.full(width, 1.0 / width), "same")

    speed = np.interp(stamps, tracks.stamps, tracks.speeds.mean(axis=1))
    change = smooth(np.gradient(smooth(speed), seconds))
    centripetal = smooth(speed * yaw_rates.rates)
    x, y = smooth(horizontal[:, 0]), smooth(horizontal[:, 1])
    if min(map(np.ptp, (change, centripetal, x, y))) == 0.0:
        return None
    correlations = np.corrcoef([x, y, change, centripetal])
    (x_change, x_centripetal), (y_change, y_centripetal) = correlations[:2, 2:]
    along, across = x_change + y_centripetal, x_centripetal - y_change
    scores = {0.0: along, 90.0: across, 180.0: -along, -90.0: -across}
    best, second = sorted(scores, key=lambda yaw: scores[yaw], reverse=True)[:2]
    return best if scores[best] >= CLEAR_SCORE and scores[best] >= 2.0 * scores[second] else None


def vertical_rate(imu: ImuSeries, mounting: Mounting) -> YawRates:
    """Rates about the vertical of an IMU with a mounting."""
    roll, pitch, _ = np.radians(mounting.rotation_rpy_deg)
    upward = rpy_to_matrix(roll, pitch, 0.0)[2]
    return YawRates(imu.stamps, rate_about(upward, imu.angular_velocity, mounting.gyro_axes))


def rate_about(upward: Floats, rates: Floats, gyro_axes: str) -> Floats:
    """Rate (n,) about a vertical (3,) by gyros (n, 3) of axes "xyz", or "z" alone."""
    return np.asarray(rates @ upward if gyro_axes == "xyz" else rates[:, 2] / upward[2])


def stops(tracks: TrackSpeedSeries) -> list[tuple[int, int]]:
    """First and last stamp [ns] of each stop of both tracks."""
    if not len(tracks.stamps):
        return []
    speed = np.abs(tracks.speeds).max(axis=1)
    fast = np.percentile(speed, 99)
    is_still, is_slow = speed <= STILL_SPEED * fast, speed <= SLOW_AT_GAP * fast
    # From one sample to the next: both about zero, or both slow with a gap between them, of a driver that
    # sends nothing at rest.
    is_gap = np.diff(tracks.stamps) * NANOSECOND > LEAST_GAP
    rests = (is_still[:-1] & is_still[1:]) | (is_gap & is_slow[:-1] & is_slow[1:])
    return [(int(tracks.stamps[k]), int(tracks.stamps[m + 1])) for k, m in true_runs(rests)]


def standstill(tracks: TrackSpeedSeries, stamps: Stamps, rates: Floats) -> Flags:
    """Mask (n,) of stamps [ns] well inside a stop of both tracks, at rest by gyros."""
    result, margin = np.zeros(len(stamps), dtype=bool), round(STILL_MARGIN / NANOSECOND)
    for stop in stops(tracks):
        if not turns_in(stop, stamps, rates):
            result |= (stamps >= stop[0] + margin) & (stamps <= stop[1] - margin)
    return result


def turns_in(stop: tuple[int, int], stamps: Stamps, rates: Floats) -> bool:
    """Return True if gyros (n,) or (n, 3) turn in a stop: carried, or no track speeds."""
    margin = round(STILL_MARGIN / NANOSECOND)
    inside = slice(*np.searchsorted(stamps, (stop[0] + margin, stop[1] - margin)))
    count = max(1, int((stop[1] - stop[0]) * NANOSECOND / STILL_PART))
    means = [part.mean(axis=0) for part in np.array_split(rates[inside], count) if len(part)]
    return bool(means) and float(np.ptp(means, axis=0).max()) > MOST_TURNING_AT_REST


def turning_correlation(tracks: TrackSpeedSeries, yaw_rates: YawRates) -> float | None:
    """Correlation of V_r - V_l with the yaw rate; None if unusable or one is constant."""
    if not are_usable(tracks):
        return None
    difference = np.interp(yaw_rates.stamps, tracks.stamps, tracks.difference)
    if np.ptp(difference) == 0.0 or np.ptp(yaw_rates.rates) == 0.0:
        return None
    return float(np.corrcoef(difference, yaw_rates.rates)[0, 1])


def backward_side(tracks: TrackSpeedSeries, yaw_rates: YawRates) -> str | None:
    """Side that counts backward: then V_r + V_l turns as the gyro; None for neither."""
    mirrored = TrackSpeedSeries(tracks.stamps, tracks.speeds * (1.0, -1.0))
    correlation = turning_correlation(mirrored, yaw_rates)
    if correlation is None or abs(correlation) < CLEAR_TURNING:
        return None
    return "right" if correlation > 0.0 else "left"


def turn_apart(tracks: TrackSpeedSeries, yaw_rates: YawRates) -> bool:
    """Return True if tracks and gyro both turn clearly, but not together."""
    correlation = turning_correlation(tracks, yaw_rates)
    if correlation is None or abs(correlation) > UNLIKE:
        return False
    do_tracks = tracks.difference.std() > TURNING_SHARE * np.abs(tracks.speeds).mean()
    return bool(do_tracks and yaw_rates.rates.std() > TURNING_RATE)


def _density_while_driving(
    tracks: TrackSpeedSeries, yaw_rates: YawRates, horizontal: Floats, drives: Flags, step: float
) -> float | None:
    """Noise density of horizontal specific forces (n, 2) while the robot drives (n,).

    The larger of two [m/s²/√Hz]: of neighbouring samples (fast vibration), and of means over `SMOOTHING`
    without what the tracks' change of speed and their speed times the yaw rate explain (slopes, shocks).
    None if the robot hardly drives. `step` is the interval of the samples [s].
    """
    if drives.sum() <= 10:
        return None
    fast = max(density(axis, drives, step) for axis in horizontal.T)
    width = max(1, round(SMOOTHING / step))
    count = (len(drives) - 1) // width
    if count < 20 or not are_usable(tracks):
        return fast

    def means(values: Floats) -> Floats:
        """Means (count,) of successive `width` samples."""
        return np.asarray(values[: count * width].reshape(count, width).mean(axis=1))

    speed = np.interp(yaw_rates.stamps, tracks.stamps, tracks.speeds.mean(axis=1))
    change = np.diff(speed[: count * width + 1 : width]) / (width * step)
    design = np.column_stack([change, means(speed * yaw_rates.rates), np.ones(count)])
    moving = means(drives.astype(float)) > 0.5
    if moving.sum() < 20:
        return fast
    slow = 0.0
    for axis in horizontal.T:
        force = means(axis)[moving]
        fitted = design[moving] @ np.linalg.lstsq(design[moving], force, rcond=None)[0]
        slow = max(slow, float((force - fitted).std()) * np.sqrt(width * step))
    return max(fast, slow)


def density(values: Floats, where: Flags, step: float) -> float:
    """White noise density [unit/√Hz] of values (n,) where a mask (n,) is set."""
    # Differences of neighbours, `step` [s] apart, are free of slow changes. The variance of a difference
    # is twice that of a sample.
    are_neighbours = where[1:] & where[:-1]
    return float(np.diff(values)[are_neighbours].std() / np.sqrt(2.0) * np.sqrt(step))
