"""Alignment of a logged truth: estimation and removal of lag and lever arm.

A pose from lidar or GPS is stamped late, and it is that of a sensor rather than of `base_link`. Both
would count as drift. They are estimated from relative motion over short windows, in which dead
reckoning is accurate, and reported. A truth of positions alone has no headings to align by: they are
found from the path, and its lag from the changes of speed.

A truth may be in a frame of its own, as that of a total station. Runs begin at the truth and go on by the
fixes: it is moved to their frame.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.log.lag import (
    LEAST_SPEEDING,
    LEAST_TURN,
    NoLag,
    find_lag,
    heading_of,
    places_of,
)
from icreckon.estimator.log.lever_arm import at_lever_arm, headings_and_lever_arm, lever_arm
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import PathHeadings
from icreckon.estimator.log.series import ImuSeries, Truth
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.replay.comparison.fixes import OF_FIXES
from icreckon.replay.comparison.holes import true_poses_at
from icreckon.replay.comparison.truth_level import levelled

LOGGED_START_SIGMA = (0.02, 0.01)  # sigma of the initial pose from a logged truth [m, rad]
FAR_OFF = 5.0  # distance of fixes from a truth, over their sigma, from which on it is noted [-]
TURNED = math.radians(5.0)  # turn between two frames that are not one [rad]
FARTHEST_OFF = 30.0  # distance of fixes from a truth, by which no receiver is off [m]
# Largest median distance left once the frames are one, over that before, and over the truth's spread [-].
MOST_LEFT = 0.3
FEWEST_PLACES = 10  # fewest fixes that show it


@dataclass(frozen=True)
class TruthAlignment:
    """Lag and lever arm removed from a truth.

    Attributes:
        lag: delay of its stamps against gyro or path [s]; None if not found, and it is used as stamped.
        lever_arm: position of the tracked point in base_link: x forward, y left [m].
        truth: the corrected truth of `base_link`.
        lag_sigma: standard error of the lag [s]; None if it was not found, or not searched.
        no_lag: reason why the lag was not found, empty if it was.
        headings: headings that were found from the path, None if the truth has its own.
        tilt: angle by which the vertical of the truth was off [rad].
    """

    lag: float | None
    lever_arm: tuple[float, float]
    truth: Truth
    lag_sigma: float | None = None
    no_lag: str = ""
    headings: PathHeadings | None = None
    tilt: float = 0.0

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on missing headings, and on a lag that is not observable."""
        notes = []
        if self.headings is not None:
            nees = "" if self.truth.source == OF_FIXES else ", NEES of the position"
            notes.append(
                f"the truth has no headings: scored are positions (drift, error at the end{nees}). They "
                "are aligned by headings from the path of tracks and gyro, "
                f"± {math.degrees(self.headings.sigma):.1f}°"
            )
        if self.no_lag:
            notes.append(
                f"the lag of the truth was not found: {self.no_lag}; it is used as stamped, and drift "
                "includes the way driven in the lag. If you know it, set latency in [log.truth]"
            )
        return tuple(notes)

    @property
    def start_sigma(self) -> tuple[float, float, float]:
        """Standard deviations of the truth's pose at the start of a run [m, m, rad]."""
        place, turn = LOGGED_START_SIGMA
        if self.headings is not None:
            place = max(place, self.headings.noise)
            turn = math.hypot(turn, self.headings.start_sigma)
        return place, place, turn


def align_truth(
    truth: Truth, reckoned: Trajectory, *, imu: ImuSeries | None = None
) -> TruthAlignment:
    """Estimate and remove lag and lever arm of a truth, by dead reckoning at its time.

    A filter uses each sample of the gyro for the step that ends with it, so its headings are half an
    interval of the IMU ahead. This lead is removed, too, but the reported lag does not include it. `imu`
    is that of the dead reckoning, None for tracks alone. What is not observable is no lag, a zero lever
    arm, or no headings.
    """
    path = reckoned.pose_series
    gyro_lead = 0.0
    if truth.headings:
        measured_lag = find_lag(heading_of(truth.poses), heading_of(path), least=LEAST_TURN)
        if imu is not None and len(imu.stamps) > 1:
            gyro_lead = 0.5 * float(np.median(np.diff(imu.stamps))) * NANOSECOND
    else:
        measured_lag = find_lag(places_of(truth.poses), places_of(path), least=LEAST_SPEEDING)
    if isinstance(measured_lag, NoLag):
        return replace(align_place(truth, reckoned), lag=None, no_lag=measured_lag.reason)
    stamps = truth.poses.stamps - round(measured_lag.seconds / NANOSECOND)
    aligned = align_place(replace(truth, poses=replace(truth.poses, stamps=stamps)), reckoned)
    return replace(aligned, lag=measured_lag.seconds - gyro_lead, lag_sigma=measured_lag.sigma)


