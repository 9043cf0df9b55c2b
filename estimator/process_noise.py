"""What disturbs the motion: slip, errors of the track speeds, and random walks."""

from __future__ import annotations

import numpy as np

from estimator import state as s
from estimator.ekf import ProcessNoise
from estimator.frames import Floats
from estimator.measurements import Vector3
from estimator.robot import Robot, Slip
from estimator.slip import slip_components
from estimator.track_speeds import HeldTrackSpeeds
from estimator.variants import Adaptation

# How fast a robot may turn whose tracks are at rest, unless it is known to stand [rad/s].
PUSHED_W = 0.3
# The random walk of the parameters runs at its full rate from this difference of track speeds on [m/s].
FULL_TURNING = 0.1
# How fast the robot may begin to move sideways in a gap, as a share of how fast forward.
SIDEWAYS_IN_GAP = 0.1


class Disturbances:
    """The process noise of one robot and filter variant.

    Args:
        robot: the robot.
        slip: of the variant.
        parameter_sigmas: (8,) standard deviations of the parameters at the start.
        adaptation: of the variant.
    """

    def __init__(
        self, robot: Robot, slip: Slip, parameter_sigmas: Floats, adaptation: Adaptation
    ) -> None:
        self._slip = slip
        self._track_gauge = robot.vehicle.track_gauge
        self._track_density = robot.tracks.speed_noise_density**2
        self._gap_share = np.array([1.0, SIDEWAYS_IN_GAP, 2.0 / self._track_gauge])
        self._bias_walk = np.zeros(s.SIZE)
        self._bias_walk[s.GYRO_BIAS] = robot.imu.gyro_bias_walk
        self._bias_walk[s.ACCELEROMETER_BIAS] = robot.imu.accelerometer_bias_walk
        self._parameter_walk = np.zeros(s.SIZE)
        self._parameter_walk[s.PARAMETERS] = parameter_sigmas * adaptation.walk

    @property
    def bias_walk(self) -> Floats:
        """(SIZE,) random walk of the biases, zero elsewhere, per √s."""
        return self._bias_walk

    def slip_sigma(self, tracks: HeldTrackSpeeds, eta0: float, *, pushed: bool) -> Vector3:
        """Standard deviation of the slip at the present track speeds [m/s, m/s, rad/s].

        Args:
            tracks: the track speeds.
            eta0: steering efficiency index at no inertia.
            pushed: whether the robot may be turning with its tracks at rest.
        """
        gauge = self._track_gauge * max(1.0, eta0)
        forward, left, turning = slip_components(tracks.left, tracks.right, self._slip, gauge)
        return forward, left, PUSHED_W if pushed else turning

    def sideways_density(self, sigma: Vector3) -> float:
        """Density of the change of the sideways slip [m²/s³] at a `slip_sigma`."""
        return 2.0 * sigma[1] ** 2 / self._slip.time_constant

    def track_density(self, tracks: HeldTrackSpeeds) -> float:
        """Density of the error of each track's speed [m²/s]."""
        return 0.0 if tracks.stopped else self._track_density

    def fast_slip_density(
        self, tracks: HeldTrackSpeeds, by_speeds: Floats, sigma: Vector3, start: int, end: int
    ) -> Floats:
        """(3, 3) density of the fast slip between two stamps [ns].

        It is the error of the track speeds, the white part of the slip, and what the track speeds may
        have changed by while they are too old to be trusted.

        Args:
            tracks: the track speeds.
            by_speeds: (3, 2) derivative of the twist by them.
            sigma: of the slip, see `slip_sigma`.
            start: of the step.
            end: of the step.
        """
        density: Floats = self.track_density(tracks) * by_speeds.dot(by_speeds.T)
        density[2, 2] += 2.0 * self._slip.white_time * sigma[2] ** 2
        gap = tracks.gap_density(start, end)
        if gap > 0.0:
            density += np.diag(gap * self._gap_share**2)
        return density

    def of_step(self, tracks: HeldTrackSpeeds, sigma: Vector3) -> ProcessNoise:
        """The noise of a step at a `slip_sigma`.

        Parameters wander only as far as the motion can show them, from not at all (straight, standing)
        to their full rate.
        """
        turning = min(1.0, abs(tracks.right - tracks.left) / FULL_TURNING)
        walk = self._bias_walk + self._parameter_walk * turning
        return ProcessNoise(np.array(sigma), self._slip.time_constant, walk)
