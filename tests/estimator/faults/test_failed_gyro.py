"""Faults of the gyro: what jumps, repeats itself or is beyond its range is not used."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import faulty_drives
from faulty_drives import VARIANTS, errors, motion_over, with_rates
from icreckon import Health, Log, Robot, changed_robot, run
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import rpy_to_matrix
from icreckon.estimator.base.records import shifted
from icreckon.estimator.faults.failed_gyro import LEARNT, LEAST_REPEATS, GyroRecord, watch_gyro
from icreckon.estimator.filter.fault_table import REPEATED
from icreckon.estimator.sensors.held_tracks import SMOOTHING

SECOND, STEP = 1_000_000_000, 10_000_000
WIDTH = 1.5


def noise_of(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(count)


def watched(
    rates: np.ndarray,
    true: np.ndarray | None = None,
    *,
    step: int = STEP,
    acceleration: float = 60.0,
    gyro: GyroRecord | None = None,
) -> tuple[np.ndarray, GyroRecord]:
    """Readings that are used, NaN for the others, and the record.

    The tracks turn at the true rate, by default that of the gyro; encoders are noisy on the move.
    """
    gyro = gyro or GyroRecord()
    turning = WIDTH * (rates if true is None else true)
    turning += 0.01 * noise_of(1, len(rates)) * (turning != 0.0)
    smooth = smoothed(turning, step)
    used = [
        watch_gyro(
            gyro, k * step, rate, rate, float(turning[k]), WIDTH, smooth[k], 0.0, acceleration
        )
        for k, rate in enumerate(rates.tolist())
    ]
    return np.array(used), gyro


def smoothed(values: np.ndarray, step: int) -> np.ndarray:
    """Values smoothed as those of the track record."""
    share, found, value = -np.expm1(-step * NANOSECOND / SMOOTHING), [], float(values[0])
    for newest in values.tolist():
        value += share * (newest - value)
        found.append(value)
    return np.array(found)


def drive(seconds: float = 20.0, *, noise: float = 0.01, step: int = STEP) -> np.ndarray:
    """Yaw rates of bends of 0.6 rad/s."""
    times = np.arange(0.0, seconds, step * NANOSECOND)
    return 0.6 * np.sin(times) + noise * noise_of(3, len(times))


@pytest.mark.parametrize("value", [2.0, -2.0])
def test_a_reading_that_jumps_is_not_used_until_it_jumps_back(value: float) -> None:
    true = drive()
    rates = true.copy()
    rates[1000:1100] = value + 0.01 * noise_of(5, 100)
    used, gyro = watched(rates, true)
    assert np.isnan(used[1000:1100]).all()
    assert np.array_equal(used[:1000], true[:1000])
    assert np.array_equal(used[1100:], true[1100:])
    assert (gyro.times, gyro.jumped, gyro.fault) == (1, 100, 0)


def test_a_jump_that_ends_slowly_is_over_when_the_tracks_agree() -> None:
    true = drive()
    rates = true.copy()
    rates[1000:1400] += np.linspace(1.5, 0.0, 400)
    used, _ = watched(rates, true)
    over = 1000 + int(np.flatnonzero(np.isfinite(used[1000:]))[0])
    # Two fifths of the jump are left after 2.4 s, and half a second is agreement.
    assert over == pytest.approx(1290, abs=10)
    assert np.isfinite(used[over:]).all()


def test_without_agreement_it_stays_out() -> None:
    """A bias of 2 rad/s is no yaw rate, however long it lasts."""
    true = drive(60.0)
    rates = true.copy()
    rates[1000:] += 2.0
    used, gyro = watched(rates, true)
    assert np.isnan(used[1000:]).all()
    assert gyro.since == 1000 * STEP


@given(
    seconds=st.sampled_from([0.0025, 0.005, 0.01, 0.02, 0.05]),
    acceleration=st.floats(-30.0, 30.0),
    noise=st.floats(0.001, 0.3),
)
def test_a_vehicle_that_turns_fast_or_shakes_is_no_fault(seconds, acceleration, noise):
    """3 rad/s, reached with 30 rad/s² at most; an engine may shake the gyro."""
    step = round(seconds * SECOND)
    times = np.arange(0.0, 5.0, seconds)
    true = np.clip(acceleration * (times - 2.0), -3.0, 3.0) * (times > 2.0)
    rates = true + noise * np.random.default_rng(1).standard_normal(len(times))
    used, gyro = watched(rates, true, step=step)
    assert np.isfinite(used).all()
    assert gyro.times == 0


def test_a_gyro_that_is_clipped_repeats_itself() -> None:
    true = drive(40.0)
    rates = true.copy()
    rates[1000:] = rates[1000:].clip(-0.3, 0.3)
    used, gyro = watched(rates, true)
    clipped = np.abs(rates[1000:]) == 0.3
    wrong = (np.isfinite(used[1000:]) & clipped & (np.abs(true[1000:]) > 0.35)).sum()
    assert np.isfinite(used[1000:][~clipped]).all()
    assert gyro.repeated > 1000
    # The first ones of each bend show nothing yet.
    assert wrong <= LEAST_REPEATS * gyro.times


def test_equal_readings_at_rest_are_no_fault() -> None:
    moving, gyro = watched(drive())
    assert np.isfinite(moving).all()
    assert gyro.changes == LEARNT
    used, _ = watched(np.full(5000, 0.003), np.zeros(5000), gyro=gyro)
    assert np.isfinite(used).all()


def test_a_world_without_noise_is_no_fault() -> None:
    """A simulator turns at one rate for seconds and stops at once, and so do its tracks."""
    rates = np.minimum(1.0, 0.001 * (np.arange(6000) % 2000))
    smooth, gyro = smoothed(WIDTH * rates, STEP), GyroRecord()
    for k, rate in enumerate(rates.tolist()):
        turning = WIDTH * rate
        assert watch_gyro(gyro, k * STEP, rate, rate, turning, WIDTH, smooth[k], 0.0, 60.0) == rate
    assert gyro.times == 0


def test_after_a_gap_nothing_is_a_jump() -> None:
    gyro = GyroRecord()
    for stamp, rate in ((0, 0.0), (SECOND, 2.0), (2 * SECOND, -2.0)):
        assert watch_gyro(gyro, stamp, rate, rate, 0.0, WIDTH, 0.0, 0.0, 60.0) == rate
    assert gyro.times == 0
    assert shifted(gyro, SECOND).stamp == 3 * SECOND
    assert shifted(GyroRecord(), SECOND) == GyroRecord()


BENDS = drive(60.0)
# 1.6 rad/s in 20 ms, 80 rad/s², is within what friction can do on a gauge of 0.4 m. On a robot that
# cannot it is a jump, until the tracks' turning shows it.
TURNS = 0.8 * np.sign(np.sin(0.5 * np.arange(0.0, 60.0, 0.02)))
HEALTHY = {
    "coarse": {"rates": np.round(drive(60.0, noise=0.002) / 0.05) * 0.05},
    "slow": {"rates": np.repeat(drive(60.0, step=5 * STEP), 5)},
    "tracks slip": {"rates": 0.45 * BENDS, "true": BENDS},
    "tracks turn alone": {"rates": 0.0 * BENDS, "true": BENDS},
    "tracks are swapped": {"rates": -BENDS, "true": BENDS},
    "turns at once": {"rates": TURNS, "true": TURNS, "step": 2 * STEP},
    "small": {
        "rates": TURNS, "true": np.full_like(TURNS, 0.8), "step": 2 * STEP, "acceleration": 200.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", HEALTHY)
def test_a_healthy_gyro_is_used(name: str) -> None:
    case = HEALTHY[name]
    if "true" in case:
        case = case | {"rates": case["rates"] + 0.003 * noise_of(7, len(case["rates"]))}
    used, gyro = watched(**case)
    assert np.isfinite(used).all()
    assert gyro.times == 0


def test_a_frozen_encoder_does_not_exclude_the_gyro(robot: Robot, healthy: Log) -> None:
    """The left track reads one speed for the rest of the drive; the yaw is that of the gyro."""
    speeds = healthy.tracks.speeds.copy()
    frozen = len(speeds) // 2
    speeds[frozen:, 0] = speeds[frozen, 0]
    one = run(
        replace(healthy, tracks=replace(healthy.tracks, speeds=speeds)), robot, "constant-online"
    )
    assert not set(one.health.sensors["gyro"].rejected) - {"gate"}
    assert errors(one, healthy)[2][-1] < np.radians(10.0)


def clipped(log: Log) -> Log:
    return with_rates(log, 10.0, lambda rates: rates.clip(-0.3, 0.3))


@pytest.fixture(scope="module")
def healthy(robot: Robot) -> Log:
    return faulty_drives.drive(robot, 0)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    ("change", "lasts"),
    [(lambda rates: np.full_like(rates, 2.0), 1.0), (lambda rates: rates.clip(-0.3, 0.3), 10.0)],
    ids=["jumped", "clipped"],
)
def test_the_uncertainty_covers_a_gyro_that_lies(change, lasts, variant, robot, healthy):
    """Believed, 2.0 rad/s would be 100 degrees."""

    def shown(health: Health) -> bool:
        return sum(health.sensors["gyro"].rejected.values()) > 5

    found = motion_over(with_rates(healthy, lasts, change), robot, variant, shown, lasts)
    assert found.delay <= lasts
    assert found.yaw < 3.0 * found.yaw_sigma
    assert found.error < 3.0 * found.sigma
    # Without a gyro, the variant `gyro` has no idea of the turning.
    assert found.yaw_sigma < math.radians(45.0) or variant == "gyro"


def test_a_clipped_gyro_is_found_however_the_imu_is_mounted(robot: Robot, healthy: Log) -> None:
    """The rate about the vertical does not repeat: the other axes are noisy and have a part in it."""
    angles = (2.0, -1.0, 30.0)
    mounted = changed_robot(robot, {"imu.rotation_rpy_deg": angles})
    R, imu = rpy_to_matrix(*np.radians(angles)) @ robot.imu_rotation.T, healthy.imu
    rates, forces = imu.angular_velocity @ R, imu.linear_acceleration @ R
    turned = replace(healthy, imu=replace(imu, angular_velocity=rates, linear_acceleration=forces))
    plain, found = (
        run(clipped(log), one, "gyro").health.sensors["gyro"].rejected[REPEATED]
        for log, one in ((healthy, robot), (turned, mounted))
    )
    assert found == pytest.approx(plain, rel=0.05)


def test_a_robot_file_gives_the_range(robot: Robot, healthy: Log) -> None:
    limited = changed_robot(robot, {"imu.gyro_range": 0.3})
    one = run(healthy.between(healthy.start, healthy.start + 20 * SECOND), limited, "gyro")
    rates = np.abs(healthy.imu.angular_velocity[:2000, 2])
    rejected = one.health.sensors["gyro"].rejected["beyond its range"]
    assert rejected == pytest.approx((rates > 0.3 * 0.995).sum(), rel=0.05)
