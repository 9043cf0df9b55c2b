"""Fixes and headings of all types of message: GPS, tf, orientation-only Imu."""

from pathlib import Path

import numpy as np
import pytest

import bag_messages as made
from bag_messages import JOINTS, SPEEDS, navsatfix, robot_with, tf_bag, transform
from icreckon import HeightFix, Log, ReplayError, read_log
from icreckon.replay.comparison.fixes import parse_part, with_fixes_within

SECOND = 10**9


def read(path: Path, messages, **log) -> Log:
    bag = made.write_bag(path, [*SPEEDS, *messages])
    return read_log(bag, robot_with(tracks=JOINTS, **log))


def test_gps(tmp_path: Path) -> None:
    fixes = [
        navsatfix(1 * SECOND, 52.0, 13.0, 100.0),
        navsatfix(2 * SECOND, 52.001, 13.0, float("nan")),
        navsatfix(3 * SECOND, 52.0, 13.001, 100.0, variances=(0.5, 0.25)),
        navsatfix(4 * SECOND, 52.0, 13.0, status=-1),
        navsatfix(5 * SECOND, 0.0, 0.0),
        navsatfix(6 * SECOND, 95.0, 13.0),
        navsatfix(7 * SECOND, 52.0, float("nan")),
        navsatfix(8 * SECOND, 52.0, 13.0, known=0),
        navsatfix(9 * SECOND, 52.0, 13.0, variances=(0.0, 0.0)),
    ]
    log = read(tmp_path / "bag", [("/fix", fix) for fix in fixes], fixes={"topic": "/fix"})
    # By the lengths of a degree at this latitude on WGS 84, 100 m up.
    np.testing.assert_allclose(
        log.fixes.poses[:, :2], [[0, 0], [0, 111.268], [68.678, 0]], atol=0.01
    )
    assert np.isnan(log.fixes.poses[:, 2]).all()
    np.testing.assert_allclose(log.fixes.variances[:, 0], [0.09, 0.09, 0.5])
    assert log.dropped == {
        "fixes: receiver without a fix": 1,
        "fixes: not a place on the globe": 2,
        "fixes: not finite": 1,
        "fixes: no covariance, and no position_sigma given": 2,
    }
    assert "[52.00000000, 13.00000000, 100.00]" in log.notes[0]
    assert log.origin == (52.0, 13.0, 100.0) == log.part(1.0, 2.0).origin


def test_heights_are_used_with_a_sigma_alone(tmp_path: Path) -> None:
    altitudes = (100.0, 103.5, float("nan"), 101.0)
    fixes = [
        ("/fix", navsatfix((k + 1) * SECOND, 52.0, 13.0, altitude))
        for k, altitude in enumerate(altitudes)
    ]
    mapped = {"topic": "/fix", "height_sigma": 2.0}
    log = read(tmp_path / "bag", fixes, fixes=mapped)
    known = ((1, 0.0), (2, 3.5), (4, 1.0))
    assert log.others == tuple(HeightFix(k * SECOND, height, 4.0) for k, height in known)
    assert read(tmp_path / "other", fixes, fixes={"topic": "/fix"}).others == ()


@pytest.mark.parametrize(
    ("keys", "variance"),
    [
        ({}, 1.5),
        ({"position_sigma": 0.3}, 1.5),
        ({"wander_sigma": 1.2, "wander_time": 60.0}, 1.5),
        ({"wander_sigma": 1.2, "wander_time": 60.0, "position_sigma": 0.3}, 0.09),
        ({"least_sigma": 2.0}, 4.0),
        ({"least_sigma": 1.0}, 1.5),
    ],
)
def test_the_white_part_of_fixes_that_wander_and_a_least_sigma_may_be_given(
    tmp_path, keys, variance
):
    fix = ("/fix", made.pose_with_covariance(SECOND, (1.5, 1.5, 0.0), x=1.0))
    log = read(tmp_path / "bag", [fix], fixes={"topic": "/fix", **keys})
    assert log.fixes.variances[0, 0] == pytest.approx(variance)


