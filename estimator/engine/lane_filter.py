"""`IcrEkf` and its whole step by the traced step at one lane.

Import it inside functions only: numba takes half a second to load.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.engine.filters import aligned, shared_constants
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.one_lane import NOT_TESTED, OneLane, one_lane
from icreckon.estimator.filter.ekf import REGRESSOR_SMOOTHING, IcrEkf
from icreckon.estimator.filter.gate import Gate
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.filter.step_engine import Verdicts
from icreckon.estimator.motion.icr import IndexValues, PaperTwist
from icreckon.estimator.motion.motion_model import Motion, MotionModel, TwistModel
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.held_tracks import HeldTrackSpeeds, smoothing_share
from icreckon.estimator.sensors.step_inputs import StepInputs, step_inputs

# Inputs of a step as they are packed: those from the track speeds, then those from the IMU.
PACKED = (*StepInputs._fields, "quiet_mean", "rate", "force")
STEP_VALUES = struct.Struct(f"{len(PACKED)}d")
assert INPUTS.names[: len(PACKED)] == PACKED  # noqa: S101 - one is written as the other


class Workspace:
    """Arrays that the compiled functions of one filter work on."""

    def __init__(self, compiled: OneLane, constants: Any) -> None:
        rows = len(compiled.shape.layout.rows)
        self.lane, self.constants = aligned(rows).reshape(-1, 1), constants
        self.inputs = aligned(len(INPUTS)).reshape(-1, 1)
        self.arrays = self.lane, self.inputs, self.constants
        self.packed = memoryview(self.inputs.reshape(-1)).cast("B")


class LaneEkf(IcrEkf):
    """`IcrEkf` with its motion model compiled; equal to it except for rounding.

    Args:
        model: the motion model; one that has no traced form is evaluated in Python.

    Attributes:
        compiled: compiled functions of the model, None if it has no traced form.
        workspace: arrays that these work on.
    """

    def __init__(self, model: MotionModel) -> None:
        super().__init__(model)
        self.compile_step()

    def compile_step(self, considered: tuple[int, ...] = ()) -> None:
        """Compile the functions of the model, or load them.

        Args:
            considered: consider states.
        """
        self.compiled = one_lane(self.model, considered)
        if self.compiled is not None:
            layout = self.compiled.shape.layout
            constants = aligned(len(layout.constants))
            for name, value in self.model.vehicle._asdict().items():
                constants[layout.constants[name]] = value
            self.workspace = Workspace(self.compiled, constants)

    # Machine code and workspaces are not copied.

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: value
            for name, value in vars(self).items()
            if name not in ("compiled", "workspace")
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.compile_step(self.considered)

    def _evaluate(self, left: float, right: float, slip_share: float) -> TwistModel:
        if self.compiled is None:
            return super()._evaluate(left, right, slip_share)
        twist, jacobian, by_speeds = np.empty(3), np.empty((3, s.SIZE)), np.empty((3, 2))
        zeta, epsilon, eta, u, force = self.compiled.twist(
            self.x,
            self.model.memory,
            *self.workspace.arrays,
            float(left),
            float(right),
            float(slip_share),
            twist,
            jacobian,
            by_speeds,
        )
        v_x, v_y, w = twist.tolist()
        motion = Motion(PaperTwist(-v_y, v_x, w), IndexValues(zeta, epsilon, eta), u, force)
        return TwistModel(twist, jacobian, by_speeds, motion)


class LaneStep:
    """Whole step of one filter, see `WholeStep`.

    Args:
        ekf: the filter.
        disturbances: its process noise.
        robot: its robot.
        settings: its settings.
        gyro: gate of the gyro.
        accelerometer: gate of the accelerometer, of the same threshold and patience.
    """

    def __init__(
        self,
        ekf: LaneEkf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        gyro: Gate,
        accelerometer: Gate,
    ) -> None:
        self._made_of = ekf, disturbances, robot, settings, gyro, accelerometer
        self._ekf = ekf
        self._gyro, self._accelerometer = gyro, accelerometer
        self._time_constant = float(disturbances.slip.time_constant)
        if ekf.considered:
            ekf.compile_step(ekf.considered)
        if ekf.compiled is not None:
            shape = ekf.compiled.shape
            constants = shared_constants(shape, ekf.model, disturbances, robot, settings, ekf.x)
            self._workspace = Workspace(ekf.compiled, constants)

    def __reduce__(self) -> tuple[type[LaneStep], tuple[Any, ...]]:
        return LaneStep, self._made_of

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
        """Make a step with an IMU sample at its end, see `WholeStep`."""
        ekf = self._ekf
        compiled = ekf.compiled
        if compiled is None or ekf.clones is not None or ekf.observer is not None:
            return None
        # The kernel tests a mean of quiet yaw rates itself, as in studies; the bias passes, NaN fails.
        mean_bias = ekf.x.item(s.GYRO_BIAS) if stands else math.nan
        measured = math.nan if force is None else force
        steps = self._begin(tracks, start, end, pushed, (mean_bias, rate, measured))
        of_gyro, of_accelerometer = compiled.imu_step(
            *steps,
            float(interval),
            self._gyro.rejected_in_a_row,
            self._accelerometer.rejected_in_a_row,
        )
        tested = of_accelerometer[0] != NOT_TESTED
        return Verdicts(of_gyro, of_accelerometer if tested else None)

    def time_step(self, tracks: HeldTrackSpeeds, start: int, end: int, *, pushed: bool) -> bool:
        """Make a step without an IMU sample, see `WholeStep`."""
        ekf = self._ekf
        if ekf.compiled is None or ekf.clones is not None or ekf.observer is not None:
            return False
        ekf.compiled.time_step(*self._begin(tracks, start, end, pushed, (math.nan, 0.0, math.nan)))
        return True

    def _begin(
        self,
        tracks: HeldTrackSpeeds,
        start: int,
        end: int,
        pushed: bool,
        measured: tuple[float, float, float],
    ) -> tuple[Any, ...]:
        """Advance the motion model, and gather the arguments of a compiled step."""
        ekf, workspace = self._ekf, self._workspace
        dt = (end - start) * NANOSECOND
        inputs = step_inputs(tracks, start, end, tracks.settings)
        ekf.begin_step(dt, inputs.mean_left, inputs.mean_right)
        smoothing = smoothing_share(dt, REGRESSOR_SMOOTHING)
        if ekf.regressors is None:
            ekf.regressors, smoothing = np.zeros((3, 8)), 1.0
        # The last input, `slow`, is all that lanes know of it; here more is known.
        STEP_VALUES.pack_into(workspace.packed, 0, *inputs[:-1], pushed, *measured)
        return (
            ekf.x,
            ekf.P,
            ekf.regressors,
            ekf.model.memory,
            *workspace.arrays,
            dt,
            smoothing,
            self._time_constant,
        )
