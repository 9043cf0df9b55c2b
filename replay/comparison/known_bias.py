"""Gyro bias that wheels and gyro had no chance to learn.

The variant `gyro` learns its bias at standstill or from fixes. Without either it keeps that of the robot
file, while other variants learn it from the tracks, too. Its drift is then that of a bias, not of its
model. The truth shows the bias, and `gyro` runs once more with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.integral import running_integral
from icreckon.estimator.log.scores import even_grid, interpolate, interpolate_poses, pieces
from icreckon.estimator.log.series import Truth
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.outputs import Run

GYRO = "gyro"
KNOWN_BIAS = "gyro-known-bias"
"""Name of the run of `gyro` with the bias that the truth shows."""
UNLEARNT = 0.5
"""Share of its initial standard deviation from which a bias is not learnt."""
LEAST_SHARE = 0.1
"""Least share of the scored time without a learnt bias that matters."""
BLOCK = 10.0
"""Time over which headings of run and truth are compared [s]."""
LARGEST_HOLE = 0.5
"""Blocks across a longer gap in the truth are left out [s]."""
FEWEST_BLOCKS = 4
"""Least number of blocks that show a bias."""
CHANCE = 0.0027
"""Probability, by Student's t, below which chance does not explain a bias other than that in use."""
LARGEST = 1.0
"""A robot file has no larger bias [rad/s]: the gyro's unit is wrong, not its bias."""


@dataclass(frozen=True)
class KnownBias:
    """Bias of the gyro by the truth, if `gyro` used another.

    Attributes:
        used: mean of the bias that `gyro` used [rad/s].
        shown: the bias that the truth shows [rad/s].
        sigma: its standard error [rad/s].
    """

    used: float
    shown: float
    sigma: float

    def robot(self, robot: Robot) -> Robot:
        """Copy of a robot that has this bias."""
        imu = msgspec.structs.replace(
            robot.imu,
            gyro_bias=self.shown,
            gyro_bias_sigma=min(self.sigma, robot.imu.gyro_bias_sigma),
        )
        return msgspec.structs.replace(robot, imu=imu)


def known_bias(
    run: Run, truth: Truth, robot: Robot, within: list[tuple[int, int]]
) -> KnownBias | None:
    """Find the bias that `gyro` had no chance to learn.

    Args:
        run: run of `gyro`.
        truth: the aligned truth, with headings of its own or from its path.
        robot: the robot.
        within: intervals of stamps [ns] that are scored.

    Returns:
        The bias; None if `gyro` learnt its own, or had one that the truth does not contradict.
    """
    inside = np.zeros(len(run.stamps), bool)
    for start, end in within:
        inside |= (run.stamps >= start) & (run.stamps <= end)
    initial = robot.imu.gyro_bias_sigma
    unlearnt = inside & (run.state_sigmas[:, s.GYRO_BIAS] >= UNLEARNT * initial)
    if not inside.any() or unlearnt.sum() < LEAST_SHARE * inside.sum():
        return None
    used = float(run.states[unlearnt, s.GYRO_BIAS].mean())
    found = _by_headings(run, truth, within)
    if found is None or abs(found.shown) > LARGEST or abs(found.shown - used) <= found.sure:
        return None
    return KnownBias(used, found.shown, found.sigma)


class _Shown(NamedTuple):
    """Bias by the headings, its standard error, and what chance explains [rad/s]."""

    shown: float
    sigma: float
    sure: float


def _by_headings(run: Run, truth: Truth, within: list[tuple[int, int]]) -> _Shown | None:
    """Find the bias by the headings; None for a short log.

    A wrong scale turns with the robot, a wrong bias with time: both are fitted. The bias is that of the
    rate after the robot file's scale is corrected, as in the filter and in the file.
    """
    from scipy.special import stdtrit

    poses = truth.poses
    step = round(BLOCK / NANOSECOND)
    starts = []
    for low, high in within:
        first, last = max(low, int(poses.stamps[0])), min(high, int(poses.stamps[-1]))
        starts.append(even_grid(first, last - step + 1, step, poses.stamps))
    begins = np.concatenate(starts)
    ends = begins + step
    holes = pieces(poses.stamps, LARGEST_HOLE)
    before = np.searchsorted(poses.stamps, begins, side="right") - 1
    after = np.minimum(np.searchsorted(poses.stamps, ends), len(holes) - 1)
    whole = (before >= 0) & (holes[before] == holes[after])
    begins, ends = begins[whole], ends[whole]
    if len(begins) < FEWEST_BLOCKS:
        return None
    turned, true = (
        interpolate_poses(one, ends)[:, 2] - interpolate_poses(one, begins)[:, 2]
        for one in (run.trajectory.pose_series, poses)
    )
    # The bias that the filter took off, over each block.
    sums = running_integral(run.stamps, run.states[:, s.GYRO_BIAS])
    before_it, after_it = (
        interpolate(run.stamps, sums[:, None], at)[:, 0] for at in (begins, ends)
    )
    # Poses are unwrapped: a large bias turns by more than half a turn in a block.
    apart = turned - true + after_it - before_it
    design = np.column_stack([np.full(len(begins), BLOCK), turned])
    value, *_ = np.linalg.lstsq(design, apart, rcond=None)
    misfit = apart - design @ value
    freedom = len(begins) - 2
    variance = misfit @ misfit / freedom * np.linalg.pinv(design.T @ design)[0, 0]
    sigma = float(np.sqrt(variance))
    return _Shown(float(value[0]), sigma, stdtrit(freedom, 1.0 - 0.5 * CHANCE) * sigma)