@pytest.mark.parametrize(
    ("key", "place"),
    [("position", one) for one in ([400.0, 0.0], [float("nan"), 0.0], [0.1], "0.1")]
    + [("origin", one) for one in ([91.0, 0.0, 0.0], [float("nan"), 0.0, 0.0])],
)
def test_an_antenna_off_the_robot_or_an_origin_off_the_globe(tmp_path, key, place):
    with pytest.raises(ReplayError, match=key):
        read(tmp_path / "bag", [], fixes={"topic": "/fix", key: place})


def test_heading_of_an_orientation(tmp_path: Path) -> None:
    messages = [
        made.orientation(1 * SECOND, 3.0),
        made.orientation(2 * SECOND, 0.5, absent=True),
        made.orientation(3 * SECOND, 0.5, covariance=float("nan")),
        made.orientation(4 * SECOND, 0.5, covariance=0.0),
    ]
    mapped = {"topic": "/heading", "offset_deg": 90.0, "sigma": 0.2}
    log = read(tmp_path / "bag", [("/heading", one) for one in messages], heading=mapped)
    assert [fix.stamp for fix in log.others] == [1 * SECOND, 3 * SECOND, 4 * SECOND]
    np.testing.assert_allclose(
        [fix.yaw for fix in log.others],
        [3.0 + np.pi / 2 - 2 * np.pi, 0.5 + np.pi / 2, 0.5 + np.pi / 2],
    )
    np.testing.assert_allclose([fix.variance for fix in log.others], [0.01, 0.04, 0.04])
    assert log.dropped == {"heading: no orientation": 1}


