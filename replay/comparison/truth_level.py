"""Levelling of a truth: its vertical by the gravity that a filter estimates.

The map of a lidar is level in the axes in which it began, on a slope or with a tilted sensor by degrees,
and the lidar may be mounted with a tilt in the robot. The two are told apart as the robot turns.
"""

from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.log.scores import drift, interpolate, shared_stamps
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.log.trajectory import Trajectory

HORIZON = 30.0  # length of the segments over which the drift of the height is scored [s]
ROUNDS = 10  # rounds in which the tilts of map and truth's axes are estimated in turn


def levelled(truth: PoseSeries, reckoned: Trajectory) -> tuple[PoseSeries, float]:
    """Turn height, roll and pitch of a truth to the mean vertical of a run.

    Tilts of the map and of the truth's axes in the robot are corrected; position and yaw do not change.
    Returned are the poses, unchanged if either is planar, and the tilt of the map's vertical [rad].
    """
    stamps = shared_stamps(reckoned, truth)
    if truth.spatial is None or reckoned.spatial is None or not len(stamps):
        return truth, 0.0
    from scipy.spatial.transform import Rotation

    is_shared = np.isin(truth.stamps, stamps)
    roll, pitch = interpolate(reckoned.stamps, reckoned.spatial, stamps)[:, 1:].T
    turns = Rotation.from_quat(truth.quaternions)
    attitudes = Rotation.from_euler("xyz", np.column_stack([roll, pitch, np.zeros(len(stamps))]))
    # Vertical (n, 3) in the robot by the run; tilt of the truth's axes in the robot.
    verticals, mount = attitudes.inv().apply([0.0, 0.0, 1.0]), Rotation.identity()
    for _ in range(ROUNDS):
        # Vertical in the map, then its direction in the truth's axes less that in the robot.
        up = np.median((turns[is_shared] * mount).apply(verticals), axis=0)
        in_truth = turns[is_shared].inv().apply(up / np.linalg.norm(up))
        x, y, _ = np.median(in_truth - verticals, axis=0)
        mount = Rotation.from_rotvec([-y, x, 0.0])
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, up[2]))
    level = Rotation.from_rotvec(axis * (angle / sine if sine else 0.0))
    heights = level.apply(truth.positions)[:, 2]
    tilts = (level * turns * mount).as_euler("xyz")[:, :2]
    spatial = np.column_stack([heights - heights[0], tilts])
    return replace(truth, spatial=spatial), angle


def spatial_scores(
    estimate: Trajectory, truth: PoseSeries, scored: list[tuple[int, int]]
) -> dict[str, float]:
    """Scores of height, roll and pitch, of a levelled truth; empty if planar.

    `scored` are the intervals of stamps [ns] in which drift is scored.
    """
    stamps = shared_stamps(estimate, truth)
    series, sigmas = estimate.pose_series, estimate.spatial_sigmas
    own, true = series.spatial, truth.spatial
    if own is None or true is None or sigmas is None or len(stamps) < 2:
        return {}

    def errors(at: Stamps) -> Floats:
        """Height [m], roll and pitch [rad] (n, 3), less those of the truth."""
        return interpolate(series.stamps, own, at) - interpolate(truth.stamps, true, at)

    offsets = errors(stamps)
    segments = drift(series, truth, HORIZON, within=scored)
    ends = segments.starts + np.round(segments.durations * 1e9).astype(np.int64)
    climbs = errors(ends) - errors(segments.starts)
    distance = segments.distances.sum()
    final_sigma = interpolate(estimate.stamps, sigmas, stamps[-1:])[0, 0]
    roll, pitch = np.degrees(np.sqrt(np.mean(offsets[:, 1:] ** 2, axis=0))).tolist()
    drift_percent = 100.0 * np.abs(climbs[:, 0]).sum() / distance if distance else np.nan
    return {
        "rms_roll_deg": roll,
        "rms_pitch_deg": pitch,
        "height_drift_percent_30s_mean": float(drift_percent),
        "final_height_error_m": float(offsets[-1, 0] - offsets[0, 0]),
        "final_height_sigma_m": float(final_sigma),
    }
