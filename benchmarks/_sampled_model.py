"""A run that is drawn from the filter's own stochastic model, term by term.

What a filter believes of its errors can only be tested where all it assumes is true. Here it is: slip
and fast slip, random walks, parameters, biases, scales and sensors are drawn from the very distributions
that the filter goes by, around track speeds that are given.

This is no robot: nothing is in it that the filter does not expect. See `simulation.truth` for robots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.frames import compose
from icreckon.estimator.filter.initial_state import assumptions
from icreckon.estimator.filter.process_noise import change_density
from icreckon.estimator.log.measurements import ImuSample, Measurement, PositionFix, TrackSpeeds
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.reference.filter import process_noise
from icreckon.estimator.reference.imu import StepTwist, accelerometer, gyro
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.sensors.held_tracks import TrackRecord, take_tracks
from icreckon.estimator.sensors.imu_noise import NoiseRecord, imu_noise
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.sensors.standstill import StandstillRecord
from icreckon.estimator.sensors.step_inputs import step_inputs, track_change
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.base.sampling import EPOCH
from icreckon.simulation.truth.true_motion import exponential

# How often to draw parameters that no vehicle has before giving up.
DRAWS = 100


class Fixes(NamedTuple):
    """Position fixes: time between them [s], standard deviation of each coordinate [m]."""

    interval: float = 1.0
    position_sigma: float = 0.05


@dataclass(frozen=True)
class SampledRun:
    """A run drawn from the model.

    Attributes:
        stamps: (n,) ends of the steps; the first is the start of the run [ns].
        speeds: (n, 2) track speeds as measured, over the step that ends there [m/s].
        states: (n, SIZE) the true state at the stamps, with the fast slip of the step that ends there.
        begins: (n, SIZE) the true state as the step begins, with the same fast slip.
        twists: (n, 3) the true twist at the stamps.
        measurements: in the order in which they are to be fed.
    """

    stamps: Stamps
    speeds: Floats
    states: Floats
    begins: Floats
    twists: Floats
    measurements: list[Measurement]


class ModelSampler:
    """Draws runs from the model of one robot and filter variant.

    Args:
        robot: the robot.
        variant: the filter variant.
        settings: of the pose estimator.
        fixes: position fixes.
    """

    def __init__(
        self, robot: Robot, variant: Variant, settings: Settings, fixes: Fixes | None = None
    ) -> None:
        self._robot, self._variant = robot, variant
        self._inputs = input_settings(robot, settings)
        self._fixes = fixes or Fixes()
        model, self._mean, self._spread, self._disturbances = assumptions(robot, variant, settings)
        self._slip = self._disturbances.slip
        self._spread[s.POSE] = 0.0
        self._ekf = IcrEkf(model)
        self._imu_position = SensorModels(robot).imu_position

    def run(self, speeds: Floats, dt: float, rng: Generator) -> SampledRun:
        """A run at given track speeds.

        Args:
            speeds: (n, 2) left, right as measured, over the step that ends there [m/s]; never zero
                both, since the filter believes other things of a robot that may stand. The first are
                those before the start.
            dt: length of a step [s].
            rng: draws everything.

        Raises:
            SimulationError: speeds that are not (n, 2), or resting tracks.
        """
        if speeds.ndim != 2 or speeds.shape[1] != 2:
            raise SimulationError(f"speeds must have shape (n, 2), found {speeds.shape}")
        if not np.abs(speeds).max(axis=1).all():
            raise SimulationError("both tracks rest; the model is drawn for moving robots only")
        count = len(speeds)
        stamps = EPOCH + np.rint(np.arange(count) * dt * 1e9).astype(np.int64)
        states, begins = np.zeros((count, s.SIZE)), np.zeros((count, s.SIZE))
        twists = np.zeros((count, 3))
        x = self._draw_start(rng)
        states[0] = begins[0] = x
        twists[0] = self._twist(x, *speeds[0].tolist())
        tracks, chosen = TrackRecord(), self._inputs
        take_tracks(tracks, int(stamps[0]), *speeds[0].tolist(), chosen)
        measurements: list[Measurement] = [TrackSpeeds(int(stamps[0]), *speeds[0].tolist())]
        for k in range(1, count):
            stamp, (left, right) = int(stamps[k]), speeds[k].tolist()
            take_tracks(tracks, stamp, left, right, chosen)
            eta = self._ekf.model.steering_efficiency(x[s.PARAMETERS])
            sigma = self._disturbances.slip_sigma(tracks, eta, pushed=False)
            begin = x.copy()
            self._ekf.x = begin
            self._ekf.begin_step(dt, left, right)
            begin[s.FAST_SLIP] = self._draw_fast_slip(begin, left, right, sigma[2], dt, rng)
            measurements.append(TrackSpeeds(stamp, left, right))
            measurements.append(self._imu(begin, tracks, int(stamps[k - 1]), stamp, sigma, dt, rng))
            smooth = tracks.smooth_left, tracks.smooth_right
            walk = process_noise(self._disturbances, smooth, sigma).walk
            x = self._stepped(begin, left, right, sigma, walk, dt, rng)
            if k % max(1, round(self._fixes.interval / dt)) == 0:
                fix_sigma = self._fixes.position_sigma
                place = x[s.POSITION] + fix_sigma * rng.standard_normal(2)
                measurements.append(PositionFix(stamp, *place.tolist(), fix_sigma**2))
            begins[k], states[k] = begin, x
            twists[k] = self._twist(x, left, right)
        return SampledRun(stamps, speeds, states, begins, twists, measurements)

    def _draw_start(self, rng: Generator) -> Floats:
        for _ in range(DRAWS):
            x = np.asarray(self._mean + self._spread * rng.standard_normal(s.SIZE))
            bounds = self._ekf.model.bounds
            if (bounds[:, :-1] @ x[s.PARAMETERS] >= bounds[:, -1]).all():
                return x
        raise SimulationError(f"no parameters that a vehicle can have in {DRAWS} draws")

    def _twist(self, x: Floats, left: float, right: float, slip: Floats | None = None) -> Floats:
        self._ekf.x = x if slip is None else x.copy()
        if slip is not None:
            self._ekf.x[s.SLIP] = slip
        return self._ekf.twist_model(left, right).twist.copy()

    def _draw_fast_slip(
        self, x: Floats, left: float, right: float, sigma_w: float, dt: float, rng: Generator
    ) -> Floats:
        self._ekf.x = x
        by_speeds = self._ekf.twist_model(left, right).by_speeds
        error = self._robot.tracks.speed_noise_density
        white = math.sqrt(2.0 * self._slip.white_time) * sigma_w
        drawn = rng.standard_normal(3) / math.sqrt(dt)
        fast = error * by_speeds @ drawn[:2]
        fast[2] += white * drawn[2]
        return np.asarray(fast)

    def _stepped(
        self,
        x: Floats,
        left: float,
        right: float,
        sigma: tuple[float, float, float],
        walk: Floats,
        dt: float,
        rng: Generator,
    ) -> Floats:
        """The state after a step: slip and walks to their ends, the pose by the mean slip between."""
        ratio = dt / self._slip.time_constant
        draws = rng.standard_normal(s.SIZE)
        after = x.copy()
        after[s.SLIP] = (
            math.exp(-ratio) * x[s.SLIP]
            + np.array(sigma) * math.sqrt(-math.expm1(-2.0 * ratio)) * draws[s.SLIP]
        )
        twist = self._twist(x, left, right, 0.5 * (x[s.SLIP] + after[s.SLIP]))
        after[s.POSE] = compose(x[s.POSE], exponential(twist[None] * dt)[0])
        cos, sin = math.cos(twist[2] * dt), math.sin(twist[2] * dt)
        after[s.GRAVITY] = [[cos, sin], [-sin, cos]] @ x[s.GRAVITY]
        after += math.sqrt(dt) * walk * draws
        return after

    def _imu(
        self,
        x: Floats,
        tracks: TrackRecord,
        begun: int,
        stamp: int,
        sigma: tuple[float, float, float],
        dt: float,
        rng: Generator,
    ) -> ImuSample:
        """A sample as the filter predicts it, with noise as large as it expects."""
        self._ekf.x = x
        model = self._ekf.twist_model(tracks.left, tracks.right)
        change = track_change(step_inputs(tracks, StandstillRecord(), begun, begun, self._inputs))
        of_file = imu_noise(NoiseRecord(is_first=0), False, self._inputs)
        at = StepTwist(model, x, dt, change, of_file)
        z, _, R = gyro(0.0, at, turn=0.0)
        rate = -z.item() + rng.standard_normal() * math.sqrt(R.item())
        along = []
        imu = self._imu_position
        for axis in range(2):
            density = change_density(sigma[axis], self._disturbances.slip.time_constant)
            force = accelerometer(imu, axis, 0.0, at, x, density)
            along.append(-force.z.item() + rng.standard_normal() * math.sqrt(force.R.item()))
        rotation, scale = self._robot.imu_rotation, self._robot.imu.gyro_scale
        rates = (np.array([0.0, 0.0, scale * rate]) @ rotation).tolist()
        forces = (np.array([*along, 0.0]) @ rotation).tolist()
        return ImuSample(stamp, (rates[0], rates[1], rates[2]), (forces[0], forces[1], forces[2]))
