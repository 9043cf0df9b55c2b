"""Message factory with one interface for ROS 1 and ROS 2."""

from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from icreckon.estimator.base.array_types import Floats
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.message_types import TF

UNUSED_VARIANCE = 1e6  # variance of axes that are not estimated; programs invert the matrix

ODOM, BASE_LINK, IMU_LINK = "odom", "base_link", "imu_link"
PLANAR = (0, 1, 5)  # rows of x, y and yaw in a 6x6 covariance of ROS: x, y, z, roll, pitch, yaw
PLANAR_BLOCK = np.ix_(PLANAR, PLANAR)  # index of the 3x3 block of x, y and yaw in a 6x6 covariance
NOT_ESTIMATED = np.diag(np.full(6, UNUSED_VARIANCE))  # 6x6 covariance without estimates
ICR_MARKERS = ((7, 0.08), (4, 0.015))
"""Marker types and sizes [m] of the ICRs: SPHERE_LIST of both, LINE_STRIP between them."""

TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
"""Definition of tf2_msgs/TFMessage, which is not among the ROS 1 types of rosbags."""
HEADER = "std_msgs/msg/Header"


def planar_covariance(covariance: Floats) -> Floats:
    """Expand a covariance (3, 3) of x, y, yaw to a row-major 6x6 one (36,).

    The other axes get `UNUSED_VARIANCE`. The function also expands those of twists v_x, v_y, w.
    """
    full = NOT_ESTIMATED.copy()
    full[PLANAR_BLOCK] = covariance
    return full.ravel()


def planar_twist(twist: Any) -> tuple[Any, Any]:
    """Linear and angular part of a twist v_x, v_y [m/s], w [rad/s] of the body."""
    v_x, v_y, w = twist
    return (v_x, v_y, 0.0), (0.0, 0.0, w)


def six_rows(covariance: Floats) -> Floats:
    """Flatten a covariance (6, 6) to (36,); NaN variances are `UNUSED_VARIANCE`."""
    full, is_unknown = np.nan_to_num(covariance), np.isnan(covariance.diagonal())
    full[is_unknown, is_unknown] = UNUSED_VARIANCE
    return full.ravel()


class Messages:
    """Factory and serialiser of the messages of a ROS version."""

    def __init__(self, *, ros1: bool) -> None:
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if TF not in self.store.types:
            self.store.register(get_types_from_msg(TF_DEFINITION, TF))
        self.serialize = self.store.serialize_ros1 if ros1 else self.store.serialize_cdr

    def new(self, msgtype: str, **fields: Any) -> Any:
        """Make a message from some fields; the others are zero or empty.

        A field that is a message, or a list of these, may have a dictionary of fields in place of each,
        or the values of all its fields: (x, y, z) for a vector, (position, quaternion) for a pose. For a
        header it is (stamp [ns], frame).
        """
        _constants, definitions = self.store.fielddefs[msgtype]
        for name, (kind, definition) in definitions:
            if name in fields:
                fields[name] = self._filled(kind.name, definition, fields[name])
            else:
                fields[name] = self._empty_value(kind.name, definition)
        return self.store.types[msgtype](**fields)

    def _filled(self, kind: str, definition: Any, value: Any) -> Any:
        """Value of a field with its messages made; arguments as of `_empty_value`."""
        if kind == "NAME" and isinstance(value, tuple | np.ndarray):
            if definition == HEADER:
                stamp, frame = value
                # In ROS 1 a header has a number, too.
                return self.new(HEADER, stamp=divmod(int(stamp), NANOSECONDS), frame_id=frame)
            _constants, fields = self.store.fielddefs[definition]
            value = dict(zip([name for name, _ in fields], value, strict=True))
        if kind == "NAME" and isinstance(value, dict):
            return self.new(definition, **value)
        if kind in ("ARRAY", "SEQUENCE") and isinstance(value, list):
            (element_kind, element), _length = definition
            return [self._filled(element_kind.name, element, one) for one in value]
        return value

    def _empty_value(self, kind: str, definition: Any) -> Any:
        """Zero or empty value of a field by its definition in rosbags.

        That is (type, length) for numbers and texts ("BASE"), the type's name for a message ("NAME"), and
        (kind and definition of an element, length) for arrays and sequences.
        """
        if kind == "BASE":
            type_name, _ = definition
            return {"string": "", "bool": False}.get(type_name, 0)
        if kind == "NAME":
            return self.new(definition)
        (element_kind, element), length = definition
        if element_kind.name == "BASE" and element[0] != "string":
            return np.zeros(length, element[0])
        return [self._empty_value(element_kind.name, element) for _ in range(length)]
