"""Frame of a truth, which may be another one than that of the fixes.

A total station or a motion capture has a frame of its own. Runs begin at the truth and go on by the
fixes, so both must be in one frame.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.frames import rotate
from icreckon.estimator.log.log import Log
from icreckon.replay.comparison.fixes import OF_FIXES
from icreckon.replay.comparison.holes import true_poses_at

FAR_OFF = 5.0  # distance of fixes from a truth, over their sigma, from which on it is noted [-]
TURNED = math.radians(5.0)  # turn between two frames that are not one [rad]
FARTHEST_OFF = 30.0  # distance of fixes from a truth, by which no receiver is off [m]
# Largest median distance left once the frames are one, over that before, and over the truth's spread [-].
MOST_LEFT = 0.3
FEWEST_PLACES = 10  # fewest fixes that show it


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
    """Fit of the truth to the fixes, weighted by their variances; None if there are too few."""
    truth, fixes = log.truth, log.fixes
    if truth is None or truth.source == OF_FIXES or fixes is None:
        return None
    # The yaw may be one that was found.
    poses = true_poses_at(replace(truth, headings=True), fixes.stamps)
    antennas = poses[:, :2] + rotate(fixes.lever_arms, poses[:, 2])
    places, true = (xy[:, 0] + 1j * xy[:, 1] for xy in (fixes.poses[:, :2], antennas))
    known = np.isfinite(places) & np.isfinite(true)
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
