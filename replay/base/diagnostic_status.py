"""One line of a diagnostics panel (diagnostic_msgs/DiagnosticStatus)."""

from __future__ import annotations

from typing import NamedTuple

OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""Levels, as diagnostic_msgs numbers them."""
LARGE_NIS = 4.0
"""Mean NIS per degree of freedom from which a sensor is reported as `WARN`."""


class DiagnosticStatus(NamedTuple):
    """Status of one component.

    Attributes:
        level: `OK`, `WARN`, `ERROR` or `STALE`.
        name: name of the component.
        message: summary in one sentence.
        values: details by key.
    """

    level: int
    name: str
    message: str
    values: dict[str, str]
