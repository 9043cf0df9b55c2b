"""`icreckon simulate`: a simulated run as a bag."""

from __future__ import annotations

import shlex
import tomllib
from pathlib import Path
from typing import Any, cast

from icreckon.cli.console import messages
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.comparison.fixes import SCORED_OUTAGE, scored_intervals
from icreckon.replay.export.log_bag import Format, check_place, write_log
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.scenario import Scenario, change_scenario, load_scenario, lost_options
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.robot_remarks import robot_remarks
from icreckon.simulation.truth.terrain import refuse_idle_keys

FORMATS = ("mcap", "sqlite3", "ros1")
# Share of a run whose fixes are used in the replay that is proposed, if it has fixes throughout.
FIXES_SHARE = 0.4


def run_simulate(
    *,
    out: Path,
    robot: str,
    scenario_file: Path | None,
    settings: list[str],
    outages: list[str],
    fixes: dict[str, float | None],
    bag_format: str,
    overwrite: bool,
    **options: Any,
) -> None:
    """Run `icreckon simulate`; arguments as in its help, None if not given."""
    if bag_format not in FORMATS:
        raise SimulationError(
            f"no bag format {bag_format!r}{nearest_hint(bag_format, list(FORMATS))}"
        )
    kind = cast("Format", bag_format)
    loaded = load_robot(robot)
    check_place(out, kind, loaded, overwrite=overwrite)
    changes = _given(options) | {"fixes": _given(fixes)}
    if outages:
        changes["outages"] = [_outage(text) for text in outages]
    scenario = Scenario() if scenario_file is None else load_scenario(scenario_file)
    source = "command line" if scenario_file is None else f"command line over {scenario_file}"
    of_terrain: dict[str, Any] = {}
    for change in [changes, *(_setting(text) for text in settings)]:
        lost = lost_options(scenario, change)
        scenario = change_scenario(scenario, change, source)
        if lost:
            _print(f"dropped, as trajectory {scenario.trajectory!r} has no such: {', '.join(lost)}")
        of_terrain |= change.get("terrain", {})
    refuse_idle_keys([scenario.terrain], of_terrain, source)
    for text in robot_remarks(loaded, scenario.truth):
        _print(text)
    log = simulate(scenario, loaded)
    path = write_log(log, out, kind, loaded, overwrite=overwrite)
    # With fixes throughout no stretch of dead reckoning is left to score.
    too_short = (1.0 - FIXES_SHARE) * log.duration < SCORED_OUTAGE
    has_scores = too_short or log.truth is None or scored_intervals(log)
    part = "" if has_scores else f" --fixes 0:{FIXES_SHARE:.0%}"
    _print(
        f"{log.duration:.0f} s of {loaded.name} in {path}; next: "
        f"icreckon replay {shlex.quote(str(path))} --robot {shlex.quote(robot)}{part}"
    )


def _print(text: str) -> None:
    messages().print(text, markup=False, soft_wrap=True)


def _given(options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _setting(text: str) -> dict[str, Any]:
    """Parse `table.key=value` (value: TOML, number or string) to a nested dictionary."""
    path, equals, written = text.partition("=")
    if not equals or not path.strip():
        raise SimulationError(f"--set {text!r}: give key and value, as gyro.noise_density=0.001")
    value = _value(written.strip())
    for key in reversed(path.split(".")):
        value = {key.strip(): value}
    return cast("dict[str, Any]", value)


def _value(written: str) -> Any:
    try:
        return tomllib.loads(f"value = {written}")["value"]
    except tomllib.TOMLDecodeError:
        pass
    try:
        return float(written)
    except ValueError:
        return written


def _outage(text: str) -> list[float]:
    try:
        start, end = (float(word) for word in text.split(":"))
    except ValueError:
        raise SimulationError(
            f"--outage {text!r}: give its start and end in seconds, as 100:300"
        ) from None
    return [start, end]
