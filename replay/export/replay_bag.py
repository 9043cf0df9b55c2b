"""Export of a comparison as a bag for Foxglove, RViz or PlotJuggler.

Frames are those of REP-105. A tf tree gives each frame one parent, so each variant has its own frame in
`odom`, such as `inertia_online/base_link`. `base_link` itself follows the last filter variant that was
requested, and `ground_truth/base_link` the truth.
"""

from pathlib import Path
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.motion.icr import IndexValues
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.outputs import icr_points
from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.bags import message_types as ros
from icreckon.replay.bags.messages import (
    BASE_LINK,
    ICR_MARKERS,
    ODOM,
    UNUSED_VARIANCE,
    planar_covariance,
    planar_twist,
)
from icreckon.replay.bags.writer import Format, Outbox, write_bag
from icreckon.replay.base.colours import colour_of
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.plot_series import picks
from icreckon.replay.export.log_bag import fix_messages, pose_messages
from icreckon.replay.mapping.geodesy import Origin, degrees

TRUTH = "ground_truth"
FIXES_TOPIC, TF_TOPIC = "/fixes", "/tf"
TF_RATE = 20.0  # highest rate of transforms [Hz]; odometry and truth keep all of their samples
# Highest rates of the other topics that are thinned [Hz].
POSE_RATE, MARKER_RATE, PLACE_RATE = 20.0, 5.0, 5.0
COVARIANCE_KNOWN = 3  # `position_covariance_type` of NavSatFix
PATH_POSES = 1000  # most poses of a path, which is one message
SPATIAL_VARIANCES = [14, 21, 28]  # places of z, roll and pitch in a row-major 6x6 covariance


def write_replay_bag(path: Path, form: Format, comparison: Comparison, robot: Robot) -> Path:
    """Write the runs of a comparison as a bag.

    It holds, with `-` in names of variants written as `_`: `/<variant>/odom` (nav_msgs/Odometry),
    `/<variant>/pose` (geometry_msgs/PoseStamped, for viewers that draw no odometry),
    `/<variant>/path` (nav_msgs/Path), `/<variant>/icrs` (visualization_msgs/MarkerArray),
    `/<variant>/fix` (sensor_msgs/NavSatFix) if the log has an origin on the globe, `/tf`, `/fixes` that
    were used, `/ground_truth/pose` and `/ground_truth/path`.

    Raises:
        ReplayError: stamps that ROS cannot hold, the path exists, or the file system refuses.
    """
    log, outboxes = comparison.log, []
    main_run = [name for name in comparison.runs if not name.endswith(SMOOTHED)][-1]
    for name, run in comparison.runs.items():
        topic, poses = name.replace("-", "_"), run.trajectory.pose_series
        frame = f"{topic}/{BASE_LINK}"
        outboxes += [
            _odometry_messages(f"/{topic}/odom", run.trajectory, frame),
            pose_messages(f"/{topic}/pose", poses.rows(thinned(poses.stamps, POSE_RATE))),
            _path_message(f"/{topic}/path", poses),
            _transforms(poses, frame),
            _icr_markers(f"/{topic}/icrs", run.stamps, run.indices, robot, frame, colour_of(name)),
        ]
        if log.origin is not None:
            outboxes.append(_globe_messages(f"/{topic}/fix", run.trajectory, log.origin, frame))
        if name == main_run:
            outboxes.append(_transforms(poses, BASE_LINK))
    if log.truth is not None:
        # Bags have no stamps below zero, where the lag of a truth may move its first ones.
        truth = log.truth.poses.rows(log.truth.poses.stamps >= 0)
        outboxes += [
            pose_messages(f"/{TRUTH}/pose", truth),
            _path_message(f"/{TRUTH}/path", truth),
            _transforms(truth, f"{TRUTH}/{BASE_LINK}"),
        ]
    if log.fixes is not None and len(log.fixes.stamps):
        outboxes.append(fix_messages(FIXES_TOPIC, log.fixes))
    return write_bag(path, form, [outbox for outbox in outboxes if len(outbox.stamps)])


def _odometry_messages(topic: str, trajectory: Trajectory, frame: str) -> Outbox:
    """nav_msgs/Odometry: poses of a frame in odom, its twists in that frame."""
    series, sigmas = trajectory.pose_series, trajectory.spatial_sigmas

    def fields(stamp: int, *row: Floats) -> dict[str, Any]:
        position, quaternion, covariance, twist, twist_covariance, *spatial_variances = row
        pose_covariance = planar_covariance(covariance)
        if spatial_variances:
            (pose_covariance[SPATIAL_VARIANCES],) = spatial_variances
        return {
            "header": (stamp, ODOM),
            "child_frame_id": frame,
            "pose": ((position, quaternion), pose_covariance),
            "twist": (planar_twist(twist), planar_covariance(twist_covariance)),
        }

    columns: tuple[Floats, ...] = series.positions, series.quaternions, trajectory.pose_covariances
    columns += trajectory.twists, trajectory.twist_covariances
    # Only runs in three dimensions estimate z, roll and pitch.
    if sigmas is not None and sigmas.any():
        columns += (sigmas.astype(float) ** 2,)
    return Outbox(topic, ros.ODOMETRY, trajectory.stamps, fields, columns)


