"""Step engine: what a filter asks for its algebra and, if there is one, for a whole step at once."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.filter.gate import Gate
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.sensors.held_tracks import HeldTrackSpeeds
from icreckon.estimator.sensors.sensor_models import SensorModels

# A verdict, see `estimator.filter.gate`; the residual, the variance that it should have, and its NIS.
Judged = tuple[int, float, float, float]


class Verdicts(NamedTuple):
    """What the gates said of an IMU sample.

    Attributes:
        gyro: of the yaw rate [rad/s].
        accelerometer: of the specific force to the left [m/s²], or None where it was not asked.
    """

    gyro: Judged
    accelerometer: Judged | None


class WholeStep(Protocol):
    """A step with an IMU sample at its end, at once."""

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
        """Take an IMU sample at the end of a step.

        Args:
            tracks: the track speeds.
            start: stamp of the start of the step [ns].
            end: stamp of its end, later.
            stands: whether the robot was found standing.
            pushed: whether it may be turning with its tracks at rest.
            interval: time between IMU samples [s].
            rate: as the gyros say [rad/s].
            force: specific force to the left [m/s²], None where it is not to be used.

        Returns:
            None where nothing was done, because the model is not compiled, or somebody else (a mark, a
            witness) is to know of each thing that is done in the step.
        """
        ...


class StepEngine(Protocol):
    """Makes the filter's algebra, and a whole step."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """Make the filter of a motion model."""
        ...

    def make_step(
        self,
        ekf: IcrEkf,
        disturbances: Disturbances,
        sensors: SensorModels,
        gyro: Gate,
        accelerometer: Gate,
    ) -> WholeStep | None:
        """Make the whole step of a filter; None where each thing is done by itself."""
        ...
