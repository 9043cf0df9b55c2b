"""Message factory with one interface for ROS 1 and ROS 2."""

from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from icreckon.estimator.base.array_types import Floats
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.message_types import TF

UNUSED_VARIANCE = 1e6
"""Variance of axes that are not estimated: finite, so that other programs can invert the matrix."""

ODOM, BASE_LINK, IMU_LINK = "odom", "base_link", "imu_link"
PLANAR = (0, 1, 5)
"""x, y and yaw among the rows and columns of a 6x6 covariance."""
PLANAR_BLOCK = np.ix_(PLANAR, PLANAR)
"""The part of a 6x6 covariance that is that of x, y and yaw."""
NOT_ESTIMATED = np.diag(np.full(6, UNUSED_VARIANCE))
"""6x6 covariance of a pose of which nothing is estimated."""
ICR_MARKERS = ((7, 0.08), (4, 0.015))
"""Marker types and sizes [m] of the ICRs: SPHERE_LIST of both, LINE_STRIP between them."""

TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
"""Definition of tf2_msgs/TFMessage, which is not among the ROS 1 types of rosbags."""


def planar_covariance(covariance: Floats) -> Floats:
    """Expand a (3, 3) covariance of x, y, yaw to a row-major 6x6 one (36,)."""
    full = NOT_ESTIMATED.copy()
    full[PLANAR_BLOCK] = covariance
    return full.ravel()


def six_rows(covariance: Floats) -> Floats:
    """Row-major covariance (36,) of a (6, 6) one; NaN is not estimated."""
    full, unknown = np.nan_to_num(covariance), np.isnan(covariance.diagonal())
    full[unknown, unknown] = UNUSED_VARIANCE
    return full.ravel()


class Messages:
    """Factory and serialiser of the messages of a ROS version."""

    def __init__(self, *, ros1: bool) -> None:
        store = _store(ros1=ros1)
        self.store = store
        self.ros1 = ros1
        self.serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
        self._sequence = {"seq": 0} if ros1 else {}

    def new(self, msgtype: str, **fields: Any) -> Any:
        """Make a message from all its fields."""
        return self.store.types[msgtype](**fields)

    def header(self, stamp: int, frame_id: str) -> Any:
        """std_msgs/Header of a stamp [ns]."""
        seconds, nanoseconds = divmod(int(stamp), NANOSECONDS)
        time = self.new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self.new("std_msgs/msg/Header", **self._sequence, stamp=time, frame_id=frame_id)

    def vector(self, xyz: Any) -> Any:
        """geometry_msgs/Vector3."""
        x, y, z = xyz
        return self.new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def point(self, xyz: Any) -> Any:
        """geometry_msgs/Point."""
        x, y, z = xyz
        return self.new("geometry_msgs/msg/Point", x=float(x), y=float(y), z=float(z))

    def quaternion(self, xyzw: Any) -> Any:
        """geometry_msgs/Quaternion."""
        x, y, z, w = (float(part) for part in xyzw)
        return self.new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, place: Any, quaternion: Any) -> Any:
        """geometry_msgs/Pose at x, y, z."""
        return self.new(
            "geometry_msgs/msg/Pose",
            position=self.point(place),
            orientation=self.quaternion(quaternion),
        )

    def pose_with_covariance(self, place: Any, quaternion: Any, covariance: Floats) -> Any:
        """geometry_msgs/PoseWithCovariance of a row-major covariance (36,)."""
        return self.new(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=self.pose(place, quaternion),
            covariance=covariance,
        )

    def twist(self, twist: Any) -> Any:
        """geometry_msgs/Twist of v_x, v_y, w."""
        v_x, v_y, w = twist
        return self.new(
            "geometry_msgs/msg/Twist",
            linear=self.vector((v_x, v_y, 0.0)),
            angular=self.vector((0.0, 0.0, w)),
        )

    def twist_with_covariance(self, twist: Any, covariance: Floats) -> Any:
        """geometry_msgs/TwistWithCovariance of v_x, v_y, w."""
        return self.new(
            "geometry_msgs/msg/TwistWithCovariance", twist=self.twist(twist), covariance=covariance
        )

    def blank(self, msgtype: str, **fields: Any) -> Any:
        """Make a message from some fields; the others are zero or empty."""
        for name, (kind, spec) in self.store.fielddefs[msgtype][1]:
            if name not in fields:
                fields[name] = self._nothing(kind.name, spec)
        return self.new(msgtype, **fields)

    def _nothing(self, kind: str, spec: Any) -> Any:
        match kind:
            case "BASE":
                return {"string": "", "bool": False}.get(spec[0], 0)
            case "NAME":
                return self.blank(spec)
            case _:
                (inner, inner_spec), length = spec
                if inner.name == "BASE" and inner_spec[0] != "string":
                    return np.zeros(length, inner_spec[0])
                return [self._nothing(inner.name, inner_spec) for _ in range(length)]


def _store(*, ros1: bool) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if TF not in store.types:
        store.register(get_types_from_msg(TF_DEFINITION, TF))
    return store