def _transforms(series: PoseSeries, frame: str) -> Outbox:
    """Transforms of a frame in odom on /tf, at most `TF_RATE` a second."""
    series = series.rows(thinned(series.stamps, TF_RATE))

    def fields(stamp: int, *pose: Floats) -> dict[str, Any]:
        return {"transforms": [((stamp, ODOM), frame, pose)]}

    return Outbox(TF_TOPIC, ros.TF, series.stamps, fields, (series.positions, series.quaternions))


def _path_message(topic: str, series: PoseSeries) -> Outbox:
    """Path of at most `PATH_POSES` poses, as one latched message with the first stamp."""
    poses = pose_messages(topic, series.rows(picks(len(series.stamps), PATH_POSES)))

    def fields(stamp: int) -> dict[str, Any]:
        rows = zip(poses.stamps, *poses.columns, strict=True)
        return {"header": (stamp, ODOM), "poses": [poses.fields(*row) for row in rows]}

    return Outbox(topic, ros.PATH, poses.stamps[:1], fields, latched=True)


def _icr_markers(
    topic: str, all_stamps: Stamps, indices: Floats, robot: Robot, frame: str, colour: str
) -> Outbox:
    """ICRs of both tracks as spheres joined by a line, in the robot's frame."""
    # `indices` (n, 3) are zeta, epsilon [m] and eta at the stamps; the colour is of the form "#rrggbb".
    rows = thinned(all_stamps, MARKER_RATE)
    stamps = all_stamps[rows]
    icrs = icr_points(IndexValues(*indices[rows].T), robot.vehicle.track_gauge)
    red, green, blue = (part / 255.0 for part in bytes.fromhex(colour.removeprefix("#")))
    # At the height of the frame's origin.
    left, right = (np.column_stack([*point, np.zeros(len(rows))]) for point in icrs)

    def fields(stamp: int, left: Floats, right: Floats) -> dict[str, Any]:
        markers = [
            {
                "header": (stamp, frame),
                "ns": "icrs",
                "id": number,
                "type": kind,
                "pose": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
                "scale": (size, size, size),
                "color": (red, green, blue, 1.0),
                "frame_locked": True,
                "points": [left, right],
            }
            for number, (kind, size) in enumerate(ICR_MARKERS)
        ]
        return {"markers": markers}

    return Outbox(topic, ros.MARKERS, stamps, fields, (left, right))


def _globe_messages(topic: str, trajectory: Trajectory, origin: Origin, frame: str) -> Outbox:
    """Positions of a frame as sensor_msgs/NavSatFix, at most `PLACE_RATE` a second."""
    # The altitude is that of the origin, plus the estimated height of runs in three dimensions.
    rows = thinned(trajectory.stamps, PLACE_RATE)
    stamps = trajectory.stamps[rows]
    latitude, longitude = degrees(trajectory.poses[rows, :2], origin).T
    # East, north, up.
    covariances = np.tile(np.diag(np.full(3, UNUSED_VARIANCE)), (len(rows), 1, 1))
    covariances[:, :2, :2] = trajectory.pose_covariances[rows][:, :2, :2]
    _latitude, _longitude, altitude = origin
    altitudes = np.full(len(rows), altitude)
    if trajectory.spatial is not None and trajectory.spatial_sigmas is not None:
        altitudes += trajectory.spatial[rows, 0]
        covariances[:, 2, 2] = trajectory.spatial_sigmas[rows, 0] ** 2

    def fields(stamp: int, *place: Any) -> dict[str, Any]:
        latitude, longitude, altitude, covariance = place
        return {
            "header": (stamp, frame),
            "latitude": latitude,
            "longitude": longitude,
            "altitude": altitude,
            "position_covariance": covariance.ravel(),
            "position_covariance_type": COVARIANCE_KNOWN,
        }

    columns = latitude, longitude, altitudes, covariances
    return Outbox(topic, ros.NAVSATFIX, stamps, fields, columns)


def thinned(stamps: Stamps, rate: float) -> Any:
    """Select rows (m,) of stamps (n,) [ns]: the first of each slot of 1 / `rate` [Hz]."""
    if not len(stamps):
        return np.zeros(0, int)
    # The margin keeps stamps at the beginning of a slot in it, in spite of rounding.
    slots = np.floor((stamps - stamps[0]) * NANOSECOND * rate + 1e-6).astype(np.int64)
    return np.flatnonzero(np.diff(slots, prepend=-1))
