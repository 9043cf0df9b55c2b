"""The motion between two stamps, and how sure of it the filter is."""

import math

import numpy as np
import pytest

from fed_estimators import feed_all, seconds, short_log
from icreckon import (
    EstimatorError,
    FixSpec,
    PoseEstimator,
    Scenario,
    Settings,
    Slip,
    changed_robot,
    load_robot,
    simulate,
)
from icreckon.estimator.base.frames import compose, relative, rpy_to_matrix
from icreckon.estimator.filter.clones import MOST_MARKS, RelativeMotion
from icreckon.estimator.log.measurements import HeadingFix, ImuSample, PositionFix, TrackSpeeds
from same_runs import assert_same_estimate

ALPHA = load_robot("auriga-alpha")
GAUGE = ALPHA.vehicle.track_gauge
EPOCH = 1_700_000_000_000_000_000
DT = 0.02
NO_SLIP = Slip(
    **{f"{motion}_{axis}": 0.0 for motion in ("turning", "driving") for axis in "xyw"},
    white_time=0.0,
)
# White noise of each track's speed [m/s/√Hz], and nothing else that is not known.
NOISE = 0.01
NOISY = changed_robot(ALPHA, {"tracks.speed_noise_density": NOISE, "tracks.difference_sigma": 0.0})


def drive(left, right, steps, begin=0, estimator=None, **options):
    """An ideal differential drive with nothing but noisy tracks at constant speeds."""
    if estimator is None:
        estimator = PoseEstimator(NOISY, "differential", settings=Settings(slip=NO_SLIP), **options)
    for k in range(begin, begin + steps + 1):
        estimator.feed(TrackSpeeds(EPOCH + seconds(k * DT), left, right))
    return estimator


def test_straight_with_noisy_tracks_is_as_uncertain_as_integrated_white_noise():
    v, steps, before = 0.5, 500, 300
    estimator = drive(v, v, before, start=(3.0, -2.0, 1.0), start_sigma=(2.0, 3.0, 0.5))
    mark = estimator.mark()
    drive(v, v, steps, begin=before, estimator=estimator)
    motion = estimator.relative_motion(mark)
    T = steps * DT
    assert motion.from_stamp == EPOCH + seconds(before * DT)
    assert motion.to_stamp == estimator.stamp == motion.from_stamp + seconds(T)
    assert motion.pose == pytest.approx([v * T, 0.0, 0.0], abs=1e-9)
    # Forward the mean of the tracks, turning their difference over the gauge; sideways, what is
    # driven after it has turned.
    q_x, q_w = NOISE**2 / 2.0, 2.0 * NOISE**2 / GAUGE**2
    expected = np.diag([q_x * T, v**2 * q_w * (T**3 / 3.0 - T * DT**2 / 12.0), q_w * T])
    expected[1, 2] = expected[2, 1] = v * q_w * T**2 / 2.0
    assert motion.covariance == pytest.approx(expected, rel=1e-9, abs=1e-15)
    # The pose itself is known worse by far, and the difference of its covariances says nothing.
    assert estimator.pose_covariance[0, 0] > 4.0


def test_a_motion_at_rest_is_regular():
    """A robot that stands between two marks: its information can be had, and is not infinite."""
    estimator = PoseEstimator(ALPHA)
    log = simulate(Scenario(duration=24.0, seed=3, trajectory="stop-and-go", fix_rate=0.0), ALPHA)
    marks = [log.start + seconds(one) for one in (10.2, 11.2, 11.8)]
    for m in log.measurements():
        estimator.feed(m)
        if marks and m.stamp > marks[0]:
            estimator.mark(marks.pop(0))
    for first in estimator.marks:
        for other in estimator.marks:
            covariance = estimator.relative_motion(first, other).end_covariance
            assert np.linalg.inv(covariance).max() < 2e8
            assert np.linalg.eigvalsh(covariance)[0] > 0.0


def test_a_fix_that_turns_the_whole_path_does_not_bend_the_motion():
    v, yaw = 0.5, 0.6
    estimator = drive(v, v, 500, start_sigma=(0.0, 0.0, 1.0))
    mark = estimator.mark()
    drive(v, v, 500, begin=500, estimator=estimator)
    before = estimator.relative_motion(mark)
    end = 20.0 * v
    stamp = estimator.stamp
    estimator.feed(PositionFix(stamp, end * math.cos(yaw), end * math.sin(yaw), 1e-4))
    estimator.feed(HeadingFix(stamp, yaw, 1e-4))
    assert estimator.pose[2] == pytest.approx(yaw, abs=0.02)
    after = estimator.relative_motion(mark)
    # Of the fixes, hardly anything is about what came after the mark: less than its own sigma.
    moved = after.pose - before.pose
    assert (np.abs(moved) < np.sqrt(before.covariance.diagonal())).all()
    assert after.covariance[0, 0] <= before.covariance[0, 0]
    assert np.hypot(*after.pose[:2]) == pytest.approx(5.0, abs=0.03)


