"""Scores of trajectories whose errors are known."""

import numpy as np
import pytest

from icreckon import (
    EstimatorError,
    PoseSeries,
    Trajectory,
    Truth,
    TwistSeries,
    drift,
    pose_nees,
    velocity_errors,
)
from icreckon.estimator.base.frames import compose
from icreckon.estimator.log.scores import path_length, without_fixes

EPOCH = 1_700_000_000_000_000_000


def at(seconds):
    return EPOCH + np.rint(np.asarray(seconds) * 1e9).astype(np.int64)


def circle(seconds, speed=0.5, rate=0.1):
    """Poses on a circle, driven at a constant twist from the origin."""
    yaw = rate * seconds
    return np.stack([speed / rate * np.sin(yaw), speed / rate * (1.0 - np.cos(yaw)), yaw], axis=-1)


def straight(seconds):
    zero = np.zeros_like(seconds)
    return np.stack([0.5 * seconds, zero, zero], axis=-1)


def series(seconds, poses):
    return PoseSeries(at(seconds), poses)


def trajectory(seconds, poses, covariances=None, twists=None):
    n = len(seconds)
    zeros = np.zeros((n, 3, 3))
    return Trajectory(
        at(seconds),
        poses,
        zeros if covariances is None else covariances,
        np.zeros((n, 3)) if twists is None else twists,
        zeros,
    )


SECONDS = np.arange(0.0, 120.0, 0.05)
LINE, CIRCLE = (series(SECONDS, path(SECONDS)) for path in (straight, circle))


def test_one_percent_of_scale_is_one_percent_of_drift():
    score = drift(series(SECONDS, 1.01 * straight(SECONDS)), LINE, 30.0)
    assert score.percent_mean == pytest.approx(1.0, rel=1e-9)
    assert score.percent_median == pytest.approx(1.0, rel=1e-9)
    assert score.yaw_deg_per_m == 0.0


def test_constant_yaw_rate_error_is_yaw_drift_and_a_bend_to_the_left():
    rate = 0.002
    score = drift(series(SECONDS, circle(SECONDS, rate=rate)), LINE, 10.0)
    assert score.yaw_errors == pytest.approx(10.0 * rate)
    assert score.yaw_deg_per_m == pytest.approx(np.degrees(rate) / 0.5)
    # Half the yaw error over the whole way: 5 m * 0.01 rad.
    assert score.percent_mean == pytest.approx(1.0, rel=1e-4)


def test_estimate_in_another_frame_scores_the_same():
    poses = circle(SECONDS, speed=0.51, rate=0.102)
    moved = compose([13.0, -7.0, 2.0], poses)
    a, b = drift(series(SECONDS, poses), CIRCLE, 30.0), drift(series(SECONDS, moved), CIRCLE, 30.0)
    assert a.position_errors == pytest.approx(b.position_errors, abs=1e-9)
    assert a.yaw_errors == pytest.approx(b.yaw_errors, abs=1e-9)


def test_estimate_is_compared_at_the_stamps_of_the_truth():
    # The estimate is sampled elsewhere; a straight line loses nothing by interpolation.
    elsewhere = np.arange(-1.0, 130.0, 0.033)
    score = drift(series(elsewhere, straight(elsewhere)), LINE, 10.0)
    assert score.position_errors == pytest.approx(0.0, abs=1e-6)


def test_segments_across_a_hole_in_the_truth_are_left_out_and_none_counts_twice():
    seconds = SECONDS[(SECONDS < 40.0) | (SECONDS >= 70.0)]
    truth = series(seconds, straight(seconds))
    score = drift(LINE, truth, 10.0)
    starts = (score.starts - EPOCH) * 1e-9
    assert len(np.unique(starts)) == len(starts)
    assert not ((starts > 29.96) & (starts < 70.0)).any()
    # 0 to 29 s before the hole; 70 to 109 s after it.
    assert len(starts) == 30 + 40
    bridged = drift(LINE, truth, 10.0, largest_gap=60.0)
    assert len(bridged.starts) > len(score.starts)


def test_segments_lie_wholly_within_the_intervals_asked_for():
    within = [(int(at(20.0)), int(at(45.0))), (int(at(100.0)), int(at(105.0)))]
    score = drift(LINE, LINE, 10.0, within=within)
    starts = (score.starts - EPOCH) * 1e-9
    assert starts == pytest.approx(np.arange(20.0, 36.0))


def test_standing_segments_do_not_count_in_ratios():
    # A minute of driving, then rest with an error that grows all the same.
    true = straight(np.minimum(SECONDS, 60.0))
    estimated = true.copy()
    estimated[:, 1] = 0.01 * np.maximum(SECONDS - 60.0, 0.0)
    score = drift(series(SECONDS, estimated), series(SECONDS, true), 10.0)
    assert not score.moved[-1]
    assert score.position_errors[-1] == pytest.approx(0.1)
    all_rest = drift(series(SECONDS, estimated), series(SECONDS, np.zeros((len(SECONDS), 3))), 10.0)
    assert np.isnan(all_rest.percent_mean)
    assert np.isnan(all_rest.percent_median)
    assert np.isnan(all_rest.yaw_deg_per_m)


