"""`icreckon simulate`: a simulated run as a bag."""

import shlex
import tomllib
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, cast

from typer import Option

from icreckon.cli.common.console import say, working
from icreckon.cli.common.options import Overwrite, robot_option
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.comparison.fixes import SCORED_OUTAGE, scored_intervals
from icreckon.replay.export.log_bag import Format, check_place, write_log
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.contact.of_robot import robot_remarks
from icreckon.simulation.drives.drives import TRAJECTORIES
from icreckon.simulation.scenario import Scenario, change_scenario, load_scenario, lost_options
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import refuse_idle_keys

FORMATS = ("mcap", "sqlite3", "ros1")
# Share of a run whose fixes are used in the replay that is proposed, if it has fixes throughout.
FIXES_SHARE = 0.4


def command(
    out: Annotated[Path, Option(help="The bag: a folder, or a file for ros1.")],
    robot: Annotated[str, robot_option()] = "auriga-alpha",
    scenario_file: Annotated[
        Path | None,
        Option(
            "--scenario",
            help="TOML file of the run (docs/reference/scenario-file.md); the other options change it.",
        ),
    ] = None,
    trajectory: Annotated[
        str | None, Option(help=f"{', '.join(TRAJECTORIES)}, or recorded (default: random).")
    ] = None,
    duration: Annotated[
        float | None, Option(help="Length of the run in seconds (default: 300).")
    ] = None,
    seed: Annotated[
        int | None, Option(min=0, help="Seed of all random numbers (default: 0).")
    ] = None,
    noise: Annotated[
        str | None,
        Option(
            help="perfect, nominal (the robot file's, the default), or an IMU grade: consumer, "
            "industrial, tactical."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        Option(
            "--set",
            help="Any key of a scenario file, as imu_rate=200, fixes.sigma=0.02 or "
            "trajectory_options.speed=0.4; repeatable. Wins over the other options.",
        ),
    ] = None,
    fix_rate: Annotated[
        float | None, Option(help="Position fixes per second; 0 for none (default: 1).")
    ] = None,
    outages: Annotated[
        list[str] | None,
        Option("--outage", help="Time without fixes, as 100:300 seconds; repeatable."),
    ] = None,
    bag_format: Annotated[
        str, Option("--format", help="mcap, sqlite3 (both ROS 2) or ros1.")
    ] = "mcap",
    include_truth: Annotated[
        bool | None,
        Option(
            "--with-truth/--without-truth", help="Whether the bag holds the truth (default: yes)."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a run and write it as a bag of standard messages."""
    if bag_format not in FORMATS:
        hint = nearest_hint(bag_format, list(FORMATS))
        raise SimulationError(f"no bag format {bag_format!r}{hint}")
    kind = cast("Format", bag_format)
    loaded = load_robot(robot)
    check_place(out, kind, loaded, overwrite=overwrite)
    options: dict[str, Any] = {"trajectory": trajectory, "duration": duration, "seed": seed}
    options |= {"noise": noise, "fix_rate": fix_rate, "include_truth": include_truth}
    changes = {name: value for name, value in options.items() if value is not None}
    if outages:
        changes["outages"] = [_outage(text) for text in outages]
    scenario = _changed_scenario(scenario_file, [changes, *map(_setting, settings or [])])
    with working(f"simulating {scenario.duration:.0f} s of {loaded.name} (the first run compiles)"):
        remarks = robot_remarks(loaded, scenario.truth)
        log = simulate(scenario, loaded)
        path = write_log(log, out, kind, loaded, overwrite=overwrite)
    for text in remarks:
        say(text)
    # With fixes throughout no stretch of dead reckoning is left to score.
    too_short = (1.0 - FIXES_SHARE) * log.duration < SCORED_OUTAGE
    has_scores = too_short or log.truth is None or scored_intervals(log)
    part = "" if has_scores else f" --fixes 0:{FIXES_SHARE:.0%}"
    say(
        f"{log.duration:.0f} s of {loaded.name} in {path}; next: "
        f"icreckon replay {shlex.quote(str(path))} --robot {shlex.quote(robot)}{part}"
    )


def _changed_scenario(file: Path | None, changes: list[dict[str, Any]]) -> Scenario:
    """Scenario of a file, or the default one, changed by the command line in turn."""
    scenario = Scenario() if file is None else load_scenario(file)
    source = "command line" if file is None else f"command line over {file}"
    terrain_keys: set[str] = set()
    for change in changes:
        lost = lost_options(scenario, change)
        scenario = change_scenario(scenario, change, source)
        if lost:
            say(f"dropped, as trajectory {scenario.trajectory!r} has no such: {', '.join(lost)}")
        terrain_keys |= set(change.get("terrain", {}))
    refuse_idle_keys([scenario.terrain], terrain_keys, source)
    return scenario


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
    """Value as in TOML, else a number that TOML refuses (as .5), else the text itself."""
    with suppress(tomllib.TOMLDecodeError):
        return tomllib.loads(f"value = {written}")["value"]
    try:
        return float(written)
    except ValueError:
        return written


def _outage(text: str) -> list[float]:
    """Start and end of an outage [s], from a text such as "100:300"."""
    try:
        start, end = (float(word) for word in text.split(":"))
    except ValueError:
        raise SimulationError(
            f"--outage {text!r}: give its start and end in seconds, as 100:300"
        ) from None
    return [start, end]
