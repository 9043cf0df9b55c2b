"""Interface to the filter's algebra, and to a whole compiled step."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.filter.gate import Gate
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.held_tracks import HeldTrackSpeeds

# Verdict, see `estimator.filter.gate`, innovation, its variance S, and NIS.
Verdict = tuple[int, float, float, float]


class Verdicts(NamedTuple):
    """Verdicts of the gates on an IMU sample.

    Attributes:
        gyro: verdict on the yaw rate [rad/s].
        accelerometer: verdict on the specific force to the left [m/s²], or None if it was not used.
    """

    gyro: Verdict
    accelerometer: Verdict | None


class WholeStep(Protocol):
    """A whole step of a filter, compiled.

    A step is refused, and nothing is done, if the motion model is not compiled, or if a stochastic clone
    or an observer follows each part of the step.
    """

    def imu_step(
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
        """Take a step with an IMU sample at its end; None if it is refused.

        Args:
            tracks: the track speeds.
            start: stamp of the start of the step [ns].
            end: stamp of its end, later [ns].
            stands: the robot was found standing.
            pushed: the robot may be turning with its tracks at rest.
            interval: time between IMU samples [s].
            rate: yaw rate from the gyros [rad/s].
            force: specific force to the left [m/s²], None if it is not used.
        """
        ...

    def time_step(self, tracks: HeldTrackSpeeds, start: int, end: int, *, pushed: bool) -> bool:
        """Take a step without an IMU sample; False if it is refused.

        Args:
            tracks: the track speeds.
            start: stamp of the start of the step [ns].
            end: stamp of its end, later.
            pushed: whether the robot may be turning with its tracks at rest.
        """
        ...


class StepEngine(Protocol):
    """Factory of the filter's algebra, and of a whole step."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """Make the filter of a motion model."""
        ...

    def make_step(
        self,
        ekf: IcrEkf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        gyro: Gate,
        accelerometer: Gate,
    ) -> WholeStep | None:
        """Make the whole step of a filter; None if its parts are taken one at a time."""
        ...