@pytest.mark.parametrize("last", [0.0, 5.0])
def test_truth_shorter_than_the_horizon_gives_no_segment(last):
    seconds = SECONDS[: round(last / 0.05) + 1]
    short = series(seconds, straight(seconds))
    score = drift(LINE, short, 10.0)
    assert len(score.starts) == 0
    assert np.isnan(score.percent_mean)


def test_path_length_of_a_line_and_a_circle():
    assert path_length(LINE) == pytest.approx(0.5 * SECONDS)
    # Chords of 0.05 rad are shorter than their arcs by 1e-4 of their length.
    assert path_length(CIRCLE)[-1] == pytest.approx(0.5 * SECONDS[-1], rel=2e-4)


def test_velocity_errors_by_the_twists_of_the_truth():
    twists = np.tile([0.5, 0.0, 0.1], (len(SECONDS), 1))
    truth = Truth(CIRCLE, TwistSeries(at(SECONDS), twists))
    estimate = trajectory(
        SECONDS + 0.013, circle(SECONDS), twists=twists + np.array([0.01, -0.02, 0.003])
    )
    errors = velocity_errors(estimate, truth)
    # The truth's first sample is before the estimate's first.
    assert len(errors) == len(SECONDS) - 1
    assert errors == pytest.approx(np.tile([0.01, -0.02, 0.003], (len(errors), 1)), abs=1e-9)


def test_velocity_errors_by_the_poses_of_the_truth():
    truth = Truth(CIRCLE)
    n = len(SECONDS)
    slipping = trajectory(SECONDS, straight(SECONDS), twists=np.tile([0.51, 0.02, 0.0], (n, 1)))
    errors = velocity_errors(slipping, Truth(LINE))
    assert errors == pytest.approx(np.tile([0.01, 0.02, 0.0], (len(errors), 1)), abs=1e-9)
    turning = trajectory(SECONDS, circle(SECONDS), twists=np.tile([0.5, 0.0, 0.103], (n, 1)))
    errors = velocity_errors(turning, truth)
    assert errors[:, 2] == pytest.approx(0.003, abs=1e-9)


def test_windows_in_which_the_truth_is_silent_say_nothing():
    seconds = SECONDS[(SECONDS < 40.0) | (SECONDS >= 70.0)]
    truth = Truth(series(seconds, straight(seconds)))
    # Wrong in the hole only; 39 s to 40 s and 70 s to 71 s are seen.
    twists = np.tile([0.5, 0.0, 0.0], (len(SECONDS), 1))
    twists[(SECONDS > 45.0) & (SECONDS < 65.0), 1] = 0.5
    errors = velocity_errors(trajectory(SECONDS, straight(SECONDS), twists=twists), truth)
    assert errors == pytest.approx(0.0, abs=1e-9)
    assert 150 < len(errors) < 180


def test_nees_of_errors_drawn_from_the_covariance_is_chi_square():
    rng = np.random.default_rng(0)
    n = 4000
    seconds = np.arange(n) * 0.05
    root = rng.normal(size=(n, 3, 3)) * 0.01 + 0.02 * np.eye(3)
    covariances = root @ root.transpose(0, 2, 1)
    errors = np.einsum("nij,nj->ni", root, rng.normal(size=(n, 3)))
    truth = circle(seconds)
    nees = pose_nees(trajectory(seconds, truth + errors, covariances), series(seconds, truth))
    assert len(nees) == n
    # Mean of 4000 chi-square variables of 3 degrees: 3 with a standard deviation of 0.039.
    assert nees.mean() == pytest.approx(3.0, abs=3.5 * np.sqrt(6.0 / n))
    # 5 % are above 7.815.
    assert np.mean(nees > 7.815) == pytest.approx(0.05, abs=3.5 * np.sqrt(0.05 * 0.95 / n))


def test_nees_counts_yaw_the_short_way_round_and_leaves_out_certainty():
    covariances = np.tile(np.diag([1.0, 1.0, 0.01]), (3, 1, 1))
    covariances[0] = 0.0
    poses = np.array([[0.0, 0.0, 3.1]] * 3)
    true = np.array([[0.0, 0.0, 3.1 - 2 * np.pi + 0.1]] * 3)
    nees = pose_nees(trajectory([0.0, 1.0, 2.0], poses, covariances), series([0.0, 1.0, 2.0], true))
    assert nees == pytest.approx([1.0, 1.0])


def test_times_without_fixes():
    fixes = at([5.0, 6.0, 7.0, 40.0])
    found = without_fixes(fixes, int(at(0.0)), int(at(60.0)), 10.0)
    assert found == [(int(at(7.0)), int(at(40.0))), (int(at(40.0)), int(at(60.0)))]
    assert without_fixes(at([]), int(at(0.0)), int(at(60.0)), 10.0) == [(at(0.0), at(60.0))]
    assert without_fixes(at([]), int(at(0.0)), int(at(5.0)), 10.0) == []


def test_a_horizon_is_positive() -> None:
    path = PoseSeries(np.arange(3, dtype=np.int64) * 10**9, np.zeros((3, 3)))
    with pytest.raises(EstimatorError, match="horizon must be a positive number of s"):
        drift(path, path, -3.0)
