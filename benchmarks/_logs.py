"""The sample logs, and the robots that ship with icreckon for them."""

from __future__ import annotations

GRASS = (
    "warthog_grass_2024_8_8_15h56s39",
    "warthog_grass_2024_8_8_16h11s19",
    "warthog_grass_2024_7_29_14h46s15",
)
ASPHALT = "warthog_asphalt_2024_9_25_12h8s57"
WITH_TRUTH = {
    **dict.fromkeys((*GRASS, ASPHALT), "warthog"),
    "marmotte_part1": "marmotte",
    "husky_deflated_part1": "husky-deflated",
}
"""Robots of the logs with a truth, by log."""
LOGS = {
    **WITH_TRUTH,
    "husky_test1.bag": "husky",
    "jackal_test2.bag": "jackal",
    "wetexplorer_2024-07-05-13-33-58.bag": "wetexplorer",
    "wetexplorer_2024-07-05-13-36-28.bag": "wetexplorer",
}
"""Robots of all logs, by log."""


def logs_without(*robots: str) -> dict[str, str]:
    """Robots of the logs, by log, without those of some robots."""
    return {name: robot for name, robot in LOGS.items() if robot not in robots}
