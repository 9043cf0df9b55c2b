"""Spread of calibrated parameters between logs: other ground, load, tyre pressure.

One log cannot show it. The figures are those of three robots, measured by `benchmarks/between_logs.py`:
four logs of a Warthog on grass and asphalt, four parts of a log each of the tracked Marmotte and of a
Husky with deflated tyres.
"""

from __future__ import annotations

import math
from dataclasses import replace

from icreckon.estimator.calibration.result import FoundParameter

SHARES = {
    "sprocket_radius": 0.01,
    "track_scale": 0.01,
    "effective_track": 0.02,
    "constant_icr.x_ICRl": 0.02,
    "constant_icr.x_ICRr": 0.02,
    "indices.eta0": 0.02,
    "indices.zeta1": 0.1,
}
"""Standard deviation between logs, as a share of the value [-]."""
SIZES = {
    "tracks.difference": 0.003,
    "track_latency": 0.012,
    "imu.roll": 0.5,
    "imu.pitch": 0.5,
    "imu.yaw": 4.0,
    "imu.left": 0.05,
    "truth.forward": 0.02,
    "truth.left": 0.015,
}
"""Standard deviation between logs, in the parameter's unit."""


def with_other_logs(one: FoundParameter, logs: int) -> FoundParameter:
    """Add the standard error for other logs of the same robot.

    Args:
        one: the parameter.
        logs: number of logs it was found from.
    """
    if one.sigma is None:
        return one
    between = SHARES.get(one.name, 0.0) * abs(one.value) + SIZES.get(one.name, 0.0)
    return replace(one, sigma_other_logs=math.hypot(one.sigma, between / math.sqrt(logs)))
