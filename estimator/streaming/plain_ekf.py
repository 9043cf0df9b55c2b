"""EKF of the plain engine: filterpy predicts.

Import it inside functions only: filterpy takes two seconds to load.
"""

from __future__ import annotations

from filterpy.kalman import ExtendedKalmanFilter

from icreckon.estimator.base import state as s
from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.motion.motion_model import MotionModel


class PlainEkf(IcrEkf, ExtendedKalmanFilter):  # type: ignore[misc]
    """`IcrEkf` as filterpy's EKF; its `update`, `y`, `K` and `S` are not used.

    Args:
        model: the motion model.
    """

    def __init__(self, model: MotionModel) -> None:
        ExtendedKalmanFilter.__init__(self, dim_x=s.SIZE, dim_z=1)
        IcrEkf.__init__(self, model)

    def predict_x(self, u: float = 0) -> None:  # noqa: ARG002 - the signature is filterpy's
        """Set the state that `predict_motion` computed; called by filterpy's `predict`."""
        self.x = self._next_x

    def _predict(self) -> None:
        self.predict()
