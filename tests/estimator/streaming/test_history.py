"""Late measurements: the estimate is that of all measurements in order, whatever order they came in."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fed_estimators import feed_all, known, seconds, short_log
from icreckon import PoseEstimator, SensorHealth, Settings, load_robot
from icreckon.estimator.log.input_checks import key_of
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)
from icreckon.estimator.streaming import late_measurements as history

ALPHA = load_robot("auriga-alpha")
EPOCH = 1_700_000_000_123_456_789
STEP = 10_000_000
COVARIANCE = ((0.04, 0.01, 0.0), (0.01, 0.05, 0.02), (0.0, 0.02, 0.3))


def some_measurements():
    """Five seconds of all kinds in order, many of equal stamps, some of them wrong."""
    log = short_log(duration=5.0, seed=11, truth="kinematic", fix_rate=5.0)
    found = []
    for k, m in enumerate(log.measurements()):
        if isinstance(m, PositionFix) and k % 7 == 0:
            m = PositionFix(m.stamp, m.x + 30.0, m.y, m.variance)
        if isinstance(m, ImuSample) and k % 31 == 0:
            m = ImuSample(m.stamp, (0.0, 0.0, 5.0), m.linear_acceleration)
        found.append(m)
        if isinstance(m, HeadingFix):
            found.append(BodyVelocity(m.stamp, 0.3, 0.0, 0.04))
            found.append(ZeroVelocity(m.stamp, (0.3, 0.1, 0.5)))
            x, y = found[-4].x, found[-4].y
            found.append(PoseFix(m.stamp, x, y, m.yaw, COVARIANCE))
    return sorted(found, key=key_of)


MEASUREMENTS = some_measurements()


def fed(measurements, **options):
    return feed_all(PoseEstimator(ALPHA, start_sigma=(0.1, 0.1, 0.05), **options), measurements)


def known_in_any_order(estimator):
    """All that an estimator says, but for how late what came."""
    health = estimator.health
    for sensor in health.sensors.values():
        sensor.late = 0
    health.sensors = {name: one for name, one in health.sensors.items() if one != SensorHealth()}
    return known(estimator), health


def as_they_arrive(measurements, delays):
    """The measurements in the order of stamp plus delay [ns]."""
    arrivals = [(m.stamp + delay, i) for i, (m, delay) in enumerate(zip(measurements, delays))]  # noqa: B905
    return [measurements[i] for _, i in sorted(arrivals)]


@cache
def in_order():
    found = known_in_any_order(fed(MEASUREMENTS))
    # Some are gated, and some coincide.
    rejections = found[1].rejections()
    assert min(rejections["gyro: jumped"], rejections["position: gate"]) > 2
    assert len({m.stamp for m in MEASUREMENTS}) < len(MEASUREMENTS) - 50
    return found


@settings(max_examples=8)
@given(
    seed=st.integers(0, 2**32 - 1),
    longest=st.sampled_from([0.05, 0.3, 1.0]),
    share=st.sampled_from([0.02, 0.2]),
)
def test_the_order_of_arrival_does_not_matter(seed, longest, share):
    rng = np.random.default_rng(seed)
    delays = rng.integers(0, seconds(longest) + 1, len(MEASUREMENTS))
    delays[rng.random(len(MEASUREMENTS)) > share] = 0
    estimator = fed(as_they_arrive(MEASUREMENTS, delays.tolist()))
    assert known_in_any_order(estimator) == in_order()


@settings(max_examples=8)
@given(st.permutations(MEASUREMENTS[:12]), st.permutations(MEASUREMENTS[60:75]))
def test_the_order_of_arrival_does_not_matter_at_the_start_and_on_the_way(first, later):
    mixed = [*first, *MEASUREMENTS[12:60], *later, *MEASUREMENTS[75:]]
    assert known_in_any_order(fed(mixed)) == in_order()


def test_a_late_measurement_tells_whether_it_was_used():
    estimator = fed(MEASUREMENTS[:200])
    x, y, _ = estimator.pose
    stamp = estimator.stamp - seconds(0.3)
    assert estimator.feed(PositionFix(stamp + 1, x + 40.0, y, 1e-4)) is False
    assert estimator.feed(HeadingFix(stamp + 2, estimator.pose[2], 1.0)) is True
    health = estimator.health
    assert health.sensors["position"].late == health.sensors["heading"].late == 1


@pytest.mark.parametrize("span", [0.0, 0.1, 1.0])
def test_what_is_older_than_the_history_is_refused_and_what_is_as_old_is_not(span):
    estimator = fed(MEASUREMENTS[:300], settings=Settings(history=span))
    newest = MEASUREMENTS[299].stamp
    before = known(estimator)
    assert estimator.feed(BodyVelocity(newest - seconds(span) - 1, 0.3, 0.0, 1.0)) is False
    assert estimator.health.rejections()["body velocity: older than Settings.history"] == 1
    assert known(estimator) == before
    rest = [m for m in MEASUREMENTS[:300] if not isinstance(m, BodyVelocity)]
    estimator = fed(rest, settings=Settings(history=span))
    assert estimator.feed(BodyVelocity(newest - seconds(span), 0.3, 0.0, 1.0)) is True


def test_without_a_history_equal_stamps_still_have_their_order():
    backward = sorted(MEASUREMENTS, key=lambda m: (m.stamp, -key_of(m)[1]))
    assert backward != MEASUREMENTS
    assert known_in_any_order(fed(backward, settings=Settings(history=0.0))) == in_order()


def test_an_array_that_the_driver_uses_again_does_not_change_the_past():
    """A driver may fill one buffer over and over; what was fed is not to change with it."""
    buffer = np.zeros(3)
    reused, plain = PoseEstimator(ALPHA), PoseEstimator(ALPHA)
    for k in range(60):
        stamp, rate = EPOCH + k * STEP, 0.01 * k
        buffer[2] = rate
        reused.feed(ImuSample(stamp, buffer))
        plain.feed(ImuSample(stamp, (0.0, 0.0, rate)))
        if k % 2 == 0:
            late = TrackSpeeds(stamp - STEP // 2, 0.2, 0.2 + 0.004 * k)
            assert reused.feed(late)
            assert plain.feed(late)
    assert known(reused) == known(plain)


def kept(estimator):
    """How many measurements and how many checkpoints are kept."""
    memory = estimator._history
    return len(memory._events), len(memory._checkpoints)


def test_the_history_is_bounded_by_its_time():
    estimator = PoseEstimator(ALPHA, settings=Settings(history=0.5))
    most = (0, 0)
    for k in range(1000):
        estimator.feed(ImuSample(EPOCH + k * STEP, (0.0, 0.0, 0.0)))
        estimator.feed(TrackSpeeds(EPOCH + k * STEP + STEP // 2, 0.1, 0.1))
        most = max(most, kept(estimator))
    # 0.5 s of 200 measurements a second, and up to two checkpoints' worth before.
    assert most[0] <= 100 + 2 * history.CHECKPOINT_EVERY
    assert most[1] <= most[0] / history.CHECKPOINT_EVERY + 2


def test_the_history_is_bounded_by_its_size(monkeypatch):
    monkeypatch.setattr(history, "MOST_MEASUREMENTS", 160)
    estimator = PoseEstimator(ALPHA)
    for k in range(500):
        estimator.feed(TrackSpeeds(EPOCH + 1000 * k, 0.1, 0.1))
    measurements, checkpoints = kept(estimator)
    assert checkpoints <= 12
    assert measurements <= 160 + 2 * history.CHECKPOINT_EVERY
    assert estimator.feed(TrackSpeeds(EPOCH + 500, 0.1, 0.1)) is False
    assert estimator.health.rejections() == {"tracks: history is full": 1}
    assert estimator.feed(TrackSpeeds(EPOCH + 1000 * 480 + 500, 0.1, 0.1)) is True


def test_a_stamp_far_ahead_does_not_make_the_history_forget():
    estimator = fed(MEASUREMENTS[:200])
    ahead = ImuSample(MEASUREMENTS[199].stamp + seconds(3600.0), (0.0, 0.0, 0.0))
    assert estimator.feed(ahead) is False
    assert known(feed_all(estimator, MEASUREMENTS[200:])) == in_order()[0]
