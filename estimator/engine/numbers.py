"""Numbers of the filter's algebra."""

from __future__ import annotations

from typing import Any

from icreckon.estimator.engine.layout import STEP_CONSTANTS
from icreckon.estimator.sensors.held_tracks import smoothing_share

# Time constant of the derivatives by the parameters [s]. A longer one leaves less noise, but delays them
# so much that they are those of another motion.
REGRESSOR_SMOOTHING = 0.05
PER_STEP, SMOOTHING = len(STEP_CONSTANTS), STEP_CONSTANTS.index("smoothing")


def step_constants(dt: float) -> Any:
    """Compute the values of `STEP_CONSTANTS` for a step of `dt` seconds."""
    return dt, smoothing_share(dt, REGRESSOR_SMOOTHING)
