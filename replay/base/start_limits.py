"""Limits for the start of a run in the frame of its fixes, of a replay and live."""

from __future__ import annotations

CLEAR = 4.0
"""Standard deviations beyond which a fix and the assumed start contradict each other [-]."""
SOON = 5.0
"""Longest time between the start and a heading that is used for the initial yaw [s]."""
ANY_HEADING = 3.0
"""Standard deviation of an unknown yaw [rad]."""
