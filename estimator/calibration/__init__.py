"""Calibration of a robot from logs with a truth: maximum likelihood over segments.

In: logs and a robot file. Out: the robot with calibrated geometry, slip and scales, and each motion
model's prediction errors on held-out segments. Below: `robot`, `motion`, `log`.
"""

from icreckon.estimator.calibration.calibrate import calibrate as calibrate
from icreckon.estimator.calibration.result import Calibration as Calibration

__all__ = ["Calibration", "calibrate"]
