"""Positions and mounting of sensors by the static transforms of a bag."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import matrix_to_rpy, rpy_to_matrix
from icreckon.estimator.log.log import Log
from icreckon.replay.bags.message_types import IMU, NAVSATFIX, TF, TF_ROS1
from icreckon.replay.estimates.imu_mounting import Mounting, forward_yaw, vertical_rate
from icreckon.replay.inspection.topic_survey import Survey
from icreckon.replay.reading.tf import TransformStream

STATIC = "tf_static"
MOST_TILT = np.radians(15.0)  # angle to gravity up to which it may be a slope [rad]
BASES = ("base_footprint", "base_link")  # frames of the robot, the first that there is


class Mount(NamedTuple):
    """Static pose of a sensor in the frame of the robot."""

    position: Floats  # (3,) [m]
    rotation: Floats  # (3, 3), from the sensor's axes to those of the robot
    source: str  # the frames, for a person


def static_mounts(surveys: Collection[Survey]) -> dict[str, Mount]:
    """Static poses of IMUs and receivers by topic, as far as the transforms show them."""
    transforms = TransformStream("frames", "tf", source="", time="recording")
    for survey in surveys:
        topic = survey.topic
        if survey.msgtype in (TF, TF_ROS1) and topic.endswith(STATIC):
            for message in survey.messages:
                transforms.add_transforms(topic, 0, message)
    links = transforms.static_links
    frames = {frame for link in links for frame in link}
    base = next((frame for name in BASES for frame in sorted(frames) if frame.endswith(name)), None)
    # Of a tree: with a loop there are as many links as frames.
    if base is None or len(links) >= len(frames):
        return {}
    mounts = {}
    for survey in surveys:
        # In a frame of the robot the driver has turned the readings, and the place is unknown.
        is_turned = survey.frame_id.strip("/") in BASES
        if survey.msgtype not in (IMU, NAVSATFIX) or is_turned:
            continue
        transforms.frames = base, survey.frame_id
        if (pose := transforms.static_pose()) is not None:
            source = f"{survey.frame_id} in {base} by /{STATIC}"
            mounts[survey.topic] = Mount(*pose, source)
    return mounts


def unplaced(surveys: Collection[Survey], mounts: Mapping[str, Mount], imu: str) -> list[str]:
    """Finding on an IMU, by its topic, whose frame the static transforms lack."""
    frames = {survey.topic: survey.frame_id.strip("/") for survey in surveys}
    has_static, frame = any(topic.endswith(STATIC) for topic in frames), frames.get(imu, "")
    if not has_static or imu in mounts or frame in ("", *BASES):
        return []
    return [f"imu: no chain of /{STATIC} leads to its frame {frame!r}"]


def with_static_yaw(mounting: Mounting, mount: Mount, log: Log) -> Mounting | None:
    """Mounting with the static transform's yaw, or all of its angles if unknown.

    None if the log contradicts the transform.
    """
    imu = log.imu
    if not mounting.up_shown_by or imu is None:
        angles = matrix_to_rpy(mount.rotation)
        return replace(mounting, rotation_rpy_deg=_degrees(angles), yaw_shown_by=STATIC)
    roll, pitch, _ = np.radians(mounting.rotation_rpy_deg)
    turn = mount.rotation @ rpy_to_matrix(roll, pitch, 0.0).T
    if turn[2, 2] < np.cos(MOST_TILT):
        return None
    yaw = float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    with_yaw = replace(mounting, rotation_rpy_deg=_degrees((roll, pitch, yaw)), yaw_shown_by=STATIC)
    if mounting.up_shown_by == "gravity" and imu.linear_acceleration is not None:
        horizontal = imu.linear_acceleration @ rpy_to_matrix(roll, pitch, yaw)[:2].T
        if forward_yaw(log.tracks, vertical_rate(imu, with_yaw), horizontal):
            return None
    return with_yaw


def contradiction(mounting: Mounting, mount: Mount) -> str:
    """Finding that a log shows another mounting than its static transform; or empty."""
    if mounting.yaw_shown_by == STATIC:
        return ""
    stated, shown = _degrees(matrix_to_rpy(mount.rotation)), mounting.rotation_rpy_deg
    by_tf, by_log = (", ".join(str(round(angle)) for angle in rpy) for rpy in (stated, shown))
    yaw = "" if mounting.yaw_shown_by else " but for its yaw"
    return f"imu: {mount.source} is turned by ({by_tf}) deg; the log shows ({by_log}) deg{yaw}: see [imu]"


def _degrees(angles: Iterable[float]) -> tuple[float, float, float]:
    x, y, z = (float(np.degrees(angle)) for angle in angles)
    return x, y, z
