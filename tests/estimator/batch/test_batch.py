"""Filters side by side: many logs, single precision, and what is refused."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from icreckon import FixSeries, Log, Scenario, ZeroVelocity, load_robot, run_many, simulate
from icreckon.estimator.base.errors import BatchError, EstimatorError
from icreckon.estimator.batch.inputs import measured_of
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

ROBOT = load_robot("auriga-alpha")
DURATION = 10.0
BASE = Scenario(duration=DURATION, seed=5, fix_rate=1.0)


@cache
def logs_of(count: int) -> tuple[Log, ...]:
    return tuple(simulate(BASE, ROBOT, run_index=run) for run in range(count))


def test_runs_of_other_stamps_are_refused() -> None:
    log, other = logs_of(1)[0], simulate(msgspec.structs.replace(BASE, imu_rate=50.0), ROBOT)
    with pytest.raises(BatchError, match="other stamps"):
        measured_of([log, other], ROBOT)


def test_many_logs_are_run_as_one_by_one() -> None:
    """More than there are lanes, and not a multiple of them."""
    logs = logs_of(9)
    found = run_many(logs, ROBOT, "constant-online", every=0.5, start=(1.0, 2.0, 0.3))
    assert len(found) == 9
    for log, trajectory in zip(logs[::4], found[::4], strict=True):
        assert len(trajectory.stamps) == 2 * DURATION + 1
        estimator = PoseEstimator(ROBOT, "constant-online", start=(1.0, 2.0, 0.3))
        measurements = list(log.measurements())
        for row, stamp in enumerate(trajectory.stamps):
            while measurements and measurements[0].stamp <= stamp:
                estimator.feed(measurements.pop(0))
            one = estimator.snapshot()
            assert np.allclose(trajectory.poses[row], one.state[:3], rtol=0.0, atol=1e-9)
            assert np.allclose(trajectory.twists[row], one.twist, rtol=0.0, atol=1e-9)
            for covariance, expected in (
                (trajectory.pose_covariances[row], one.covariance[:3, :3]),
                (trajectory.twist_covariances[row], one.twist_covariance),
            ):
                assert np.allclose(covariance, expected, rtol=1e-8, atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"logs": []}, "no logs"),
        ({"every": 0.0}, "every must be a time"),
        ({"variant": "constant-onlin"}, "constant-online"),
    ],
)
def test_what_cannot_be_run_side_by_side_is_refused(changes: dict[str, object], told: str) -> None:
    given = {"logs": logs_of(1), "variant": "constant-online", "every": 0.1, **changes}
    with pytest.raises(EstimatorError, match=told):
        run_many(given["logs"], ROBOT, given["variant"], every=given["every"])  # type: ignore[arg-type]


def test_logs_that_hold_more_than_lanes_can_take_are_refused() -> None:
    log = logs_of(1)[0]
    pushed = replace(log, others=(ZeroVelocity(log.start),))
    with pytest.raises(BatchError, match="ZeroVelocity"):
        run_many([pushed], ROBOT, "constant-online")
    speeds = log.tracks.speeds.copy()
    speeds[40, 1] = 1e4
    absurd = replace(log, tracks=type(log.tracks)(log.tracks.stamps, speeds))
    with pytest.raises(BatchError, match="no such sensor"):
        run_many([absurd], ROBOT, "constant-online")
    poses = log.fixes.poses.copy()
    poses[3, 2] = 0.1
    mixed = replace(log, fixes=FixSeries(log.fixes.stamps, poses, log.fixes.variances))
    with pytest.raises(BatchError, match="some have none"):
        run_many([mixed], ROBOT, "constant-online")
