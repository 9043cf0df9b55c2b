"""Holes of a log: named, left out of NEES, and no more uncertain after them than a robot can drive."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from conftest import holed
from icreckon import Log, Scenario, compare, load_robot, simulate, summarise
from icreckon.replay.comparison.holes import between_holes, holes_of, largest_sigma, until_holes
from icreckon.report.replay.page_text import headline

ROBOT = load_robot("auriga-alpha")
SECOND = 10**9


@pytest.fixture(scope="module")
def log() -> Log:
    """Two minutes, of which 35 s are missing from 40 s on."""
    log = simulate(Scenario(duration=120.0, seed=2, fix_rate=0.0), ROBOT)
    return holed(log, log.start + 40 * SECOND, log.start + 75 * SECOND)


def test_holes_of_two_streams_are_one(log: Log) -> None:
    ((begin, end),) = holes_of(log)
    assert (begin - log.start) / SECOND == pytest.approx(40.0, abs=0.1)
    assert (end - log.start) / SECOND == pytest.approx(75.0, abs=0.1)
    assert until_holes([(log.start, log.end)], holes_of(log)) == [(log.start, begin)]
    # An outage that begins in a hole has no part before it; one behind it is whole.
    outages = [(begin + SECOND, end + SECOND), (end + 2 * SECOND, log.end)]
    assert until_holes(outages, holes_of(log)) == outages[1:]


def test_no_segment_of_the_drift_is_across_a_hole(log: Log) -> None:
    ((begin, end),) = holes_of(log)
    assert between_holes([(log.start, log.end)], holes_of(log)) == [
        (log.start, begin), (end, log.end)
    ]  # fmt: skip
    segments = compare(log, ROBOT, "gyro").drifts["10s"]["gyro"]
    starts = segments.starts
    assert ((starts < begin).any(), (starts >= end).any()) == (True, True)
    assert not ((starts > begin - 10 * SECOND) & (starts < end)).any()


def test_after_a_hole_sigmas_are_those_of_the_fastest_drive_and_the_verdict_names_it(
    log: Log,
) -> None:
    found = compare(log, ROBOT, ("gyro", "inertia-online"))
    ((begin, end),) = holes_of(log)
    for one in found.runs.values():
        path = one.trajectory
        sigmas = largest_sigma(path.pose_covariances)
        at = np.searchsorted(path.stamps, (begin, end))
        reach = ROBOT.vehicle.max_track_speed * 35.0
        assert 0.9 * reach <= sigmas[at[1]] <= sigmas[at[0]] + reach
        # Nothing is known of the yaw: it may have any value. Slip of the bend before the hole adds some.
        unknown, yaw = math.pi / math.sqrt(3.0), math.sqrt(path.pose_covariances[at[1], 2, 2])
        assert unknown <= yaw <= 1.5 * unknown
    results = summarise(found, ROBOT, series=False)
    assert results["log"]["holes_s"] == [pytest.approx([40.0, 75.0], abs=0.1)]
    ends = log.truth.poses.poses[np.searchsorted(log.truth.poses.stamps, (begin, end)), :2]
    moved = results["log"]["moved_in_holes_m"]
    assert moved == pytest.approx(float(np.hypot(*(ends[1] - ends[0]))), abs=0.2)
    assert re.search(
        r"IMU samples for 35.0 s, in which the truth moves \S+ m; drift and RMSE are scored between",
        headline(results),
    )
    assert all(one["rmse_v_x_m_s"] < 0.1 for one in results["variants"].values())
    whole = [one.trajectory.stamps < begin for one in found.runs.values()]
    counted = [one["nees_poses"] for one in results["variants"].values()]
    assert all(count <= one.sum() + 1 for count, one in zip(counted, whole, strict=True))


def test_a_stream_that_ends_early_is_a_hole_and_a_truth_that_does_not_is_not_scored() -> None:
    whole = simulate(Scenario(duration=80.0, seed=2, fix_rate=0.0), ROBOT)
    half = whole.part(0.0, 40.0)
    for broken in (replace(whole, tracks=half.tracks), replace(whole, truth=half.truth)):
        results = summarise(compare(broken, ROBOT, "gyro"), ROBOT, series=False)
        assert results["truth"]["scored_s"] == [pytest.approx([0.0, 40.0], abs=0.1)]
        named = "The log has no track speeds or IMU samples for 40.0 s" in headline(results)
        assert named == (broken.truth is whole.truth)


def test_an_imu_that_begins_late_leaves_a_nees() -> None:
    log = simulate(Scenario(duration=60.0, seed=2, fix_rate=0.0), ROBOT)
    late = replace(log, imu=log.part(10.0, 60.0).imu)
    (variant,) = summarise(compare(late, ROBOT, "gyro"), ROBOT, series=False)["variants"].values()
    assert variant["nees_poses"] > 0
    # A part before the IMU's begin has none of its samples.
    summarise(compare(late.part(0.0, 8.0), ROBOT, "gyro"), ROBOT, series=False)
