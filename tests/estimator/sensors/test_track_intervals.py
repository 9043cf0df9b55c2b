"""Track speeds act over the interval since the sample before, at any rate and latency."""

import msgspec
import numpy as np
import pytest

from icreckon import Imu, ImuSample, PoseEstimator, Settings, TrackSpeeds, load_robot
from icreckon.estimator.base import state as s
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.engine.lane_functions import ends_step
from icreckon.estimator.filter.filter_record import FilterRecord, take_track_speeds
from icreckon.estimator.sensors.held_tracks import TrackRecord, late_density, take_tracks
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.step_inputs import step_inputs

SECOND = 1_000_000_000
ROBOT = load_robot("husky")
SETTINGS = input_settings(ROBOT, Settings())


@pytest.mark.parametrize("rate", [7.0, 50.0, 100.0, 400.0])
def test_no_distance_is_lost_at_any_rate(rate: float) -> None:
    """Up to the newest sample the steps of 0.01 s move as far as the tracks did."""
    rng, record = np.random.default_rng(3), FilterRecord(SETTINGS)
    stamps = np.cumsum(np.rint(SECOND / rate * rng.uniform(0.6, 1.4, round(6 * rate)))).astype(int)
    speeds = np.stack([0.5 + 0.3 * np.sin(stamps / 7e8), 0.6 + 0.2 * np.cos(stamps / 5e8)], axis=1)
    moved, driven, k = 0.0, 0.0, 0
    record.stamp = begin = int(stamps[0])
    for end in range(begin + 3_000_000, int(stamps[-1]), SECOND // 100):
        record.imu.stamp = record.stamp
        while k < len(stamps) and stamps[k] <= end:
            driven += speeds[k].mean() * (stamps[k] - stamps[max(0, k - 1)])
            assert not ends_step(record)
            take_track_speeds(record, int(stamps[k]), *speeds[k].tolist())
            k += 1
        found = step_inputs(record.tracks, record.still, record.stamp, end, SETTINGS)
        mean = 0.5 * (found.left + found.right) + found.missing
        moved += mean * (end - record.stamp)
        ahead = (end - stamps[k - 1]) * speeds[k - 1].mean()
        assert moved == pytest.approx(driven + ahead, rel=1e-9)
        record.stamp = end


@pytest.mark.parametrize("variant", ["gyro", "inertia-online"])
def test_the_yaw_follows_the_gyro_however_far_the_tracks_turn(variant: str) -> None:
    """The gyro measures the mean of the slip over a step of 0.05 s, by which the pose moves."""
    robot = msgspec.structs.replace(ROBOT, imu=Imu())
    estimator, rate, before = PoseEstimator(robot, variant), 0.5, 0.0
    for k in range(200):
        estimator.feed(TrackSpeeds(stamp=k * SECOND // 20, left=-0.6, right=0.6))
        stamp, force = k * SECOND // 20 + 1_000_000, (0.0, 0.0, 9.81)
        estimator.feed(
            ImuSample(stamp, angular_velocity=(0.0, 0.0, rate), linear_acceleration=force)
        )
        x, yaw = estimator.state, estimator.pose[2]
        turned, before = wrap_angle(yaw - before), yaw
        measured = (rate - x[s.GYRO_BIAS]) / (1.0 + x[s.GYRO_SCALE])
        assert k < 100 or turned == pytest.approx(0.05 * measured, rel=1e-3)


@pytest.mark.parametrize("interval", [0.01, 0.05, 0.1])
@pytest.mark.parametrize("length", [0.001, 0.01, 0.1])
@pytest.mark.parametrize("since", [-0.05, 0.0, 0.08])
def test_late_speeds_are_wrong_by_the_turn_that_began_since(
    interval: float, length: float, since: float
) -> None:
    """A step begins `since` seconds after the newest sample; the yaw rate changes all the time."""
    tracks, change = TrackRecord(), 0.6 * SETTINGS.track_width
    for k in range(200):
        stamp = round(k * interval * SECOND)
        turning = change * (k - 0.5) * interval  # mean over the interval before the stamp
        take_tracks(tracks, stamp, 0.5 - 0.5 * turning, 0.5 + 0.5 * turning, SETTINGS)
    start = tracks.stamp + round(since * SECOND)
    end = start + round(length * SECOND)
    middle = 0.5 * (start + end) / SECOND
    true_rate = change * middle / SETTINGS.track_width
    held_rate = (tracks.right - tracks.left) / SETTINGS.track_width
    expected = abs(true_rate - held_rate)
    if end - tracks.stamp > SETTINGS.hold_ns:
        expected = 0.0  # stale: `gap_density` has that error
    found = late_density(tracks, start, end, SETTINGS)
    assert np.sqrt(found / length) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_tracks_say_nothing_of_the_scale_of_the_gyro() -> None:
    """Gentle bends in which the tracks turn 1.7 times as far: that is slip, and no scale."""
    imu = Imu(gyro_scale_sigma=0.01)
    estimator = PoseEstimator(msgspec.structs.replace(ROBOT, imu=imu), "inertia-online")
    width = ROBOT.vehicle.track_gauge * ROBOT.constant_indices.eta0
    for k in range(2000):
        rate = 0.1 * np.sin(0.01 * k)
        more, stamp = 1.7 * 0.5 * width * rate, k * SECOND // 50
        estimator.feed(TrackSpeeds(stamp=stamp, left=0.4 - more, right=0.4 + more))
        force = (0.0, 0.4 * rate, 9.81)
        estimator.feed(ImuSample(stamp + 1, (0.0, 0.0, rate), force))
    assert estimator.biases["gyro_scale"] == 0.0
