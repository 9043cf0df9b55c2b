"""`icreckon simulate`: a simulated run as a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from estimator.errors import nearest_hint
from estimator.robot import load_robot
from icreckon.console import messages
from replay.bag_writer import Format, write_log
from simulation.errors import SimulationError
from simulation.scenario import Scenario, simulate

FORMATS = ("mcap", "sqlite3", "ros1")


def run_simulate(
    *,
    out: Path,
    robot: str,
    noise_overrides: list[str],
    outages: list[str],
    bag_format: str,
    overwrite: bool,
    **scenario: Any,
) -> None:
    """See `icreckon simulate --help`."""
    if bag_format not in FORMATS:
        raise SimulationError(
            f"no bag format {bag_format!r}{nearest_hint(bag_format, list(FORMATS))}"
        )
    loaded = load_robot(robot)
    wanted = Scenario(
        noise_overrides=dict(_override(text) for text in noise_overrides),
        outages=tuple(_outage(text) for text in outages),
        **scenario,
    )
    log = simulate(wanted, loaded)
    path = write_log(log, out, cast("Format", bag_format), loaded, overwrite=overwrite)
    messages().print(f"{log.duration:.0f} s of {loaded.name} in {path}", markup=False)


def _override(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise SimulationError(
            f"--set {text!r}: give a figure, as gyro_noise_density=0.001"
        ) from None


def _outage(text: str) -> tuple[float, float]:
    try:
        start, end = (float(word) for word in text.split(":"))
    except ValueError:
        raise SimulationError(
            f"--outage {text!r}: give its start and end in seconds, as 100:300"
        ) from None
    return start, end
