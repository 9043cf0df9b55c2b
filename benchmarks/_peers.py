"""Dead reckoning with what people use: plain integration, filterpy's EKF, GTSAM's preintegrated factors.

All know what the robot file knows: radii, effective track, mounting, scale and bias of the gyro, latency.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from typing import Any, NamedTuple, Protocol

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import compose
from icreckon.estimator.log.measurements import ImuSample, Measurement, TrackSpeeds
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors.sensor_models import SensorModels

# Time at rest after which the gyro shows its bias, as all of these have it from somebody [s].
RESTS = 1.0


class Noise(NamedTuple):
    """Error densities of the motion: along the path [m/√s], and of the yaw [rad/√s]."""

    way: float
    yaw: float

    def scaled(self, variance: float) -> Noise:
        """Noise with so many times the variance."""
        factor = math.sqrt(variance)
        return Noise(factor * self.way, factor * self.yaw)


class Peer(Protocol):
    """Dead reckoning of somebody else."""

    @property
    def pose(self) -> Floats:
        """(3,) pose: x, y [m], yaw [rad]."""

    @property
    def pose_covariance(self) -> Floats:
        """(3, 3) covariance of the pose; NaN if it has none."""

    def step(self, dt: float, speed: float, rate: float, *, rests: bool) -> None:
        """Move by a sample of the IMU.

        Args:
            dt: time since the last one [s].
            speed: mean speed of the tracks [m/s].
            rate: yaw rate of the gyro, with its bias [rad/s].
            rests: whether the tracks have been at rest for `RESTS`.
        """

    def restarted(self) -> Peer:
        """Twin at the origin with what was learnt."""


class Integration:
    """Wheels and gyro: ten lines that everybody has written."""

    def __init__(self, bias: float) -> None:
        self.pose, self._bias, self._rest = np.zeros(3), bias, (0.0, 0.0)

    @property
    def pose_covariance(self) -> Floats:
        """(3, 3) NaN: there is none."""
        return np.full((3, 3), np.nan)

    def step(self, dt: float, speed: float, rate: float, *, rests: bool) -> None:
        """Move along an arc; at rest the mean rate is the bias."""
        if rests:
            total, time = self._rest
            self._rest = total + rate * dt, time + dt
            self._bias = self._rest[0] / self._rest[1]
            return
        self._rest = 0.0, 0.0
        turn = (rate - self._bias) * dt
        self.pose = compose(self.pose, arc(speed * dt, turn))

    def restarted(self) -> Integration:
        """Twin at the origin."""
        return Integration(self._bias)


class FilterpyEkf:
    """filterpy's EKF of x, y, yaw, speed, yaw rate and gyro bias, as robot_localization has them.

    The tracks measure the speed, the gyro the yaw rate; at rest both are zero.
    """

    def __init__(self, bias: float, bias_sigma: float, noise: Noise, gyro_density: float) -> None:
        self._noise, self._gyro = noise, gyro_density
        self._ekf = ExtendedKalmanFilter(dim_x=6, dim_z=1)
        self._ekf.x = np.array([0.0, 0.0, 0.0, 0.0, 0.0, bias])
        self._ekf.P = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, bias_sigma**2])

    @property
    def pose(self) -> Floats:
        """(3,) pose."""
        return np.asarray(self._ekf.x[:3])

    @property
    def pose_covariance(self) -> Floats:
        """(3, 3) its covariance."""
        return np.asarray(self._ekf.P[:3, :3])

    def step(self, dt: float, speed: float, rate: float, *, rests: bool) -> None:
        """Update speed and yaw rate by tracks and gyro, and move with them."""
        ekf, moving = self._ekf, 0.0 if rests else 1.0
        # Both may have changed at once.
        ekf.P = ekf.P + np.diag([0.0, 0.0, 0.0, 25.0, 100.0, 1e-12]) * dt
        self._measure(speed, [0, 0, 0, 1, 0, 0], 1e-4)
        self._measure(rate, [0, 0, 0, 0, 1, 1], self._gyro / dt)
        if rests:
            self._measure(0.0, [0, 0, 0, 0, 1, 0], 1e-8)
        yaw, v = ekf.x[2] + 0.5 * ekf.x[4] * dt, ekf.x[3]
        cos, sin = math.cos(yaw), math.sin(yaw)
        F = np.eye(6)
        F[0, 2:5] = -v * sin * dt, cos * dt, -0.5 * v * sin * dt * dt
        F[1, 2:5] = v * cos * dt, sin * dt, 0.5 * v * cos * dt * dt
        F[2, 4] = dt
        ekf.x = ekf.x + np.array([v * cos, v * sin, ekf.x[4], 0.0, 0.0, 0.0]) * dt
        of_pose = [moving * self._noise.way**2] * 2 + [moving * self._noise.yaw**2, 0.0, 0.0, 0.0]
        ekf.P = F @ ekf.P @ F.T + np.diag(of_pose) * dt

    def _measure(self, z: float, row: Sequence[float], variance: float) -> None:
        H = np.array([row], dtype=float)
        self._ekf.update(np.array([z]), lambda _: H, lambda x: H @ x, R=np.array([[variance]]))

    def restarted(self) -> FilterpyEkf:
        """Twin at the origin, with speed, yaw rate and bias."""
        twin = deepcopy(self)
        twin._ekf.x[:3] = 0.0
        twin._ekf.P[:3], twin._ekf.P[:, :3] = 0.0, 0.0
        return twin


class GtsamSmoother:
    """GTSAM: wheels and gyro, preintegrated between keyframes, in a fixed-lag smoother.

    A factor between two poses and the gyro's bias has the motion at the bias of its first keyframe, and
    its derivative by the bias. At rest the gyro measures the bias.
    """

    KEYFRAME, LAG = 0.2, 2.0

    def __init__(self, bias: float, bias_sigma: float, noise: Noise, gyro_density: float) -> None:
        import gtsam

        self._gtsam, self._noise, self._gyro = gtsam, noise, gyro_density
        # Cholesky, the default, fails on some of the logs.
        parameters = gtsam.ISAM2Params()
        parameters.setFactorization("QR")
        self._smoother = gtsam.IncrementalFixedLagSmoother(self.LAG, parameters)
        self._key, self._time, self._bias, self._bias_sigma = 0, 0.0, bias, bias_sigma
        self._at_key, self._graph = np.zeros(3), gtsam.NonlinearFactorGraph()
        self._values, self._stamps = gtsam.Values(), {}
        self._covariance: Floats | None = np.zeros((3, 3))
        sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-4))
        self._graph.add(gtsam.PriorFactorPose2(self._x(0), gtsam.Pose2(), sigmas))
        self._graph.add(
            gtsam.PriorFactorDouble(
                self._b(0), bias, gtsam.noiseModel.Isotropic.Sigma(1, bias_sigma)
            )
        )
        self._insert(np.zeros(3))
        self._solve()
        self._begin()

    def _x(self, key: int) -> int:
        return int(self._gtsam.symbol("x", key))

    def _b(self, key: int) -> int:
        return int(self._gtsam.symbol("b", key))

    def _insert(self, pose: Floats) -> None:
        self._values.insert(self._x(self._key), self._gtsam.Pose2(*pose))
        self._values.insert(self._b(self._key), self._bias)
        for name in (self._x(self._key), self._b(self._key)):
            self._stamps[name] = self._time

    def _begin(self) -> None:
        """Begin a keyframe's preintegration."""
        self._motion, self._by_bias, self._dt = np.zeros(3), np.zeros(3), 0.0
        self._spread, self._rest, self._moves = np.zeros((3, 3)), 0.0, False

    @property
    def pose(self) -> Floats:
        """(3,) pose."""
        return compose(self._at_key, self._motion)

    @property
    def pose_covariance(self) -> Floats:
        """(3, 3) its covariance at the newest keyframe, in the axes of the world."""
        if self._covariance is None:
            local = self._smoother.marginalCovariance(self._x(self._key))
            turn = np.eye(3)
            yaw = self._at_key[2]
            turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
            self._covariance = turn @ local @ turn.T
        return self._covariance

    def step(self, dt: float, speed: float, rate: float, *, rests: bool) -> None:
        """Preintegrate; at the end of a keyframe add its factors."""
        turn = 0.0 if rests else (rate - self._bias) * dt
        yaw = self._motion[2]
        way = speed * dt
        if not rests:
            # The yaw changes by -dt for each rad/s of bias, and the way turns with it.
            side = np.array([-math.sin(yaw), math.cos(yaw)]) * way
            self._by_bias[:2] += side * self._by_bias[2]
            self._by_bias[2] -= dt
            lever = np.eye(3)
            lever[:2, 2] = side
            self._spread = lever @ self._spread @ lever.T
            self._spread += (
                np.diag([self._noise.way**2, self._noise.way**2, self._noise.yaw**2 + self._gyro])
                * dt
            )
            self._moves = True
        self._motion = compose(self._motion, arc(way, turn))
        self._rest += rate * dt if rests else 0.0
        self._dt += dt
        self._time += dt
        if self._dt >= self.KEYFRAME:
            self._add(rests=rests and not self._moves)

    def _add(self, *, rests: bool) -> None:
        gtsam, before = self._gtsam, self._key
        pose, at_bias, motion, by_bias = self.pose, self._bias, self._motion, self._by_bias
        self._key += 1
        self._insert(pose)
        names = [self._x(before), self._x(self._key), self._b(before)]
        sigmas = np.sqrt(np.diagonal(self._spread) + 1e-10)

        def error(_: Any, values: Any, jacobians: Any) -> Floats:
            first, second = values.atPose2(names[0]), values.atPose2(names[1])
            off = values.atDouble(names[2]) - at_bias
            expected = gtsam.Pose2(*(motion + by_bias * off))
            by_first, by_second = np.zeros((3, 3), order="F"), np.zeros((3, 3), order="F")
            between = first.between(second, by_first, by_second)
            if jacobians is not None:
                jacobians[0], jacobians[1] = by_first, by_second
                turned = expected.rotation().unrotate(by_bias[:2])
                jacobians[2] = -np.array([[*turned, by_bias[2]]]).T
            return np.asarray(expected.localCoordinates(between))

        model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        self._graph.add(gtsam.CustomFactor(model, names, error))
        walk = gtsam.noiseModel.Isotropic.Sigma(1, 1e-5)
        pair = (self._b(before), self._b(self._key))
        self._graph.add(gtsam.BetweenFactorDouble(*pair, 0.0, walk))
        if rests:
            sigma = math.sqrt(self._gyro / self._dt)
            shown = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
            mean = self._rest / self._dt
            self._graph.add(gtsam.PriorFactorDouble(self._b(self._key), mean, shown))
        self._solve()
        self._begin()

    def _solve(self) -> None:
        gtsam = self._gtsam
        self._smoother.update(self._graph, self._values, self._stamps)
        self._graph, self._values, self._stamps = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
        found = self._smoother.calculateEstimate()
        pose = found.atPose2(self._x(self._key))
        turned = self._at_key[2] + self._motion[2] if self._key else 0.0
        yaw = turned + math.remainder(pose.theta() - turned, 2.0 * math.pi)
        self._at_key = np.array([pose.x(), pose.y(), yaw])
        self._bias, self._covariance = found.atDouble(self._b(self._key)), None

    def restarted(self) -> GtsamSmoother:
        """Twin at the origin, with the bias."""
        variance = self._smoother.marginalCovariance(self._b(self._key)).item()
        return GtsamSmoother(self._bias, math.sqrt(variance), self._noise, self._gyro)


