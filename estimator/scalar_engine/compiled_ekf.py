"""`estimator.filter.ekf` compiled; import it inside functions only, numba takes half a second."""

from __future__ import annotations

from typing import Any

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.ekf import IcrEkf, ProcessNoise
from icreckon.estimator.motion.motion_model import MotionModel, TwistModel
from icreckon.estimator.motion.propagation import Triple
from icreckon.estimator.scalar_engine.ekf_kernel import (
    expected_entry,
    predict_entry,
    renew_entry,
    twist_entry,
    update_entry,
)
from icreckon.estimator.scalar_engine.motion_kernel import ModelNumbers, numbers_of

# The states that an update keeps, as bits of a number.
BITS: dict[tuple[int, ...], int] = {}


class CompiledEkf(IcrEkf):
    """`IcrEkf` with its algebra compiled: the same to rounding, and `x` and `P` are changed in place.

    Args:
        model: the index model in these kinematics; one that is not compiled is asked in Python.

    Attributes:
        numbers: those of the model, None where it is not compiled.
    """

    def __init__(self, model: MotionModel) -> None:
        super().__init__(model)
        self.numbers: ModelNumbers | None = numbers_of(model)

    # The numbers are those of the model, and may be many.

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "numbers"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.numbers = numbers_of(self.model)

    def _evaluate(self, left: float, right: float, slip_share: float) -> TwistModel:
        numbers = self.numbers
        if numbers is None:
            return super()._evaluate(left, right, slip_share)
        twist, jacobian, by_speeds = np.empty(3), np.empty((3, s.SIZE)), np.empty((3, 2))
        motion = twist_entry(
            self.x,
            numbers.kind,
            numbers.constants,
            self.model.memory,
            left,
            right,
            slip_share,
            twist,
            jacobian,
            by_speeds,
        )
        return TwistModel(twist, jacobian, by_speeds, motion)

    def _move(self, dt: float, model: TwistModel, noise: ProcessNoise) -> Triple:
        self.F, self.Q = np.empty((s.SIZE, s.SIZE)), np.empty((s.SIZE, s.SIZE))
        step: Triple = predict_entry(
            self.x,
            self.P,
            dt,
            model.twist,
            model.jacobian,
            *noise.slip_sigma.tolist(),
            float(noise.time_constant),
            noise.walk,
            self.F,
            self.Q,
        )
        return step

    def _draw(self, covariance: Floats) -> None:
        renew_entry(self.x, self.P, covariance)

    def innovation_covariance(self, H: Floats, R: Floats) -> Floats:
        """See `IcrEkf`."""
        if len(R) > 1:
            return super().innovation_covariance(H, R)
        return np.array([[expected_entry(self.P, H[0], R.item())]])

    def _correct(
        self, z: float, h: Floats, r: float, fixed: tuple[int, ...]
    ) -> tuple[Floats, Floats, float]:
        bits = BITS.get(fixed)
        if bits is None:
            bits = BITS[fixed] = sum(1 << index for index in fixed)
        cross, gain = np.empty(s.SIZE), np.empty(s.SIZE)
        expected: float = update_entry(self.x, self.P, z, h, r, bits, cross, gain)
        return cross, gain, expected
