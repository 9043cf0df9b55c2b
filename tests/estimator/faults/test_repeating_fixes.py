"""A receiver that repeats one position while the robot drives, and one that does not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from agreement_scenes import with_poses
from faulty_drives import errors
from icreckon import Log, PoseEstimator, Scenario, load_robot, run, simulate
from icreckon.estimator.faults.repeating_fixes import MOST_DRIVEN
from icreckon.estimator.log.measurements import PoseFix, PositionFix, TrackSpeeds

ALPHA = load_robot("auriga-alpha")
SECOND = 1_000_000_000
STUCK_AT = 30
LARGE = tuple(tuple(row) for row in (np.eye(3) * 100.0).tolist())


@cache
def driven(fix_rate: float) -> Log:
    scenario = Scenario(duration=60.0, seed=3, trajectory="random", fix_rate=fix_rate)
    return simulate(scenario, ALPHA)


@pytest.mark.parametrize("variant", ["gyro", "constant-online", "inertia-online"])
@pytest.mark.parametrize("rate", [5.0, 20.0])
def test_a_position_that_repeats_itself_does_not_hold_the_robot(variant, rate):
    """At 20 Hz the gate would give up before 0.3 m; a receiver that never repeated one may not."""
    log = driven(rate)
    begin = int(np.searchsorted(log.fixes.stamps, log.start + STUCK_AT * SECOND))

    def repeats(poses: np.ndarray, _: np.ndarray) -> None:
        poses[begin:] = poses[begin]

    one = run(with_poses(log, repeats), ALPHA, variant)
    assert one.health.rejections()["position: repeats itself"] > 20.0 * rate
    seconds, off, _ = errors(one, log)
    off, sigmas = off[seconds > STUCK_AT + 5.0], one.state_sigmas[seconds > STUCK_AT + 5.0]
    worst = int(off.argmax())
    assert off[worst] < 1.0
    assert off[worst] < 3.0 * max(np.hypot(*sigmas[worst, :2]), 0.3)


def accepted(resolution: float, rate: int) -> list[bool]:
    """Whether fixes of a coarse receiver are used, on a straight way at 0.5 m/s."""
    estimator, used = PoseEstimator(ALPHA, "gyro"), []
    for k in range(1, 600):
        estimator.feed(TrackSpeeds(k * SECOND // 20, 0.5, 0.5))
        if k % (20 // rate) == 0:
            x = round((k - 1) * 0.025 / resolution) * resolution
            used.append(estimator.feed(PositionFix(k * SECOND // 20, x, 0.0, 1.0)))
    return used


@pytest.mark.parametrize(("resolution", "rate"), [(0.19, 20), (0.19, 5), (0.05, 20), (0.025, 20)])
def test_a_coarse_receiver_may_repeat_what_it_always_repeats(resolution, rate):
    assert all(accepted(resolution, rate))


def test_a_robot_that_stands_may_be_measured_at_one_place():
    estimator, rng = PoseEstimator(ALPHA, "constant-online"), np.random.default_rng(1)
    for k in range(1, 1000):
        # An engine shakes the encoders, or the robot turns on the spot.
        speed = float(rng.normal(0.0, 0.02)) if k < 500 else 0.0
        estimator.feed(
            TrackSpeeds(k * SECOND // 10, speed - 0.2 * (k > 500), speed + 0.2 * (k > 500))
        )
        if k % 10 == 0:
            estimator.feed(PositionFix(k * SECOND // 10, 1.0, 2.0, 0.01))
    assert "position: repeats itself" not in estimator.health.rejections()


@pytest.mark.parametrize(
    ("fix", "name"),
    [
        (lambda stamp: PositionFix(stamp, 0.0, 0.0, 100.0), "position"),
        (lambda stamp: PoseFix(stamp, 0.0, 0.0, 0.0, LARGE), "pose"),
    ],
)
def test_it_is_refused_from_a_metre_of_driving_until_it_moves(fix, name):
    estimator, used = PoseEstimator(ALPHA, "gyro"), {}
    for k in range(1, 60):
        estimator.feed(TrackSpeeds(k * SECOND // 10, 0.5, 0.5))
        used[0.05 * (k - 1)] = estimator.feed(fix(k * SECOND // 10))
    assert all(used[way] for way in used if way < 0.9 * MOST_DRIVEN)
    assert not any(used[way] for way in used if way > 1.1 * MOST_DRIVEN)
    rejected = estimator.health.rejections()[f"{name}: repeats itself"]
    assert rejected == sum(not one for one in used.values())
    assert estimator.feed(replace(fix(6 * SECOND), x=2.9))
    assert estimator.health.rejections()[f"{name}: repeats itself"] == rejected


def test_two_receivers_are_watched_apart():
    log = simulate(Scenario(duration=20.0, seed=1, trajectory="straight", fix_rate=0.0), ALPHA)
    estimator, due = PoseEstimator(ALPHA, "gyro"), 0
    for m in log.measurements():
        estimator.feed(m)
        if m.stamp >= due:
            due = m.stamp + SECOND // 2
            estimator.feed(PositionFix(m.stamp, 0.0, 0.0, 100.0))
            x, y, yaw = estimator.pose
            estimator.feed(PoseFix(m.stamp, x, y, yaw, LARGE))
    rejections = estimator.health.rejections()
    assert rejections["position: repeats itself"] > 5
    assert "pose: repeats itself" not in rejections