def test_since_a_start_that_is_known_exactly_it_is_the_pose():
    start = (1.0, -2.0, 0.7)
    estimator = PoseEstimator(ALPHA, start=start)
    for k, m in enumerate(MEASUREMENTS):
        if isinstance(m, PositionFix):
            x, y, _ = compose(start, (m.x, m.y, 0.0))
            m = PositionFix(m.stamp, x, y, m.variance)
        estimator.feed(m)
        if k == 0:
            mark = estimator.mark()
    motion = estimator.relative_motion(mark)
    assert motion.pose == pytest.approx(relative(start, estimator.pose), abs=1e-9)
    turn = rpy_to_matrix(0.0, 0.0, start[2])
    expected = turn.T @ estimator.pose_covariance @ turn
    assert estimator.health.sensors["position"].used > 15
    assert motion.covariance == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_covariance_at_the_end_is_that_of_the_error_seen_from_there():
    covariance = np.array([[4.0, 1.0, 0.2], [1.0, 2.0, 0.1], [0.2, 0.1, 0.5]]) * 1e-8
    motion = RelativeMotion(0, 1, np.array([1.0, 2.0, 0.7]), covariance)
    errors = np.random.default_rng(1).multivariate_normal(
        np.zeros(3), motion.end_covariance, 100_000
    )
    ends = compose(motion.pose, errors)
    assert np.cov((ends - motion.pose).T) == pytest.approx(covariance, abs=1e-9)


MEASUREMENTS = list(
    short_log(duration=5.0, trajectory="slalom", fix_rate=4.0, fixes=FixSpec()).measurements()
)
IMU_STAMPS = [m.stamp for m in MEASUREMENTS if isinstance(m, ImuSample)]
FIRST, SECOND = IMU_STAMPS[205], IMU_STAMPS[230]


def numbers(estimator, *stamps):
    motion = estimator.relative_motion(*stamps)
    return motion.pose.tolist(), motion.covariance.tolist()


def fed_in_order():
    estimator = PoseEstimator(ALPHA, start_sigma=(0.1, 0.1, 0.1))
    due = [FIRST, SECOND]
    for m in MEASUREMENTS:
        # Behind all of its stamp.
        if due and m.stamp > due[0]:
            estimator.mark(due.pop(0))
        estimator.feed(m)
    return estimator


def test_marks_do_not_change_the_estimate():
    """To rounding: with a mark, each part of a step is taken by itself."""
    plain = feed_all(PoseEstimator(ALPHA, start_sigma=(0.1, 0.1, 0.1)), MEASUREMENTS)
    marked = fed_in_order()
    assert marked.marks == (FIRST, SECOND)
    assert_same_estimate(marked, plain)


def test_what_comes_late_counts_as_if_it_had_come_in_time():
    in_order = fed_in_order()
    late = [m for m in MEASUREMENTS[60:] if isinstance(m, PositionFix)]
    estimator = PoseEstimator(ALPHA, start_sigma=(0.1, 0.1, 0.1))
    for m in MEASUREMENTS:
        if m not in late:
            estimator.feed(m)
        if m.stamp in (FIRST, SECOND) and isinstance(m, ImuSample):
            estimator.mark()
        while late and m.stamp > late[0].stamp + seconds(0.5):
            assert estimator.feed(late.pop(0))
    for m in late:
        estimator.feed(m)
    assert (estimator.state == in_order.state).all()
    assert numbers(estimator, FIRST) == numbers(in_order, FIRST)
    assert numbers(estimator, FIRST, SECOND) == numbers(in_order, FIRST, SECOND)