def align_place(truth: Truth, reckoned: Trajectory) -> TruthAlignment:
    """Estimate and remove lever arm and tilt of a truth without lag.

    A filter's base_link is its mean turning centre, which depends on its model and parameters. The same
    truth therefore has another lever arm for each filter.
    """
    path, headings = reckoned.pose_series, None
    if truth.headings:
        lever = lever_arm(truth.poses, path)
        series = at_lever_arm(truth.poses, -lever)
    elif (found := headings_and_lever_arm(truth.poses, path)) is not None:
        headings, lever, series = found
    else:
        return TruthAlignment(0.0, (0.0, 0.0), truth)
    series, tilt = levelled(series, reckoned)
    forward, left = lever.tolist()
    aligned = replace(truth, poses=series)
    return TruthAlignment(0.0, (forward, left), aligned, headings=headings, tilt=tilt)


def own_alignment(common: TruthAlignment, reckoned: Trajectory) -> TruthAlignment:
    """Realign a truth, aligned to one variant, to another's run; lever arms add up."""
    own = align_place(common.truth, reckoned)
    (common_x, common_y), (own_x, own_y) = common.lever_arm, own.lever_arm
    return replace(own, lag=common.lag, lever_arm=(common_x + own_x, common_y + own_y))


class _FrameFit(NamedTuple):
    """Fit of the antenna's places by the truth to fixes; places are complex numbers."""

    turn: complex  # factor that turns the frame of the truth to that of the fixes
    shift: complex  # added to the turned places [m]
    off: float  # median distance of fixes from the truth [m]
    left: float  # what the fit leaves of it [m]
    spread: float  # deviation of the places from their mean [m]
    sigma: float  # median stated sigma of the fixes [m]


def in_frame_of_fixes(log: Log) -> Log:
    """Move the truth to the frame of the fixes if that clearly is another one."""
    fit, truth = _frame_fit(log), log.truth
    if fit is None or truth is None or fit.left > MOST_LEFT * min(fit.off, fit.spread):
        return log
    angle = float(np.angle(fit.turn))
    if abs(angle) < TURNED and fit.off < FARTHEST_OFF:
        return log
    x, y, yaw = truth.poses.poses.T
    moved = (x + 1j * y) * fit.turn + fit.shift
    poses = replace(truth.poses, poses=np.column_stack([moved.real, moved.imag, yaw + angle]))
    note = (
        "the truth is in another frame than the fixes: it was moved to theirs, by a turn of "
        f"{math.degrees(angle):.1f} deg, which leaves {fit.left:.2g} m in the median"
    )
    return replace(log, truth=replace(truth, poses=poses), notes=(*log.notes, note))


def far_fixes_note(log: Log) -> list[str]:
    """Note on fixes that are far off the truth for their stated sigma."""
    fit = _frame_fit(log)
    if fit is None or fit.off < FAR_OFF * fit.sigma:
        return []
    return [
        f"the fixes are {fit.off:.2g} m off the truth in the median and state {fit.sigma:.2g} m: they "
        "wander, or are not in the frame of the truth, where runs begin (origin or frames in [log.fixes])"
    ]


def _frame_fit(log: Log) -> _FrameFit | None:
    """Fit the truth to the fixes, weighted by their variances; None with too few."""
    truth, fixes = log.truth, log.fixes
    if truth is None or truth.source == OF_FIXES or fixes is None:
        return None
    # The yaw may be one that was found.
    poses = true_poses_at(replace(truth, headings=True), fixes.stamps)
    antennas = poses[:, :2] + rotate(fixes.lever_arms[:, :2], poses[:, 2])
    places, true = (xy[:, 0] + 1j * xy[:, 1] for xy in (fixes.poses[:, :2], antennas))
    known = np.isfinite(places) & np.isfinite(true) & (fixes.variances[:, 0] > 0.0)
    if known.sum() < FEWEST_PLACES:
        return None
    places, true, variances = places[known], true[known], fixes.variances[known, 0]
    weights = 1.0 / variances
    mean, true_mean = (np.average(xy, weights=weights) for xy in (places, true))
    turn = np.exp(1j * np.angle(np.vdot(weights * (true - true_mean), places - mean)))
    shift = mean - turn * true_mean
    off, left = (float(np.median(np.abs(places - xy))) for xy in (true, turn * true + shift))
    sigma = math.sqrt(float(np.median(variances)))
    return _FrameFit(complex(turn), complex(shift), off, left, float(true.std()), sigma)
