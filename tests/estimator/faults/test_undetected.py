"""A robot that is carried, and slip that nothing shows: the covariance covers them."""

import math

import msgspec
import numpy as np
import pytest

import faulty_drives
from faulty_drives import RESTS, motion_over, with_tracks
from icreckon import Health, Log, Robot, Settings, UndetectedSlip, load_robot
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.sensors.held_tracks import TrackRecord
from icreckon.estimator.sensors.imu_noise import NoiseRecord, noise_of_step
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.standstill import (
    CARRIED_SPEED,
    ROCKING_TIME,
    QuietReadings,
    StandstillRecord,
    carried_density,
    is_carried,
    stopped_after,
    turn_density,
)
from icreckon.estimator.sensors.step_inputs import hidden_density

SECOND, STEP = 1_000_000_000, 10_000_000
SETTINGS = input_settings(load_robot("auriga-alpha"), Settings())


def rested(
    rates: np.ndarray, still: StandstillRecord | None = None, stale_from: int = 10**6
) -> list[float]:
    """Seconds at which the robot is carried, of readings at 100 Hz with resting tracks.

    From a number of readings on, the track speeds are stale.
    """
    still, readings = still or StandstillRecord(), QuietReadings()
    stopped_after(still, 0, 0.0, 0.0, SETTINGS.track_speed)
    found = []
    for k, rate in enumerate(rates.tolist()):
        readings.mean(still, k * STEP, rate, 1e-3, k >= stale_from, SETTINGS)
        if is_carried(still):
            found.append(k * STEP * NANOSECOND)
    return found


def calm(seconds: float) -> np.ndarray:
    return 0.002 * np.random.default_rng(4).standard_normal(round(100 * seconds))


def test_a_robot_that_rocks_as_it_stops_is_not_carried() -> None:
    times = np.arange(0.0, 1.2, 0.01)
    assert (
        rested(np.concatenate([0.3 * np.exp(-3.0 * times) * np.sin(20.0 * times), calm(5)])) == []
    )


@pytest.mark.parametrize("shake", ["by hand", "turntable"])
def test_a_robot_that_is_shaken_or_turned_is_carried_from_then_on(shake: str) -> None:
    times = np.arange(0.0, 5.0, 0.01)
    moved = 0.2 * np.sin(9.0 * times) if shake == "by hand" else np.full(500, 0.5)
    still = StandstillRecord()
    found = rested(np.concatenate([calm(3), moved, calm(3)]), still)
    assert 3.0 + ROCKING_TIME < found[0] < 3.6 + ROCKING_TIME
    assert 7.9 < found[-1] < 8.6
    assert still.carries == 1
    assert not is_carried(still)


def test_a_slow_turntable_is_a_bias_and_the_yaw_is_uncertain_by_its_turning() -> None:
    """Nothing tells 0.2 rad/s from a bias that jumped; the yaw's own sigma is half of the turning."""
    still = StandstillRecord()
    assert rested(np.concatenate([calm(3), 0.2 + calm(5)]), still) == []
    assert still.quiet_mean == pytest.approx(0.2, abs=0.01)
    of_yaw = sum(
        turn_density(still, k * STEP, (k + 1) * STEP) * STEP * NANOSECOND for k in range(300, 800)
    )
    assert math.sqrt(of_yaw) == pytest.approx(0.2 * 5.0 / 2.0, rel=0.15)
    stopped_after(still, 9 * SECOND, 0.5, 0.5, SETTINGS.track_speed)
    assert turn_density(still, 9 * SECOND, 10 * SECOND) == 0.0


def test_a_turn_ends_a_rest_without_newer_track_speeds_and_a_short_bump_does_not() -> None:
    bump, turn = 0.1 * np.sin(np.arange(0.0, 3.0, 0.1)), np.full(300, 0.2)
    still = StandstillRecord()
    assert rested(np.concatenate([calm(3), bump, calm(3)]), still, 200) == []
    assert still.stopped_since == 0
    assert still.quiet_at == pytest.approx(6.3 * SECOND, abs=2 * STEP)
    still = StandstillRecord()
    assert rested(np.concatenate([calm(3), turn + calm(3)]), still, 200) == []
    assert still.stopped_since < 0
    assert still.quiet_mean == pytest.approx(0.0, abs=0.01)


def test_tracks_that_move_end_it() -> None:
    still = StandstillRecord(stopped_since=0, restless_since=0, carried_since=SECOND, carries=1)
    stopped_after(still, 2 * SECOND, 0.5, 0.5, SETTINGS.track_speed)
    assert still == StandstillRecord(carries=1)


def test_the_distance_is_uncertain_by_speed_times_duration() -> None:
    still = StandstillRecord(restless_since=0, carried_since=SECOND)
    edges = range(SECOND, 5 * SECOND, STEP)
    variance = sum(carried_density(still, a, a + STEP) for a in edges) * STEP * NANOSECOND
    assert variance == pytest.approx(CARRIED_SPEED**2 * (5.0**2 - 1.0), rel=1e-3)
    assert carried_density(StandstillRecord(restless_since=0), SECOND, SECOND + STEP) == 0.0


def test_the_accelerometers_of_a_robot_that_is_carried_do_not_count() -> None:
    noise = NoiseRecord()
    stands = noise_of_step(noise, StandstillRecord(stopped_since=0), SETTINGS)
    carried = StandstillRecord(0, restless_since=0, carried_since=SECOND)
    found = noise_of_step(noise, carried, SETTINGS)
    assert found.gyro == stands.gyro
    assert found.accelerometer_x == found.accelerometer_y > 1e4 * stands.accelerometer_x


def test_expected_slip_is_a_share_of_the_distance_and_none_at_rest() -> None:
    """0.5 m/s for 10 s with a share of 0.5 and 5 s: 2.5 m, as the page of robot files says."""
    chosen = SETTINGS._replace(undetected_share=0.5, undetected_time=5.0)
    drives = TrackRecord(smooth_left=0.5, smooth_right=0.5)
    assert np.sqrt(hidden_density(drives, chosen) * 10.0) == pytest.approx(2.5)
    assert hidden_density(TrackRecord(), chosen) == 0.0
    assert hidden_density(drives, SETTINGS) == 0.0
    with pytest.raises(ValueError, match="time"):
        UndetectedSlip(share=0.5, time=0.0)


def slides(health: Health) -> bool:
    return {"sliding", "carried"} & health.times.keys() != set()


@pytest.fixture(scope="module")
def healthy(robot: Robot) -> Log:
    return faulty_drives.drive(robot, 0)


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_the_uncertainty_covers_a_robot_that_is_carried(variant, robot, healthy):
    carried = with_tracks(healthy, 10.0, np.zeros_like, RESTS)
    found = motion_over(carried, robot, variant, slides, 10.0, RESTS)
    assert found.error < 3.0 * found.sigma < 30.0
    assert found.delay < 10.0


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_expected_slip_covers_tracks_that_spin_slowly(variant, robot, healthy):
    expecting = msgspec.structs.replace(robot, undetected_slip=UndetectedSlip(share=0.5))
    spinning = with_tracks(healthy, 10.0, lambda speeds: speeds + 0.5)
    found = motion_over(spinning, expecting, variant, slides, 10.0)
    assert found.error < 3.0 * found.sigma < 30.0
    assert math.isnan(found.delay)