def test_a_late_mark_is_set_at_its_own_stamp():
    in_order, estimator = fed_in_order(), PoseEstimator(ALPHA, start_sigma=(0.1, 0.1, 0.1))
    for m in MEASUREMENTS:
        estimator.feed(m)
        if m.stamp in (FIRST, SECOND):
            before = estimator.state
        if m.stamp > SECOND and not estimator.marks:
            for stamp in (SECOND, FIRST):
                assert estimator.mark(stamp) == stamp
    assert before is not None
    assert numbers(estimator, SECOND) == numbers(in_order, SECOND)
    # Set in another order, the marks are the same but for rounding.
    found, expected = estimator.relative_motion(FIRST), in_order.relative_motion(FIRST)
    assert found.pose == pytest.approx(expected.pose, abs=1e-12)
    assert found.covariance == pytest.approx(expected.covariance, rel=1e-9, abs=1e-15)


def test_between_two_marks_nothing_changes_any_more_without_fixes():
    blind = [m for m in MEASUREMENTS if not isinstance(m, PositionFix)]
    estimator = PoseEstimator(ALPHA)
    for m in blind:
        estimator.feed(m)
        if m.stamp in (FIRST, SECOND) and isinstance(m, ImuSample):
            if m.stamp == SECOND:
                then = estimator.relative_motion(FIRST)
            estimator.mark()
    now = estimator.relative_motion(FIRST, SECOND)
    assert now.pose == pytest.approx(then.pose, abs=1e-12)
    assert now.covariance == pytest.approx(then.covariance, rel=1e-9)
    back = estimator.relative_motion(SECOND, FIRST)
    assert compose(now.pose, back.pose) == pytest.approx(np.zeros(3), abs=1e-12)


def test_forgotten_marks_are_gone_and_stay_gone():
    estimator, other = fed_in_order(), fed_in_order()
    estimator.forget(FIRST)
    assert estimator.marks == (SECOND,)
    # What comes late takes the filter back to before the mark.
    for stamp in (SECOND - 1, FIRST - 1):
        for one in (estimator, other):
            assert one.feed(PositionFix(stamp, 0.0, 0.0, 1.0))
        assert estimator.marks == (SECOND,)
    found, expected = estimator.relative_motion(SECOND), other.relative_motion(SECOND)
    assert found.pose == pytest.approx(expected.pose, abs=1e-12)
    assert found.covariance == pytest.approx(expected.covariance, rel=1e-9, abs=1e-15)
    for use in (estimator.forget, estimator.relative_motion):
        with pytest.raises(EstimatorError, match=f"no mark at {FIRST}; there are marks at"):
            use(FIRST)


def test_a_fix_at_a_forgotten_mark_is_kept_when_later_ones_are_late():
    """The history has a checkpoint right behind the mark."""
    unsure = (1.0, 1.0, 0.1)
    with_mark, without = (
        PoseEstimator(ALPHA, "inertia-online", start_sigma=unsure) for _ in range(2)
    )
    stamp = EPOCH
    for estimator in (with_mark, without):
        # 15 measurements; the mark is the 16th.
        for k in range(15):
            stamp = EPOCH + seconds(0.01 * (k // 2))
            if k % 2 == 0:
                estimator.feed(TrackSpeeds(stamp, 0.4, 0.5))
            else:
                estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.1), (0.0, 0.0, 9.81)))
        if estimator is with_mark:
            estimator.forget(estimator.mark(stamp))
        assert estimator.feed(PositionFix(stamp, 0.5, 1.0, 1e-2))
        for later in (0.01, 0.03, 0.02):
            sample = ImuSample(stamp + seconds(later), (0.0, 0.0, 0.1), (0.0, 0.0, 9.81))
            assert estimator.feed(sample)
    assert with_mark.health.sensor("position").used == 1
    np.testing.assert_allclose(with_mark.state, without.state, rtol=0.0, atol=1e-12)


def test_a_mark_that_cannot_be_set_says_why():
    estimator = PoseEstimator(ALPHA)
    with pytest.raises(EstimatorError, match="before the first measurement"):
        estimator.mark()
    feed_all(estimator, MEASUREMENTS[:20])
    now = estimator.stamp
    with pytest.raises(EstimatorError, match="before the first measurement"):
        estimator.mark(MEASUREMENTS[0].stamp - 1)
    with pytest.raises(EstimatorError, match=r"0\.500 s ahead of the estimate"):
        estimator.mark(now + seconds(0.5))
    feed_all(estimator, MEASUREMENTS[20:])
    with pytest.raises(EstimatorError, match=r"older than Settings\.history"):
        estimator.mark(now)
    for k in range(MOST_MARKS):
        estimator.mark(estimator.stamp - k)
    assert estimator.mark(estimator.stamp) == estimator.stamp, "there is one already"
    with pytest.raises(EstimatorError, match="forget those"):
        estimator.mark(estimator.stamp + 1)
