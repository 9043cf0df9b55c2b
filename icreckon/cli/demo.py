"""`icreckon demo`: simulate, write a bag, read it back, compare."""

from dataclasses import replace
from typing import Annotated

import msgspec
from typer import Option

from icreckon.cli.common.comparing import compare_and_write
from icreckon.cli.common.console import exit_if_failed, results_folder, say, show, working
from icreckon.cli.common.options import Formats, Json, Out, Overwrite, Wide, Workers
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.export.formats import parse_formats
from icreckon.replay.export.log_bag import write_log
from icreckon.replay.reading.read_log import read_log
from icreckon.report.replay.page_text import failures
from icreckon.report.replay.tables import WIDE_FROM, results_table
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.drives.drives import TRAJECTORIES
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import Terrain

ROBOT = "auriga-alpha"
DEFAULT_FOLDER = "icreckon-demo"
BAG = "bag"
DURATION = 300.0
FIXES_END = 1.0 / 3.0  # end of the fixes, as a share of the run
TERRAIN = Terrain(rolling_deg=3.0, wavelength=20.0)  # ground that a robot drives on outdoors


def command(
    seed: Annotated[int, Option(min=0, help="Seed of all random numbers.")] = 1,
    duration: Annotated[float, Option(help="Length of the run in seconds.")] = DURATION,
    trajectory: Annotated[str, Option(help=f"{', '.join(TRAJECTORIES)}.")] = "random",
    formats: Formats = None,
    out: Out = None,
    as_json: Json = False,
    wide: Wide = False,
    overwrite: Overwrite = False,
    workers: Workers = None,
) -> None:
    """Simulate a bag of Auriga-alpha, read it back, compare variants."""
    if trajectory not in TRAJECTORIES:
        hint = nearest_hint(trajectory, list(TRAJECTORIES))
        raise SimulationError(f"no trajectory of a demo: {trajectory!r}{hint}")
    wanted = parse_formats(formats)
    robot = load_robot(ROBOT)
    scenario = demo_scenario(seed, duration, trajectory)
    with results_folder(out, DEFAULT_FOLDER, overwrite=overwrite) as folder:
        with working(f"simulating {duration:.0f} s of {ROBOT} (the first run compiles)"):
            bag = write_log(simulate(scenario, robot), folder / BAG, "mcap", robot)
        origin = {"command": "demo", "configuration": msgspec.to_builtins(scenario)}
        origin |= {"inputs": {BAG: bag}, "seed": seed}
        say(f"simulated {duration:.0f} s of {ROBOT} and wrote them as a bag")
        name = f"{scenario.trajectory} drive over rolling ground"
        log = replace(read_log(bag, robot), name=name)
        summary, _ = compare_and_write(
            log, robot, folder, origin=origin, formats=wanted, workers=workers
        )
        show(folder, results_table, summary, WIDE_FROM, as_json=as_json, wide=wide)
    exit_if_failed(failures(summary))


def demo_scenario(seed: int, duration: float, trajectory: str) -> Scenario:
    """Scenario of the demo: rolling ground, and fixes for the first third of the run."""
    outages = ((FIXES_END * duration, duration),)
    return Scenario(
        trajectory=trajectory, duration=duration, seed=seed, terrain=TERRAIN, outages=outages
    )
