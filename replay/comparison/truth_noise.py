"""Drift that a perfect path has against a truth of positions, by the noise of the truth."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.path_heading import headings_by_path
from icreckon.estimator.log.scores import HORIZONS, drift, interpolate_poses, shared_stamps
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import FixWander
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.fixes import OF_FIXES, scored_intervals

ROUNDS = 4
"""Draws of the noise, of which the mean is taken."""


def noise_drifts(comparison: Comparison, robot: Robot) -> dict[str, float]:
    """Drift by the noise of the truth alone, by horizon as "30s" [% of the distance].

    The last run's path with simulated noise, as white as that of the truth and with the wander of the
    robot file's fixes, takes the place of the truth. Empty for a truth with headings, or without any.

    Args:
        comparison: the runs.
        robot: the robot.
    """
    alignment, log = comparison.alignment, comparison.log
    if log.truth is None or alignment is None or alignment.headings is None:
        return {}
    path = [*comparison.runs.values()][-1].trajectory.pose_series
    stamps = shared_stamps(path, log.truth.poses)
    wander = FixWander.of(robot)
    slow = wander.sigma if log.truth.source == OF_FIXES else 0.0
    step = float(np.median(np.diff(stamps))) * NANOSECOND
    kept = float(np.exp(-step / wander.time)) if slow else 0.0
    poses, generator = interpolate_poses(path, stamps), np.random.default_rng(0)
    found: dict[str, list[float]] = {f"{horizon:g}s": [] for horizon in HORIZONS}
    for _ in range(ROUNDS):
        white, pushes = generator.standard_normal((2, len(stamps), 2))
        pushes[1:] *= np.sqrt(1.0 - kept**2)
        noise = alignment.headings.noise * white + slow * lfilter(
            [1.0], [1.0, -kept], pushes, axis=0
        )
        places = poses.copy()
        places[:, :2] += noise
        truth = headings_by_path(PoseSeries(stamps, places), path)
        if truth is None:
            return {}
        for horizon in HORIZONS:
            of = drift(path, truth.poses, horizon, within=scored_intervals(log))
            found[f"{horizon:g}s"].append(of.percent_mean)
    return {label: float(np.mean(values)) for label, values in found.items()}
