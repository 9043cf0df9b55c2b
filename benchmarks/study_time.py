"""How long a study takes, and where its time goes.

The study is 10,000 runs of ten minutes with an IMU at 100 Hz, by the five filter variants of the index
models: three thousand million filter steps. With fewer runs (`--runs`) the time is for those. The
breakdown is that of one block, on one core, by what its functions take themselves.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from concurrent.futures import ThreadPoolExecutor

from engines import VARIANT_NAMES

from icreckon.simulation.running import batch_engine as study_batch
from icreckon.simulation.running.engines import ENGINES
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.study.cells import Cell, expand
from icreckon.simulation.study.plan import Study

DURATION, RATE = 600.0, 100.0
# Files and functions -> what they do.
PARTS = {
    "filters": ("engine/work.py", "engine/filters.py"),
    "front end": ("batch/front_end.py",),
    "scores": ("study/statistics.py", "log/scores.py", "streaming/lost.py"),
    "sensor noise": ("sensors/imu.py", "noise_kernel.py", "encoders.py", "sensors/fixes.py"),
    "true motion": (
        "truth/friction.py",
        "friction_ode.py",
        "true_motion.py",
        "terrain_kernel.py",
        "surface_kernel.py",
    ),
}


def the_cell(runs: int, truths: int) -> Cell:
    """The study's only cell."""
    scenario = Scenario(
        duration=DURATION,
        imu_rate=RATE,
        track_rate=0.5 * RATE,
        truth_rate=10.0,
        fix_rate=1.0,
        outages=((200.0, DURATION),),
    )
    study = Study(
        name="time", scenario=scenario, variants=VARIANT_NAMES, runs=runs, truths=truths, seed=1
    )
    return expand(study).cells[0]


def breakdown(cell: Cell, runs: int) -> list[tuple[str, float]]:
    """Part -> seconds of one block."""
    profile = cProfile.Profile()
    profile.enable()
    study_batch.block(cell, cell.filters, 0, runs)
    profile.disable()
    own = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    seconds = dict.fromkeys([*PARTS, "all else"], 0.0)
    for (file, _, _), (_, _, itself, _, _) in own.items():
        for part, files in PARTS.items():
            if file.replace("\\", "/").endswith(files):
                seconds[part] += itself
                break
        else:
            seconds["all else"] += itself
    return list(seconds.items())


def main() -> None:
    """Run it and print the times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    block = ENGINES["batch"].block_runs
    cell = the_cell(arguments.runs, truths=20)
    study_batch.block(cell, cell.filters, 0, 1)
    for part, seconds in breakdown(cell, block):
        print(f"{part:14s} {seconds:7.2f} s of a block of {block} runs")
    starts = range(0, arguments.runs, block)
    begin = time.perf_counter()
    done = 0
    with ThreadPoolExecutor(arguments.threads) as pool:
        counts = [min(block, arguments.runs - first) for first in starts]
        work = [
            pool.submit(study_batch.block, cell, cell.filters, first, count)
            for first, count in zip(starts, counts, strict=True)
        ]
        for future, count in zip(work, counts, strict=True):
            future.result()
            done += count
            elapsed = time.perf_counter() - begin
            left = elapsed / done * (arguments.runs - done)
            print(f"\r{done} runs, {elapsed:.0f} s, {left:.0f} s left ", end="", flush=True)
    elapsed = time.perf_counter() - begin
    steps = arguments.runs * len(cell.filters) * DURATION * RATE
    print(
        f"\n{arguments.runs} runs of {DURATION:.0f} s by {len(cell.filters)} variants in "
        f"{elapsed:.0f} s: {1e-6 * steps / elapsed:.1f} M filter steps a second"
    )


if __name__ == "__main__":
    main()
