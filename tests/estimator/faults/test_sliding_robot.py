"""Slides of the whole robot: what the accelerometer shows and the tracks do not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import faulty_drives
from faulty_drives import motion_over, with_free_tracks
from icreckon import Log, PoseEstimator, Robot, Scenario, Settings, load_robot, simulate
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import shifted
from icreckon.estimator.faults.sliding_robot import (
    AVERAGING,
    LONGEST_SLIDE,
    SlideRecord,
    slide_density,
    slides,
    watch_slide,
)
from icreckon.estimator.filter.process_noise import fast_slip_density
from icreckon.estimator.sensors.held_tracks import TrackRecord
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.standstill import StandstillRecord
from icreckon.estimator.sensors.step_inputs import step_inputs

SECOND, STEP = 1_000_000_000, 10_000_000
ALPHA = load_robot("auriga-alpha")
CALM = SlideRecord(square=1e-3, averaged=20.0)


def watched(
    tracks: np.ndarray,
    robot: np.ndarray | None = None,
    *,
    gravity: float = 0.0,
    shaking: float = 0.0,
    step: int = STEP,
    start: SlideRecord = CALM,
) -> list[SlideRecord]:
    """Records after each sample of a drive; velocities in m/s, of the robot by default zero."""
    true = np.zeros_like(tracks) if robot is None else robot
    forces = np.diff(true, prepend=true[0]) / (step * NANOSECOND) + gravity
    forces += shaking * np.random.default_rng(1).standard_normal(len(forces))
    slide, found, mean = shifted(start, 0), [], float(tracks[0])
    for k, (force, speed) in enumerate(zip(forces, tracks, strict=True)):
        mean += min(1.0, step * NANOSECOND / AVERAGING) * (float(speed) - mean)
        watch_slide(slide, k * step, float(force), mean)
        found.append(shifted(slide, 0))
    return found


def ramp(at: float, speed: float, *, over: float = 0.2) -> np.ndarray:
    """Speed that rises from zero at a time [s], over some time [s]."""
    times = np.arange(0.0, 20.0, STEP * NANOSECOND)
    return speed * np.clip((times - at) / over, 0.0, 1.0)


@pytest.mark.parametrize("gravity", [0.0, 1.7, -1.7])
@pytest.mark.parametrize("speed", [1.2, -1.2])
def test_tracks_that_spin_up_are_a_slide(speed: float, gravity: float) -> None:
    """The slope, which the mean takes out, is as steep as 10 degrees."""
    found = watched(ramp(12.0, speed) - ramp(15.0, speed), gravity=gravity)
    state = [slides(one) for one in found]
    begin = state.index(True) * STEP * NANOSECOND
    end = (len(state) - state[::-1].index(True)) * STEP * NANOSECOND
    assert 12.0 < begin < 12.2
    assert 15.0 < end < 15.3
    assert all(state[1220:1500])
    assert found[1400].speed == pytest.approx(-0.67 * speed, rel=0.1)
    assert found[-1].times == 1


@settings(max_examples=30)
@given(speed=st.floats(-3.0, 3.0), over=st.floats(0.1, 3.0), at=st.floats(1.0, 10.0))
def test_a_robot_that_follows_its_tracks_does_not_slide(speed, over, at):
    speeds = ramp(at, speed, over=over)
    found = watched(speeds, speeds)
    assert found[-1].times == 0
    assert abs(found[-1].difference) < 0.05


def test_a_slow_slide_is_not_seen() -> None:
    """As the documentation says: no accelerometer tells it from a slope."""
    assert watched(ramp(5.0, 2.0, over=4.0))[-1].times == 0
    assert watched(ramp(5.0, 0.6))[-1].times == 0


def test_a_push_is_a_slide_to_the_other_side() -> None:
    push = ramp(12.0, 1.0)
    found = watched(np.zeros_like(push), push)
    assert found[-1].times == 1
    assert found[1250].speed == pytest.approx(0.65, rel=0.1)


def test_stamps_that_jitter_are_no_slide() -> None:
    """A driver divides the distance by the time between two arrivals."""
    log = simulate(Scenario(duration=60.0, seed=1, fix_rate=0.0), ALPHA)
    tracks, rng = log.tracks, np.random.default_rng(1)
    late = np.abs(rng.normal(0.0, 0.005, len(tracks.stamps))) * SECOND
    stamps = tracks.stamps + late.astype(np.int64)
    stamps = np.maximum(stamps, np.append(0, stamps[:-1]) + 5_000_000)
    scale = np.diff(tracks.stamps) / np.diff(stamps)
    speeds = tracks.speeds[1:] * scale[:, None]
    ends = []
    for each in (tracks, replace(tracks, stamps=stamps[1:], speeds=speeds)):
        estimator = PoseEstimator(ALPHA, "inertia-online")
        for measurement in replace(log, tracks=each).measurements():
            estimator.feed(measurement)
        assert "sliding" not in estimator.health.times
        ends.append(estimator.pose)
    assert np.hypot(*(ends[1] - ends[0])[:2]) < 1.0


def test_a_shaking_robot_has_wider_limits() -> None:
    spin = ramp(15.0, 1.0)
    calm, shaken = watched(spin)[-1], watched(spin, shaking=5.0, start=SlideRecord())[-1]
    assert calm.times == 1
    assert shaken.times == 0
    assert math.sqrt(shaken.square) > 0.15


def test_a_slide_without_an_end_is_forgotten() -> None:
    found = watched(ramp(2.0, 1.2))
    assert slides(found[round((2.0 + LONGEST_SLIDE) * 100)])
    assert not slides(found[round((2.5 + LONGEST_SLIDE) * 100)])


@pytest.mark.parametrize("every", [2, 5])
def test_the_rate_of_the_imu_does_not_matter(every: int) -> None:
    spin = ramp(5.0, 1.5, over=0.3)
    fine, coarse = watched(spin), watched(spin[::every], step=every * STEP)
    assert coarse[-1].times == fine[-1].times == 1
    begin = fine[-1].since, coarse[-1].since
    assert begin[1] == pytest.approx(begin[0], abs=0.1 * SECOND)


def test_gaps_and_missing_readings_are_no_slides() -> None:
    slide = SlideRecord(square=1e-3)
    watch_slide(slide, 0, 0.0, 0.0)
    watch_slide(slide, SECOND, 0.0, 2.0)
    assert not slides(slide)
    before = shifted(slide, 0)
    watch_slide(slide, SECOND + STEP, math.nan, 0.0)
    assert slide == before
    assert shifted(slide, SECOND).stamp == 2 * SECOND
    assert shifted(SlideRecord(), SECOND) == SlideRecord()


def test_the_distance_is_uncertain_by_speed_times_duration() -> None:
    slide = SlideRecord(since=0, speed=-0.8)
    edges = range(0, 3 * SECOND + 1, STEP)
    densities = [slide_density(slide, a, a + STEP) for a in edges[:-1]]
    variance = sum(densities) * STEP * NANOSECOND
    assert math.sqrt(variance) == pytest.approx(0.8 * 3.0, rel=1e-3)
    assert slide_density(SlideRecord(), 0, STEP) == 0.0


def test_a_slide_forward_makes_the_forward_speed_uncertain_alone() -> None:
    """It does not turn the robot, so the yaw rate stays as sure as it was."""
    held = TrackRecord(stamp=0, forward=SlideRecord(since=0, speed=0.8))
    chosen = input_settings(load_robot("auriga-alpha"), Settings())
    inputs = step_inputs(held, StandstillRecord(), SECOND, SECOND + STEP, chosen)
    assert inputs.slide_x_density == pytest.approx(2.0 * 0.8**2, rel=0.01)
    alone = inputs._replace(slide_x_density=3.0, gap_density=0.0, late_density=0.0)
    density = np.array(fast_slip_density(alone, [[0.0, 0.0]] * 3, 0.0, 0.0, 0.01))
    assert density.tolist() == np.diag([3.0, 0.0, 0.0]).tolist()


@pytest.fixture(scope="module")
def drive(robot: Robot) -> Log:
    return with_free_tracks(faulty_drives.drive(robot, 1))


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_the_uncertainty_covers_both_tracks_spinning(variant, robot, drive):
    found = motion_over(drive, robot, variant, lambda health: health.finding("sliding") is not None)
    assert found.delay < 0.3
    assert found.error < 3.0 * found.sigma
    assert found.sigma < 2.0 * 1.2 * 3.0
