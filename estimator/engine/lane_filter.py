"""`IcrEkf` and its whole step by the traced step at one lane.

Import it inside functions only: numba takes half a second to load.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.records import array_on
from icreckon.estimator.engine.filters import aligned, shared_constants
from icreckon.estimator.engine.lane_inputs import add_sample, add_track_speeds, fill_move
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.one_lane import OneLane, one_lane
from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.motion.icr import IndexValues, PaperTwist
from icreckon.estimator.motion.motion_model import Motion, MotionModel, TwistModel
from icreckon.estimator.motion.propagation import Triple
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.standstill import QuietReadings


class Workspace:
    """Arrays that the compiled functions of one filter work on."""

    def __init__(self, compiled: OneLane, constants: Any) -> None:
        rows = len(compiled.shape.layout.rows)
        self.lane, self.constants = aligned(rows).reshape(-1, 1), constants
        self.inputs = aligned(len(INPUTS)).reshape(-1, 1)
        self.arrays = self.lane, self.inputs, self.constants


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
        self.compiled = one_lane(self.model, considered, wanders=self.wanders)
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

    def _evaluate(self, left: float, right: float, slip_shares: Triple) -> TwistModel:
        if self.compiled is None:
            return super()._evaluate(left, right, slip_shares)
        twist, jacobian, by_speeds = np.empty(3), np.empty((3, len(self.x))), np.empty((3, 2))
        zeta, epsilon, eta, u, force = self.compiled.twist(
            self.x,
            self.model.memory,
            *self.workspace.arrays,
            float(left),
            float(right),
            *map(float, slip_shares),
            twist,
            jacobian,
            by_speeds,
        )
        v_x, v_y, w = twist.tolist()
        motion = Motion(PaperTwist(-v_y, v_x, w), IndexValues(zeta, epsilon, eta), u, force)
        return TwistModel(twist, jacobian, by_speeds, motion)


class LaneStep:
    """Inputs and whole steps of one filter, see `WholeStep`.

    Args:
        ekf: the filter; its motion model is compiled.
        disturbances: its process noise.
        robot: its robot.
        settings: its settings.
        record: record of its inputs, shared with compiled code.
        readings: yaw-rate readings of a standstill.
    """

    def __init__(
        self,
        ekf: LaneEkf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        record: FilterRecord,
        readings: QuietReadings,
    ) -> None:
        self._made_of = ekf, disturbances, robot, settings, record, readings
        self._ekf, self._readings = ekf, readings
        self._record, self._records = record, array_on(record)
        if ekf.considered or ekf.wanders:
            ekf.compile_step(ekf.considered)
        self._compiled = compiled = cast(OneLane, ekf.compiled)
        constants = shared_constants(
            compiled.shape, ekf.model, disturbances, robot, settings, ekf.x[: s.SIZE]
        )
        ekf.workspace = Workspace(compiled, constants)
        self._inputs = ekf.workspace.inputs

    def __reduce__(self) -> tuple[type[LaneStep], tuple[Any, ...]]:
        return LaneStep, self._made_of

    def take_track_speeds(self, stamp: int, left: float, right: float) -> int:
        """Add track speeds, see `WholeStep`."""
        return cast(int, add_track_speeds(self._records, stamp, left, right))

    def take_imu(
        self, stamp: int, rate: float, force_x: float, force_y: float, *, uses_force: bool
    ) -> bool:
        """Add an IMU sample, and take the step that it ends, see `WholeStep`."""
        readings, records, inputs = self._readings, self._records, self._inputs
        sample = stamp, rate, force_x, force_y, uses_force
        while not add_sample(records, readings.stamps, readings.rates, inputs, *sample):
            readings.make_room()
        return cast(bool, self._compiled.imu_step(*self._begin(stamp)))

    def move(self, stamp: int) -> None:
        """Take a step without an IMU sample, see `WholeStep`."""
        fill_move(self._records, self._inputs, stamp)
        self._compiled.time_step(*self._begin(stamp))

    def _begin(self, stamp: int) -> tuple[Any, ...]:
        """Gather the arguments of a step to a stamp [ns]."""
        ekf, workspace = self._ekf, self._ekf.workspace
        memory = ekf.model.memory
        if len(memory):
            # The step advances the model; checkpoints share the memory before it.
            memory = memory.copy()
            ekf.model.recall(memory)
        is_first = ekf.regressors is None
        if ekf.regressors is None:
            ekf.regressors = np.zeros((3, s.PARAMETER_COUNT))
        return (
            self._records,
            ekf.x,
            ekf.P,
            ekf.regressors,
            memory,
            *workspace.arrays,
            stamp,
            is_first,
        )
