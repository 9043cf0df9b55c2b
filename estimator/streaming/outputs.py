"""Outputs of the estimator: snapshot, predicted pose, ICRs, run over a log."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Flags, Floats, Stamps, true_runs
from icreckon.estimator.base.frames import paper_to_rep103
from icreckon.estimator.filter.fault_table import FAULT_COLUMNS
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.motion.icr import IndexValues, icrs_from_indices
from icreckon.estimator.motion.pose3d import Pose3d, Twist3d, pose3d_of, twist3d_of

Singles = NDArray[np.float32]
UNKNOWN_RATES, UNKNOWN_COVARIANCE = np.full(2, np.nan), np.full((2, 2), np.nan)


class IcrPoints(NamedTuple):
    """ICRs of the left and the right track in base_link: (x forward, y left) [m]."""

    left: tuple[float, float]
    right: tuple[float, float]


def icr_points(indices: IndexValues, track_gauge: float) -> IcrPoints:
    """Compute the ICRs of the tracks by (28) to (30), for a track gauge [m]."""
    icrs = icrs_from_indices(indices, track_gauge)
    left = paper_to_rep103(icrs.x_ICRl, icrs.y_ICR)
    right = paper_to_rep103(icrs.x_ICRr, icrs.y_ICR)
    return IcrPoints(left, right)


class Snapshot(NamedTuple):
    """Estimate at one stamp.

    Attributes:
        stamp: time [ns].
        state: (SIZE,) state of the filter: x, y [m], yaw [rad] first; names in `STATE_NAMES`.
        covariance: (SIZE, SIZE) its covariance; that of the pose is `covariance[:3, :3]`.
        twist: (3,) v_x forward, v_y left [m/s], w [rad/s] of base_link.
        twist_covariance: (3, 3) covariance of the twist.
        indices: sliding, eccentricity and steering efficiency of the present motion.
        tilt_rates: (2,) rates of roll and pitch without their biases [rad/s]; NaN if they are not known.
        tilt_rate_covariance: (2, 2) their covariance.
    """

    stamp: int
    state: Floats
    covariance: Floats
    twist: Floats
    twist_covariance: Floats
    indices: IndexValues
    tilt_rates: Floats = UNKNOWN_RATES
    tilt_rate_covariance: Floats = UNKNOWN_COVARIANCE

    @property
    def pose3d(self) -> Pose3d:
        """Pose with height, roll and pitch."""
        return pose3d_of(self.state, self.covariance)

    @property
    def twist3d(self) -> Twist3d:
        """Velocity with the rates of roll and pitch."""
        tilt = self.tilt_rates, self.tilt_rate_covariance
        return twist3d_of(self.twist, self.twist_covariance, *tilt)


class PredictedPose(NamedTuple):
    """Predicted pose of base_link in odom.

    Attributes:
        stamp: time [ns].
        pose: (3,) x, y [m], yaw [rad].
        covariance: (3, 3) its covariance, that of the motion until then included.
    """

    stamp: int
    pose: Floats
    covariance: Floats


@dataclass(frozen=True)
class Run:
    """Run of one variant over a log, sampled after each pair of track speeds.

    Attributes:
        variant: name of the filter variant, with "-smoothed" appended if the run is smoothed.
        trajectory: poses and twists with covariances.
        indices: (n, 3) zeta [m], epsilon [m], eta [-] of the motion at that time.
        state_names: (SIZE,) names of the states, see `icreckon.estimator.base.state`.
        states: (n, SIZE) states of the filter.
        state_sigmas: (n, SIZE) standard deviations of the states.
        health: counts of the measurements.
        innovation_names: (k,) components of the sensors with innovations.
        innovations: (n, k) newest innovation of each component since the row before, over its predicted
            standard deviation [-]; NaN if there was none. A smoothed run has no innovations.
        faults: (n, k) True for each fault that the filter finds at a row; columns as `FAULT_COLUMNS`. A
            smoothed run has no faults.
    """

    variant: str
    trajectory: Trajectory
    indices: Floats
    state_names: tuple[str, ...]
    states: Floats
    state_sigmas: Floats
    health: Health
    innovation_names: tuple[str, ...] = ()
    innovations: Singles = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    faults: Flags = field(default_factory=lambda: np.zeros((0, len(FAULT_COLUMNS)), bool))

    def __repr__(self) -> str:
        """One line: variant, duration, numbers of poses and of rejected measurements."""
        # The trajectory's line, "<Trajectory ...>", without its closing bracket.
        text = repr(self.trajectory)[:-1].replace("Trajectory", f"Run {self.variant!r}")
        return f"{text}, {sum(self.health.rejections().values())} measurements rejected>"

    @property
    def stamps(self) -> Stamps:
        """Stamps (n,) of the rows [ns]."""
        return self.trajectory.stamps

    def fault_spans(self) -> dict[tuple[str, str], Stamps]:
        """Spans (m, 2) of each fault and its part that was found [ns].

        A span begins with the first row that has the fault, and ends with the first that has not.
        Faults that begin and end between two rows are counted in `health.times` alone.
        """
        spans = {}
        ends = np.append(self.stamps[1:], self.stamps[-1:])
        for name, column in zip(FAULT_COLUMNS, self.faults.T, strict=True):
            if column.any():
                first, last = true_runs(column).T
                spans[name] = np.column_stack([self.stamps[first], ends[last]])
        return spans
