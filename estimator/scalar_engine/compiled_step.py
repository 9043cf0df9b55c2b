"""What a filter is made of besides its state, as the compiled step of an IMU sample wants it.

Import it inside functions only, numba takes half a second.
"""

from __future__ import annotations

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.filter.ekf import REGRESSOR_SMOOTHING
from icreckon.estimator.filter.gate import Gate
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.filter.step_engine import Verdicts
from icreckon.estimator.scalar_engine.compiled_ekf import CompiledEkf
from icreckon.estimator.scalar_engine.imu_kernel import NOT_ASKED, SlipNumbers, imu_step_entry
from icreckon.estimator.sensors.held_tracks import HeldTrackSpeeds, smoothing_share
from icreckon.estimator.sensors.sensor_models import SensorModels


class CompiledStep:
    """A step with an IMU sample at its end, at once.

    Args:
        ekf: the filter.
        disturbances: of the filter.
        sensors: of the robot.
        gyro: its gate.
        accelerometer: its gate, of the same threshold and patience.
    """

    def __init__(
        self,
        ekf: CompiledEkf,
        disturbances: Disturbances,
        sensors: SensorModels,
        gyro: Gate,
        accelerometer: Gate,
    ) -> None:
        self._ekf = ekf
        self._disturbances = disturbances
        self._gyro, self._accelerometer = gyro, accelerometer
        slip = disturbances.slip
        self._numbers = np.array(
            [
                *(getattr(slip, name) for name in SlipNumbers._fields),
                *sensors.constants,
                gyro.threshold,
                gyro.patience,
            ]
        )
        self._walks = np.stack([disturbances.bias_walk, disturbances.parameter_walk])
        self._considered = sum(1 << index for index in ekf.considered)

    def take(
        self,
        tracks: HeldTrackSpeeds,
        start: int,
        end: int,
        *,
        stands: bool,
        pushed: bool,
        interval: float,
        rate: float,
        force: float | None,
    ) -> Verdicts | None:
        """See `WholeStep`."""
        ekf = self._ekf
        numbers = ekf.numbers
        if numbers is None or ekf.clones is not None or ekf.observer is not None:
            return None
        dt = (end - start) * NANOSECOND
        ekf.begin_step(dt, *tracks.mean_speeds(start, end))
        density = self._disturbances.track_density(tracks)
        share = smoothing_share(dt, REGRESSOR_SMOOTHING)
        if ekf.regressors is None:
            ekf.regressors, share = np.zeros((3, 8)), 1.0
        verdicts = imu_step_entry(
            ekf.x,
            ekf.P,
            numbers.kind,
            numbers.constants,
            numbers.bounds,
            ekf.model.memory,
            ekf.regressors,
            share,
            self._numbers,
            self._walks,
            self._considered,
            stands,
            pushed,
            dt,
            *tracks.smooth,
            *tracks.speeds_at(start),
            *tracks.mean_speeds(start, end),
            *self._disturbances.track_densities(tracks, start, end),
            tracks.gap_density(start, end),
            *tracks.acceleration,
            tracks.acceleration_window,
            density / tracks.interval,
            tracks.age(start),
            float(interval),
            rate,
            0.0 if force is None else force,
            force is not None,
            self._gyro.rejected_in_a_row,
            self._accelerometer.rejected_in_a_row,
        )
        of_gyro, of_accelerometer = verdicts
        return Verdicts(of_gyro, of_accelerometer if of_accelerometer[0] != NOT_ASKED else None)
