"""Filter steps per CPU second: filters side by side, the streaming filter, and filterpy's EKF.

A step is a prediction and updates with gyro and accelerometer. Ours work on the same simulated drive. All
are timed in turn, on one core, best of several. "The algebra alone" is a prediction and two
scalar updates with dense matrices of the same size and no motion model, noise model or gate, for which
the Jacobians cost nothing.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from _study import script_parser
from step_time import filter_microseconds, plain_microseconds

from icreckon.estimator.base import state as s
from icreckon.estimator.batch.front_end import FrontEnd
from icreckon.estimator.batch.inputs import measured_of
from icreckon.estimator.engine.constants import aligned
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.schedule import Steps, steps_of
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

FULL = "inertia-online"
VARIANT_NAMES = ("differential", "constant-fixed", "constant-online", "inertia-fixed", FULL)
# Steps before those that are timed, which begin with three seconds of standstill.
BEGIN, STEPS, RATE = 1000, 256, 100.0


class Drive:
    """The lanes of a variant on their way, and what the next steps are told."""

    def __init__(self, variant: str) -> None:
        robot = load_robot("auriga-alpha")
        self.filters = BatchFilter(robot, VARIANTS[variant], Settings())
        duration = (BEGIN + STEPS + 1) / RATE
        # It does not stop on the way, which would need updates of their own.
        scenario = Scenario(
            trajectory="figure-eight",
            duration=duration,
            track_rate=RATE / 2,
            imu_rate=RATE,
            fix_rate=0.0,
            seed=1,
        )
        logs = [simulate(scenario, robot, run_index=run) for run in range(self.filters.width)]
        measured = measured_of(logs, robot)
        none = measured.fix_stamps
        self.steps: Steps = steps_of(
            measured.track_stamps, measured.imu_stamps, none, none, heading=False
        )
        front = FrontEnd(measured, self.steps, input_settings(robot, Settings()))
        count = BEGIN + STEPS
        shape = (count, len(INPUTS), self.filters.width)
        self.inputs = aligned(int(np.prod(shape)), self.filters.number).reshape(shape)
        front.fill(0, count, self.inputs)
        self.table = self.filters.prepare(self.steps)
        zero = np.zeros(3)
        self.lanes = self.filters.begin(measured.tracks[:, 0], zero, zero)
        self.room = np.zeros((1, 18, self.filters.width))
        self._go(0, BEGIN)
        self.begun = self.lanes.workspace.copy()

    def _go(self, begin: int, end: int) -> None:
        part = slice(begin, end)
        steps = self.steps.part(begin, end)
        self.filters.work_through(self.lanes, self.inputs[part], steps, self.table[part], self.room)

    def seconds(self) -> float:
        """Processor time of one step of one filter [s]."""
        self.lanes.workspace[:] = self.begun
        begin = time.process_time()
        self._go(BEGIN, BEGIN + STEPS)
        return (time.process_time() - begin) / STEPS / self.filters.width


def best(measure: Callable[[], float], repeat: int) -> float:
    """Shortest of several."""
    return min(measure() for _ in range(repeat))


def main() -> None:
    """Print the table."""
    parser = script_parser(__doc__)
    parser.add_argument("--repeat", type=int, default=5, help="best of so many")
    arguments = parser.parse_args()
    repeat = arguments.repeat
    drives = {name: Drive(name) for name in VARIANT_NAMES}
    filterpy = best(lambda: 1e-6 * plain_microseconds(2000), repeat)
    rows: list[tuple[str, float]] = []
    for name, drive in drives.items():
        states = len(drive.filters.shape.states) + 3
        rows.append((f"icreckon, {name}, {states} states", best(drive.seconds, 40 * repeat)))
    log = simulate(
        Scenario(duration=30.0, track_rate=50.0, imu_rate=50.0, fix_rate=0.0, seed=1),
        load_robot("auriga-alpha"),
    )
    robot = load_robot("auriga-alpha")
    for engine in ("compiled", "plain"):
        settings = Settings(engine=engine)
        seconds = best(lambda s=settings: 1e-6 * filter_microseconds(log, robot, FULL, s), 3)
        rows.append((f"icreckon, streaming, {engine}", seconds))
    rows.append((f"filterpy's EKF in a loop, the algebra alone, {s.SIZE} states", filterpy))
    print(f"{'engine':66s} {'M steps/CPU s':>13s} {'x filterpy':>11s}")
    for name, seconds in rows:
        print(f"{name:66s} {1e-6 / seconds:13.4f} {filterpy / seconds:11.2f}")


if __name__ == "__main__":
    main()