def test_velocity_of_another_odometry(tmp_path: Path) -> None:
    messages = [("/vo", made.pose_stamped(SECOND + k * SECOND // 10, x=0.1 * k)) for k in range(4)]
    messages.insert(2, ("/vo", made.pose_stamped(SECOND + SECOND // 8, x=float("nan"))))
    mapped = {"topic": "/vo", "sigma": 0.05, "yaw_deg": 90.0}
    log = read(tmp_path / "bag", messages, velocity=mapped)
    assert [one.stamp for one in log.others] == [SECOND + k * SECOND // 20 for k in (1, 3, 5)]
    seen = [(one.v_x, one.v_y, one.variance) for one in log.others]
    np.testing.assert_allclose(seen, [(0.0, 1.0, 0.0025)] * 3, atol=1e-9)
    assert log.dropped == {"velocity: not finite": 1}
    twists = [("/vo", made.twist_with_covariance(SECOND, 0.7, 2.0))]
    (one,) = read(tmp_path / "other", twists, velocity=mapped | {"position": [0.0, 0.1]}).others
    # To the left by the direction of the sensor, forward by its place.
    assert (one.v_x, one.v_y) == pytest.approx((0.2, 0.7))


def test_heading_without_covariance_needs_a_sigma(tmp_path: Path) -> None:
    headings = [("/h", made.orientation(SECOND, 0.1, covariance=0.0))]
    with pytest.raises(ReplayError, match=r"sigma \[rad\] in \[log.heading\]"):
        read(tmp_path / "bag", headings, heading={"topic": "/h"})


def test_headings_are_used_in_the_part_of_the_fixes_only(tmp_path: Path) -> None:
    messages = [("/h", made.orientation(k * SECOND, 0.1)) for k in (1, 2, 3)]
    messages += [("/fix", navsatfix(k * SECOND, 52.0, 13.0)) for k in (1, 2, 3)]
    log = read(tmp_path / "bag", messages, heading={"topic": "/h"}, fixes={"topic": "/fix"})
    part = with_fixes_within(log, parse_part("0:1.5"))
    assert [fix.stamp for fix in part.others] == part.fixes.stamps.tolist() == [SECOND, 2 * SECOND]


def test_a_chain_of_transforms(tmp_path: Path) -> None:
    # The pose wanted is that of base in map: (k, 2), turned by 90 deg; the marker sits 0.5 m ahead.
    moving = [transform(k * SECOND // 2, "map", "odom", 0.5 * k, 2.5, np.pi / 2) for k in (2, 3, 4)]
    moving += [transform(k * SECOND // 10, "odom", "marker", 0.0, 0.0, 0.0) for k in range(9, 22)]
    static = [transform(0, "base", "/marker", 0.5, 0.0, 0.0)]
    path = tf_bag(tmp_path / "bag", moving, static)
    mapped = {"topic": "/tf", "frames": ["map", "base"], "position_sigma": 0.1}
    log = read_log(path, robot_with(tracks=JOINTS, fixes=mapped))
    np.testing.assert_array_equal(log.fixes.stamps, [SECOND, 3 * SECOND // 2, 2 * SECOND])
    np.testing.assert_allclose(
        log.fixes.poses, [[k, 2.0, np.nan] for k in (1.0, 1.5, 2.0)], atol=1e-12
    )
    truth = {"topic": "/tf", "frames": ["map", "base"], "source": "mocap"}
    log = read_log(path, robot_with(tracks=JOINTS, truth=truth))
    np.testing.assert_allclose(log.truth.poses.poses[:, 2], np.pi / 2)
    assert log.truth.source == "mocap"


def test_transforms_are_interpolated_but_not_across_gaps(tmp_path: Path) -> None:
    moving = [transform(k * SECOND, "map", "odom") for k in (1, 2, 6)]
    moving += [
        transform(at, "odom", "base", x, 0.0, yaw)
        for at, x, yaw in (
            (SECOND // 2, 0.0, 3.0),
            (3 * SECOND // 2, 2.0, -3.0),
            (2 * SECOND, 3.0, 0.0),
            (7 * SECOND, 8.0, 0.0),
        )
    ]
    sigmas = {"position_sigma": 1.0, "heading_sigma": 1.0}
    mapped = {"topic": "/tf", "frames": ["map", "base"], **sigmas}
    log = read_log(tf_bag(tmp_path / "bag", moving), robot_with(tracks=JOINTS, fixes=mapped))
    np.testing.assert_allclose(np.abs(log.fixes.poses), [[1, 0, np.pi], [3, 0, 0]], atol=1e-9)
    assert log.dropped == {"fixes: tf: no transforms near in time": 1}


def test_frames_that_no_chain_joins(tmp_path: Path) -> None:
    path = tf_bag(tmp_path / "bag", [transform(SECOND, "map", "odom")])
    mapped = {"topic": "/tf", "frames": ["map", "base_link"], "position_sigma": 1.0}
    with pytest.raises(ReplayError, match=r"no chain .* 'map' to 'base_link'; there is map"):
        read_log(path, robot_with(tracks=JOINTS, fixes=mapped))
    with pytest.raises(ReplayError, match="must name two frames"):
        read_log(path, robot_with(tracks=JOINTS, fixes=mapped | {"frames": ["map", "map"]}))


def test_transforms_that_are_none_are_counted(tmp_path: Path) -> None:
    moving = [
        transform(1 * SECOND, "map", "base", x=1.0),
        transform(2 * SECOND, "map", "base", x=float("nan")),
        transform(3 * SECOND, "map", "base", q=(0.0, 0.0, 0.0, 0.0)),
    ]
    mapped = {"topic": "/tf", "frames": ["map", "base"], "position_sigma": 1.0}
    log = read_log(tf_bag(tmp_path / "bag", moving), robot_with(tracks=JOINTS, fixes=mapped))
    assert len(log.fixes.stamps) == 1
    assert log.dropped == {"fixes: tf: not finite or no rotation": 2}


def test_a_truth_is_without_the_positions_that_state_a_far_larger_error(tmp_path: Path) -> None:
    messages = []
    for k in range(1, 41):
        variance = 2.0 if 10 <= k < 20 else 0.01
        place = (52.0 + 1e-6 * k, 13.0)
        messages.append(("/rtk", navsatfix(k * SECOND, *place, variances=(variance, variance))))
        messages.append(("/js", made.joints(k * SECOND, (1.0, 1.0))))
    robot = robot_with(tracks=JOINTS, truth={"topic": "/rtk"})
    log = read_log(made.write_bag(tmp_path / "bag", messages), robot)
    assert log.truth.poses.stamps.tolist() == [k * SECOND for k in (*range(1, 10), *range(20, 41))]
    assert log.dropped == {"truth: stated sigma far above the median": 10}