class Motion(NamedTuple):
    """Motion since a mark, as `PoseEstimator.relative_motion` has it."""

    pose: Floats
    covariance: Floats
    to_stamp: int


class PeerEstimator:
    """A peer fed as a `PoseEstimator` is, with marks.

    Args:
        peer: the peer.
        robot: the robot.
    """

    def __init__(self, peer: Peer, robot: Robot) -> None:
        self._peer, self._sensors = peer, SensorModels(robot)
        self._radii = 1.0 - 0.5 * robot.tracks.difference, 1.0 + 0.5 * robot.tracks.difference
        self._speed, self._at_rest_since, self._newest = 0.0, 0, 0
        self._heard = False
        self._twins: dict[int, Peer] = {}
        self.stamp: int | None = None

    @property
    def pose(self) -> Floats:
        """(3,) pose."""
        return self._peer.pose

    @property
    def marks(self) -> tuple[int, ...]:
        """Stamps that are marked."""
        return tuple(self._twins)

    def feed(self, m: Measurement) -> bool:
        """Take a track speed or a sample of the IMU."""
        if isinstance(m, TrackSpeeds):
            left, right = self._radii
            self._speed, self._heard = 0.5 * (left * m.left + right * m.right), True
            if m.left or m.right or not self._at_rest_since:
                self._at_rest_since = m.stamp
        elif isinstance(m, ImuSample) and self._heard:
            dt = (m.stamp - (self.stamp or m.stamp)) * NANOSECOND
            self.stamp = m.stamp
            if not 0.0 < dt < 1.0:
                return False
            rests = (m.stamp - self._at_rest_since) * NANOSECOND > RESTS
            rate = float(self._sensors.yaw_rates(np.array(m.angular_velocity)))
            for one in (self._peer, *self._twins.values()):
                one.step(dt, self._speed, rate, rests=rests)
        return True

    def mark(self, stamp: int) -> int:
        """Remember the present pose."""
        self._twins[stamp] = self._peer.restarted()
        return stamp

    def forget(self, stamp: int) -> None:
        """Forget a mark."""
        del self._twins[stamp]

    def relative_motion(self, stamp: int) -> Motion:
        """Motion since a mark."""
        twin = self._twins[stamp]
        return Motion(twin.pose.copy(), twin.pose_covariance.copy(), self.stamp or 0)


def arc(way: float, turn: float) -> Floats:
    """Pose after an arc of a length [m] and an angle [rad]."""
    half = 0.5 * turn
    chord = way * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    return np.array([chord * math.cos(half), chord * math.sin(half), turn])
