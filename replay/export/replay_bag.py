"""Export of a comparison as a bag for Foxglove, RViz or PlotJuggler.

Frames are those of REP-105. A tf tree gives each frame one parent, so each variant has its own frame in
`odom`, such as `inertia_online/base_link`. `base_link` itself follows the last filter variant that was
requested, and `ground_truth/base_link` the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.bags.bulk_encoding import Numbers, Packing
from icreckon.replay.bags.message_types import (
    MARKER,
    MARKERS,
    NAVSATFIX,
    ODOMETRY,
    PATH,
    POSE,
    TF,
    TRANSFORM,
)
from icreckon.replay.bags.messages import (
    BASE_LINK,
    ICR_MARKERS,
    ODOM,
    PLANAR,
    UNUSED_VARIANCE,
    Messages,
)
from icreckon.replay.bags.writer import Format, Outbox, write_bag
from icreckon.replay.base.colours import colour_of
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.known_bias import KNOWN_BIAS
from icreckon.replay.export.diagnostics import diagnostics
from icreckon.replay.export.log_bag import fix_messages
from icreckon.replay.export.sampling import thinned
from icreckon.replay.export.tables import icr_series
from icreckon.replay.mapping.geodesy import Origin, degrees

TRUTH = "ground_truth"
FIXES_TOPIC, TF_TOPIC = "/fixes", "/tf"
# Highest rate of transforms [Hz]; odometry and truth keep all of their samples.
TF_RATE = 20.0
POSE_RATE = 20.0
MARKER_RATE = PLACE_RATE = 5.0
# `position_covariance_type` of NavSatFix.
COVARIANCE_KNOWN = 3
# Most poses of a path, which is one message.
PATH_POSES = 1000
# Variances of z, roll and pitch in a row-major 6x6 covariance.
SPATIAL = (14, 21, 28)


def write_replay_bag(path: Path, form: Format, comparison: Comparison, robot: Robot) -> Path:
    """Write the runs of a comparison as a bag.

    It holds, with `-` in names of variants written as `_`: `/<variant>/odom` (nav_msgs/Odometry),
    `/<variant>/pose` (geometry_msgs/PoseStamped, for viewers that draw no odometry),
    `/<variant>/path` (nav_msgs/Path), `/<variant>/icrs` (visualization_msgs/MarkerArray),
    `/<variant>/fix` (sensor_msgs/NavSatFix) if the log has an origin on the globe, `/tf`, `/fixes` that
    were used, `/ground_truth/pose` and `/ground_truth/path`, and `/diagnostics`
    (diagnostic_msgs/DiagnosticArray) with innovations and uncertainty.

    Args:
        path: target, as for `icreckon.replay.bags.writer.write_bag`.
        form: "mcap", "sqlite3" or "ros1".
        comparison: the runs.
        robot: the robot, for its gauge.

    Returns:
        The path.

    Raises:
        ReplayError: stamps that ROS cannot hold, the path exists, or the file system refuses.
    """
    log, outboxes = comparison.log, []
    others = (SMOOTHED, KNOWN_BIAS)
    base = [name for name in comparison.runs if not name.endswith(others)][-1]
    for name, one in comparison.runs.items():
        topic, frame = frame_of(name), f"{frame_of(name)}/{BASE_LINK}"
        poses = one.trajectory.pose_series
        outboxes += [
            _odometry(f"/{topic}/odom", one.trajectory, frame),
            _poses(f"/{topic}/pose", poses, rate=POSE_RATE),
            _path(f"/{topic}/path", poses),
            _transforms(poses, frame),
            _icrs(f"/{topic}/icrs", one.stamps, one.indices, robot, frame, colour_of(name)),
        ]
        if log.origin is not None:
            outboxes.append(_places(f"/{topic}/fix", one.trajectory, log.origin, frame))
        if name == base:
            outboxes.append(_transforms(poses, BASE_LINK))
    if log.truth is not None:
        truth = log.truth.poses
        outboxes += [
            _poses(f"/{TRUTH}/pose", truth),
            _path(f"/{TRUTH}/path", truth),
            _transforms(truth, f"{TRUTH}/{BASE_LINK}"),
        ]
    if log.fixes is not None and len(log.fixes.stamps):
        outboxes.append(fix_messages(FIXES_TOPIC, log.fixes))
    outboxes.append(diagnostics(comparison.runs, robot.name))
    return write_bag(path, form, [one for one in outboxes if len(one.stamps)])


def frame_of(variant: str) -> str:
    """Name of a variant in topics and frames."""
    return variant.replace("-", "_")


def _odometry(topic: str, trajectory: Trajectory, frame: str) -> Outbox:
    """nav_msgs/Odometry from odom to a frame; other axes have a variance of 1e6."""

    def packing(messages: Messages) -> Packing:
        nothing = np.diag(np.full(3, UNUSED_VARIANCE))
        twist = messages.new(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=messages.twist((0.0, 0.0, 0.0)),
            covariance=np.zeros(36),
        )
        pattern = messages.new(
            ODOMETRY,
            header=messages.header(0, ODOM),
            child_frame_id=frame,
            pose=messages.pose_with_covariance((0.0, 0.0), (0.0, 0.0, 0.0, 1.0), nothing),
            twist=twist,
        )
        numbers: dict[str, Numbers] = {
            "header.stamp": trajectory.stamps,
            **_pose_numbers("pose.pose", "position", trajectory.pose_series),
            "pose.covariance": _spatial(trajectory),
            "twist.twist.linear.x": trajectory.twists[:, 0],
            "twist.twist.linear.y": trajectory.twists[:, 1],
            "twist.twist.angular.z": trajectory.twists[:, 2],
            "twist.covariance": _planar(trajectory.twist_covariances),
        }
        return Packing(ODOMETRY, pattern, trajectory.stamps, numbers)

    return Outbox(topic, ODOMETRY, trajectory.stamps, packing=packing)


def _poses(topic: str, series: PoseSeries, *, rate: float | None = None) -> Outbox:
    """geometry_msgs/PoseStamped in odom.

    Args:
        topic: the topic.
        series: the poses.
        rate: highest rate of the messages [Hz]; None for all poses.
    """
    if rate is not None:
        series = series.rows(thinned(series.stamps, rate))

    def packing(messages: Messages) -> Packing:
        pose = messages.pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        pattern = messages.new(POSE, header=messages.header(0, ODOM), pose=pose)
        numbers = {
            "header.stamp": series.stamps,
            **_pose_numbers("pose", "position", series),
        }
        return Packing(POSE, pattern, series.stamps, numbers)

    return Outbox(topic, POSE, series.stamps, packing=packing)


def _transforms(series: PoseSeries, frame: str) -> Outbox:
    """Transforms from odom to a frame, on /tf."""
    series = series.rows(thinned(series.stamps, TF_RATE))

    def packing(messages: Messages) -> Packing:
        transform = messages.new(
            TRANSFORM,
            header=messages.header(0, ODOM),
            child_frame_id=frame,
            transform=messages.new(
                "geometry_msgs/msg/Transform",
                translation=messages.vector((0.0, 0.0, 0.0)),
                rotation=messages.quaternion((0.0, 0.0, 0.0, 1.0)),
            ),
        )
        numbers = {
            "transforms.0.header.stamp": series.stamps,
            **_pose_numbers("transforms.0.transform", "translation", series, "rotation"),
        }
        return Packing(TF, messages.new(TF, transforms=[transform]), series.stamps, numbers)

    return Outbox(TF_TOPIC, TF, series.stamps, packing=packing)


def _path(topic: str, series: PoseSeries) -> Outbox:
    """Whole path as one message at its start."""
    count = len(series.stamps)
    rows = np.unique(np.linspace(0, count - 1, min(PATH_POSES, count)).astype(int))
    series = series.rows(rows)
    stamps, columns = series.stamps, (series.positions, series.quaternions)

    def make(messages: Messages, _: int) -> Any:
        stamped = [
            messages.new(
                POSE,
                header=messages.header(stamp, ODOM),
                pose=messages.pose(pose, quaternion),
            )
            for stamp, pose, quaternion in zip(
                stamps.tolist(), *(one.tolist() for one in columns), strict=True
            )
        ]
        return messages.new(PATH, header=messages.header(stamps[0], ODOM), poses=stamped)

    return Outbox(topic, PATH, stamps[:1], make, latched=True)


def _icrs(
    topic: str, all_stamps: Stamps, indices: Floats, robot: Robot, frame: str, colour: str
) -> Outbox:
    """ICRs of both tracks as spheres joined by a line, in the robot's frame."""
    rows = thinned(all_stamps, MARKER_RATE)
    stamps = all_stamps[rows]
    icrs = icr_series(indices[rows], robot.vehicle.track_gauge)

    def packing(messages: Messages) -> Packing:
        markers = [
            _marker(messages, frame, number, kind, size, colour)
            for number, (kind, size) in enumerate(ICR_MARKERS)
        ]
        numbers: dict[str, Numbers] = {}
        for number in range(len(markers)):
            numbers[f"markers.{number}.header.stamp"] = stamps
            for point, (x, y) in enumerate(
                ((icrs.left_x, icrs.left_y), (icrs.right_x, icrs.right_y))
            ):
                numbers[f"markers.{number}.points.{point}.x"] = x
                numbers[f"markers.{number}.points.{point}.y"] = y
        return Packing(MARKERS, messages.new(MARKERS, markers=markers), stamps, numbers)

    return Outbox(topic, MARKERS, stamps, packing=packing)


