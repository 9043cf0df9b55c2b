"""Estimated motion over a log."""

from dataclasses import dataclass

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.log.series import PoseSeries


@dataclass(frozen=True)
class Trajectory:
    """Trajectory estimated by a filter, sampled at `stamps`, in REP-103 axes.

    Attributes:
        stamps: (n,) [ns].
        poses: (n, 3) x, y [m], yaw [rad] of base_link in odom.
        pose_covariances: (n, 3, 3) in the axes of odom.
        twists: (n, 3) v_x, v_y [m/s], w [rad/s] of base_link in its own axes.
        twist_covariances: (n, 3, 3).
        spatial: (n, 3) z [m], roll, pitch [rad]; None if they are not estimated.
        spatial_sigmas: (n, 3) their standard deviations, or None.
    """

    stamps: Stamps
    poses: Floats
    pose_covariances: Floats
    twists: Floats
    twist_covariances: Floats
    spatial: Floats | None = None
    spatial_sigmas: Floats | None = None

    def __repr__(self) -> str:
        """One line: duration and number of poses."""
        lasts = float(np.ptp(self.stamps)) * NANOSECOND if len(self.stamps) else 0.0
        return f"<Trajectory, {lasts:.1f} s: {len(self.stamps)} poses>"

    @property
    def pose_series(self) -> PoseSeries:
        """Poses without covariances."""
        return PoseSeries(self.stamps, self.poses, self.spatial)
