"""A track that repeats itself while the other does not: when it is believed, and what that comes to."""

import numpy as np
import pytest

from icreckon import ImuSample, PoseEstimator, Settings, TrackSpeeds, load_robot
from icreckon.estimator.sensors.held_tracks import TrackRecord, take_tracks
from icreckon.estimator.sensors.held_tracks import stuck_density as stuck_density_of
from icreckon.estimator.sensors.input_settings import input_settings

ALPHA = load_robot("auriga-alpha")
SECOND = 1_000_000_000
RATE = 50
SETTINGS = input_settings(ALPHA, Settings())


def held(left, right):
    tracks = TrackRecord()
    for k, speeds in enumerate(zip(left, right, strict=True)):
        take_tracks(tracks, k * SECOND // RATE, *map(float, speeds), SETTINGS)
    return tracks


def noisy(count, seed=0):
    return 0.5 + 0.02 * np.random.default_rng(seed).normal(size=count)


def stuck_density(tracks):
    begin = tracks.stamp
    return tuple(
        stuck_density_of(track, begin, begin + SECOND // RATE, SETTINGS)
        for track in (tracks.repeating_left, tracks.repeating_right)
    )


def with_stuck_left(samples, before=100):
    left, right = noisy(before + samples), noisy(before + samples, seed=1)
    left[before:] = left[before]
    return left, right


def test_a_stuck_track_is_not_believed_from_when_it_is_too_old_to_be_held():
    assert stuck_density(held(*with_stuck_left(16))) == (0.0, 0.0)
    densities = [stuck_density(held(*with_stuck_left(count)))[0] for count in (17, 25, 50)]
    assert 0.0 < densities[0] < densities[1] < densities[2]


def test_left_and_right_are_alike():
    left, right = with_stuck_left(40)
    assert stuck_density(held(left, right)) == stuck_density(held(right, left))[::-1]


def test_it_is_believed_again_with_its_next_reading():
    left, right = with_stuck_left(40)
    assert stuck_density(held([*left, 0.4], [*right, 0.5])) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        # Standing: zero says nothing.
        (np.concatenate([noisy(100), np.zeros(60)]), noisy(160, 1)),
        # Without noise.
        (np.full(200, 0.5), np.full(200, 0.3)),
        (np.full(200, 0.5), np.linspace(0.0, 0.8, 200)),
        # Of coarse resolution.
        (np.round(noisy(4000), 1), np.round(noisy(4000, 1), 2)),
        # Read at a tenth of the rate.
        (np.repeat(noisy(20), 10), np.repeat(noisy(20, 1), 10)),
        # Read at a twentieth of the rate, the other one always.
        (np.repeat(noisy(100), 20), noisy(2000, 1)),
    ],
)
def test_what_repeats_itself_by_nature_is_believed(left, right):
    assert all(
        stuck_density(held(left[:count], right[:count])) == (0.0, 0.0)
        for count in range(1, len(left), 37)
    )


def test_gyro_and_other_track_tell_the_speed_of_a_robot_with_a_stuck_encoder():
    # Straight at 0.3 m/s, then faster and faster; the left encoder is stuck from then on.
    estimator = PoseEstimator(ALPHA, "constant-online")
    rng = np.random.default_rng(2)
    for k in range(6 * RATE):
        speed = 0.3 + 0.1 * max(0.0, k / RATE - 3.0)
        left, right = speed + 0.01 * rng.normal(size=2)
        if k <= 3 * RATE:
            stuck = left
        estimator.feed(TrackSpeeds(k * SECOND // RATE, stuck, right))
        estimator.feed(ImuSample(k * SECOND // RATE, (0.0, 0.0, 5e-3 * rng.normal())))
    assert speed == pytest.approx(0.6, abs=0.01)
    v_x, _, w = estimator.twist
    # Half of what the left track is wrong by would be 0.15 m/s.
    assert v_x == pytest.approx(speed, abs=0.05)
    assert w == pytest.approx(0.0, abs=0.03)