def _marker(
    messages: Messages, frame: str, number: int, kind: int, size: float, colour: str
) -> Any:
    red, green, blue = (int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5))
    return messages.blank(
        MARKER,
        header=messages.header(0, frame),
        ns="icrs",
        id=number,
        type=kind,
        pose=messages.pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        scale=messages.vector((size, size, size)),
        color=messages.new("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        frame_locked=True,
        points=[messages.point((0.0, 0.0, 0.0)) for _ in range(2)],
    )


def _pose_numbers(
    path: str, place: str, series: PoseSeries, turn: str = "orientation"
) -> dict[str, Numbers]:
    places = {f"{path}.{place}.{x}": of for x, of in zip("xyz", series.positions.T, strict=True)}
    turns = zip("xyzw", series.quaternions.T, strict=True)
    return places | {f"{path}.{turn}.{x}": of for x, of in turns}


def _planar(covariances: Floats) -> Callable[[slice], Floats]:
    """Build a getter of a slice of covariances (n, 3, 3) as row-major 6x6 (m, 36)."""
    rows = np.array(PLANAR)

    def give(part: slice) -> Floats:
        some = covariances[part]
        full = np.tile(np.diag(np.full(6, UNUSED_VARIANCE)), (len(some), 1, 1))
        full[:, rows[:, None], rows] = some
        return full.reshape(-1, 36)

    return give


def _spatial(trajectory: Trajectory) -> Callable[[slice], Floats]:
    """`_planar` with the variances of z, roll and pitch, if estimated."""
    planar, sigmas = _planar(trajectory.pose_covariances), trajectory.spatial_sigmas

    def give(part: slice) -> Floats:
        full = planar(part)
        if sigmas is not None and sigmas.any():
            full[:, SPATIAL] = sigmas[part].astype(float) ** 2
        return full

    return give


def _places(topic: str, trajectory: Trajectory, origin: Origin, frame: str) -> Outbox:
    """sensor_msgs/NavSatFix, the height above the altitude of the origin."""
    rows = thinned(trajectory.stamps, PLACE_RATE)
    stamps = trajectory.stamps[rows]
    latitude, longitude = degrees(trajectory.poses[rows, :2], origin).T
    covariances = np.tile(np.diag(np.full(3, UNUSED_VARIANCE)), (len(rows), 1, 1))
    covariances[:, :2, :2] = trajectory.pose_covariances[rows][:, :2, :2]
    altitudes = np.full(len(rows), origin[2])
    if trajectory.spatial is not None and trajectory.spatial_sigmas is not None:
        altitudes += trajectory.spatial[rows, 0]
        covariances[:, 2, 2] = trajectory.spatial_sigmas[rows, 0] ** 2

    def packing(messages: Messages) -> Packing:
        pattern = messages.blank(
            NAVSATFIX,
            header=messages.header(0, frame),
            position_covariance=np.zeros(9),
            position_covariance_type=COVARIANCE_KNOWN,
        )
        numbers: dict[str, Numbers] = {
            "header.stamp": stamps,
            "latitude": latitude,
            "longitude": longitude,
            "altitude": altitudes,
            "position_covariance": covariances.reshape(-1, 9),
        }
        return Packing(NAVSATFIX, pattern, stamps, numbers)

    return Outbox(topic, NAVSATFIX, stamps, packing=packing)
