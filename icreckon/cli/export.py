"""`icreckon export`: the filter of a robot as a folder of C sources."""

import shlex
from pathlib import Path
from typing import Annotated

from typer import Option

from icreckon.cli.common.console import say
from icreckon.cli.common.options import Overwrite, RobotName
from icreckon.estimator.base.errors import EstimatorError, nearest_hint
from icreckon.estimator.embedded.c_filter import filter_in_c
from icreckon.estimator.embedded.vectors import vectors_of
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.streaming.latencies import Latencies
from icreckon.replay.base.outputs import MANIFEST, written_beside
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

BITS = {"float": 32, "double": 64}
# Simulated run of the self-test: it stands, drives, and has fixes once a second.
DRIVE = Scenario(duration=20.0, fix_rate=1.0)


def command(
    robot: RobotName = None,
    out: Annotated[Path, Option(help="Folder to write.")] = Path("icreckon_filter"),
    variant: Annotated[str, Option(help="Filter variant.")] = "inertia-online",
    precision: Annotated[str, Option(help="Numbers of the filter: float or double.")] = "float",
    imu_rate: Annotated[
        float, Option(help="Highest rate of the IMU in Hz, for the size of a buffer.")
    ] = 200.0,
    overwrite: Overwrite = False,
) -> None:
    """Write the filter of a robot in C, for microcontrollers and C++.

    The folder holds C99 sources without dependencies, a C++ class, an example, a self-test against the
    Python filter, and files for CMake, colcon and Arduino.
    """
    if robot is None:
        raise EstimatorError("--robot is required: a robot file, or a name of `icreckon robots`")
    if precision not in BITS:
        raise EstimatorError(f"no precision {precision!r}{nearest_hint(precision, list(BITS))}")
    loaded, found, bits = load_robot(robot), find_variant(variant), BITS[precision]
    with written_beside(
        out, overwrite=overwrite, marker=MANIFEST, mark=b"icreckon_filter.h", keeps_foreign=True
    ) as folder:
        exported = filter_in_c(loaded, found, bits=bits, imu_rate=imu_rate)
        exported.write(folder)
        say("running the Python filter for the self-test")
        log = simulate(DRIVE, loaded)
        vectors = vectors_of(loaded, found, exported.states, log.measurements())
        (folder / "extras" / "test_vectors.csv").write_text(vectors, encoding="utf-8")
    place = shlex.quote(str(out))
    build = f"cmake -S {place} -B {place}/build && cmake --build {place}/build"
    say(f"{found.name} of {loaded.name} in {precision}: {out}")
    if latency := Latencies.of(loaded).tracks:
        say(f"track speeds lag by {latency:g} s: subtract it, as extras/example.c does")
    say(f"next: {build} && ctest --test-dir {place}/build")
