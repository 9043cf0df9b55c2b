"""Refused fixes that tell of another heading, not only of another place."""

import math

import numpy as np
import pytest

from agreement_scenes import with_poses
from fed_estimators import feed_all
from icreckon import Log, PoseEstimator, Scenario, load_robot, simulate
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.filter.reacquisition import RejectedRecord, add_rejected, aligned_path

ALPHA = load_robot("auriga-alpha")
PATH = np.stack([np.linspace(0.0, 4.0, 11), 0.3 * np.linspace(0.0, 2.0, 11) ** 2], axis=-1)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def refused(measured: np.ndarray, path: np.ndarray = PATH) -> RejectedRecord:
    """Record of fixes of 5 cm that were rejected."""
    rejected = RejectedRecord()
    for (x, y), (to_x, to_y) in zip(measured.tolist(), path.tolist(), strict=False):
        add_rejected(rejected, (x, y, 0.05**2), (to_x, to_y, 0.0), 0.0)
    return rejected


def test_what_is_no_turned_path_is_left_alone() -> None:
    rng = np.random.default_rng(2)
    assert not aligned_path(refused(10.0 * rng.normal(size=PATH.shape))).fits
    # A shift needs no turn, a robot that stands shows none, and a mirrored path is no turned one.
    assert not aligned_path(refused(PATH + np.array([5.0, 5.0]))).fits
    assert not aligned_path(refused(turned(PATH, 1.0)[:4])).fits
    assert not aligned_path(refused(5.0 + 0.0 * PATH, 0.0 * PATH)).fits


def fixes_turned(log: Log, angle: float, since: float) -> Log:
    late = log.fixes.stamps >= log.start + round(since * 1e9)

    def change(poses: np.ndarray, _: np.ndarray) -> None:
        poses[late, :2] = turned(poses[late, :2], angle)
        poses[late, 2] += angle

    return with_poses(log, change)


@pytest.mark.parametrize("angle", [0.6, -1.5, 2.5, math.pi])
def test_a_heading_that_is_wrong_is_found_from_positions(angle: float) -> None:
    log = simulate(Scenario(duration=90.0, seed=2, truth_rate=5.0), ALPHA)
    truth = log.truth
    estimator = PoseEstimator(ALPHA, "constant-online")  # type: ignore[arg-type]
    feed_all(estimator, fixes_turned(log, angle, 30.0))
    end = truth.poses.poses[-1]
    wanted = np.array([*turned(end[None, :2], angle)[0], end[2] + angle])
    error = estimator.pose - wanted
    error[2] = wrap_angle(error[2])
    assert abs(error[2]) < 0.15
    assert np.hypot(*error[:2]) < 0.3
    assert error @ np.linalg.solve(estimator.pose_covariance, error) < 20.0
