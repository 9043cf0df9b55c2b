"""Planar rigid-body geometry, and conversion of the paper's axes to REP-103.

The paper's robot frame: X right, Y forward, Z up. REP-103 `base_link`: x forward, y left, z up.
Angles are in radians, counter-clockwise about Z in both. The functions are plain arithmetic, so they
accept floats and arrays alike (and complex numbers, for complex-step differentiation).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.choices import select


def paper_to_rep103(x_paper: Any, y_paper: Any) -> tuple[Any, Any]:
    """Convert a vector from paper axes (right, forward) to REP-103 (forward, left)."""
    return y_paper, -x_paper


def rep103_to_paper(x: Any, y: Any) -> tuple[Any, Any]:
    """Convert a vector from REP-103 (forward, left) to paper axes (right, forward)."""
    return -y, x


def wrap_angle(angle: Any) -> Any:
    """Wrap an angle to [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def rotate(vectors: ArrayLike, yaw: ArrayLike) -> Floats:
    """Rotate vectors (..., 2) counter-clockwise by yaw (...) [rad]."""
    x, y = np.moveaxis(np.asarray(vectors, dtype=float), -1, 0)
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def compose(a: ArrayLike, b: ArrayLike) -> Floats:
    """Compose poses (..., 3) x, y [m], yaw [rad] in SE(2): `b` is a pose in frame `a`.

    Returns:
        (..., 3) pose `b` in the frame in which `a` is given; yaw is not wrapped.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    place = a[..., :2] + rotate(b[..., :2], a[..., 2])
    return np.concatenate([place, (a[..., 2] + b[..., 2])[..., None]], axis=-1)


def relative(a: ArrayLike, b: ArrayLike) -> Floats:
    """Pose `b` relative to pose `a`: composing `a` with it gives `b`.

    Both are (..., 3) x, y [m], yaw [rad] in the same frame. The yaw of the result (..., 3) is wrapped to
    [-pi, pi).
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    place = rotate(b[..., :2] - a[..., :2], -a[..., 2])
    return np.concatenate([place, wrap_angle(b[..., 2] - a[..., 2])[..., None]], axis=-1)


def arc_factors(angle: float) -> tuple[float, float]:
    """Return sin(a)/a and (1 - cos(a))/a, with their limits at zero.

    They convert a constant body velocity to the chord of its arc
    (the exponential map of SE(2); Sola et al., A micro Lie theory, eq. 158).
    """
    is_small = abs(angle) < 1e-4
    square = angle * angle
    divisor = select(is_small, 1.0, angle)
    return (
        float(select(is_small, 1.0 - square / 6.0, math.sin(angle) / divisor)),
        float(select(is_small, angle * (0.5 - square / 24.0), (1.0 - math.cos(angle)) / divisor)),
    )


def quaternion_to_yaw(quaternion: ArrayLike) -> Floats:
    """Yaw [rad] of unit quaternions (..., 4) in ROS order x, y, z, w."""
    x, y, z, w = np.moveaxis(np.asarray(quaternion, dtype=float), -1, 0)
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def yaw_to_quaternion(yaw: ArrayLike) -> Floats:
    """Unit quaternions (..., 4) in ROS order x, y, z, w of yaw [rad] about z."""
    half = 0.5 * np.asarray(yaw, dtype=float)
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], axis=-1)


def rpy_to_quaternion(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Floats:
    """Quaternions (..., 4) x, y, z, w of fixed-axis roll, pitch, yaw [rad]."""
    halves = 0.5 * np.stack(np.broadcast_arrays(roll, pitch, yaw))
    (c_r, c_p, c_y), (s_r, s_p, s_y) = np.cos(halves), np.sin(halves)
    return np.stack(
        [
            s_r * c_p * c_y - c_r * s_p * s_y,
            c_r * s_p * c_y + s_r * c_p * s_y,
            c_r * c_p * s_y - s_r * s_p * c_y,
            c_r * c_p * c_y + s_r * s_p * s_y,
        ],
        axis=-1,
    )


def quaternion_to_rpy(quaternion: ArrayLike) -> Floats:
    """Fixed-axis roll, pitch, yaw (..., 3) [rad] of unit quaternions (..., 4)."""
    x, y, z, w = np.moveaxis(np.asarray(quaternion, dtype=float), -1, 0)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    return np.stack([roll, pitch, quaternion_to_yaw(quaternion)], axis=-1)


def rpy_to_matrix(roll: float, pitch: float, yaw: float) -> Floats:
    """Rotation matrix (3, 3) of fixed-axis roll, pitch, yaw [rad], as in URDF and tf."""
    cr, cp, cy = np.cos([roll, pitch, yaw])
    sr, sp, sy = np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def matrix_to_rpy(rotation: Floats) -> tuple[float, float, float]:
    """Fixed-axis roll, pitch, yaw [rad] of a rotation matrix (3, 3)."""
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    return float(roll), float(pitch), float(yaw)
