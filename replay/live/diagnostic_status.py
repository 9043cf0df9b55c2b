"""One line of a diagnostics panel (diagnostic_msgs/DiagnosticStatus)."""

from typing import NamedTuple

OK, WARN, ERROR, STALE = 0, 1, 2, 3  # levels, as diagnostic_msgs numbers them


class DiagnosticStatus(NamedTuple):
    """Status of one component."""

    level: int  # `OK`, `WARN`, `ERROR` or `STALE`
    name: str  # name of the component
    message: str  # summary in one sentence
    values: dict[str, str]  # details by key
