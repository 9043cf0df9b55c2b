"""Millions of steps of filters side by side, in double and in single precision.

A minute of driving is repeated as often as needed, each time from where the true robot was; fixes come
each second in three minutes of four. Once a minute the covariance of each filter must be finite and
positive definite: the smallest eigenvalue of the correlation matrix of what is estimated is told. What
single precision says is set against double precision, in standard deviations.

    python benchmarks/long_batch.py --steps 10_000_000
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from _study import table
from long_run import smallest_correlation

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import compose
from icreckon.estimator.batch.front_end import FrontEnd
from icreckon.estimator.batch.inputs import measured_of
from icreckon.estimator.engine.constants import PRECISIONS, aligned
from icreckon.estimator.engine.filters import BatchFilter, Lanes
from icreckon.estimator.engine.fixes import GATED, SKIPPED
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.schedule import steps_of
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

VARIANT = "inertia-online"
RATE, LAP, FIX_SIGMA = 50.0, 60.0, 0.05
# Laps with fixes, of so many.
WITH_FIXES, OF_LAPS = 3, 4
LEARNT = slice(6, 18)


class Laps:
    """The same minute again and again.

    Args:
        bits: of each number.
        seed: of the noise of the fixes.
    """

    def __init__(self, bits: int, seed: int) -> None:
        robot = load_robot("auriga-alpha")
        self.filters = BatchFilter(robot, VARIANTS[VARIANT], Settings(), bits)
        width = self.filters.width
        # A second more than a lap: its first second, of standstill, is left out of all but the first.
        scenario = Scenario(duration=LAP, track_rate=RATE, imu_rate=RATE, fix_rate=1.0, seed=5)
        logs = [simulate(scenario, robot, run_index=lane % 8) for lane in range(width)]
        measured = measured_of(logs, robot)
        self.steps = steps_of(
            measured.track_stamps,
            measured.imu_stamps,
            measured.fix_stamps,
            measured.fix_stamps[:0],
            heading=False,
        )
        count = len(self.steps.kinds)
        shape = count, len(INPUTS), width
        self.inputs = aligned(int(np.prod(shape)), PRECISIONS[bits]).reshape(shape)
        FrontEnd(measured, self.steps, input_settings(robot, Settings())).fill(
            0, count, self.inputs
        )
        self.table = self.filters.prepare(self.steps)
        zero = np.zeros(3)
        self.lanes: Lanes = self.filters.begin(
            measured.tracks[:, 0], zero, zero, len(measured.fix_stamps)
        )
        truths = [log.truth for log in logs]
        at = np.searchsorted(truths[0].poses.stamps, measured.fix_stamps)  # type: ignore[union-attr]
        self._true = np.stack([truth.poses.poses[at] for truth in truths if truth is not None])
        self._begin = np.zeros((width, 3))
        self._rng = np.random.default_rng(seed)
        self._fixes = np.flatnonzero(self.steps.extras)

    def lap(self, number: int) -> None:
        """One more; all but the first begin after its first step, which would begin anew."""
        poses = compose(self._begin[:, None], self._true)
        seen = (
            poses[..., :2]
            + FIX_SIGMA
            * self._rng.standard_normal((8, *poses.shape[1:2], 2))[np.arange(len(poses)) % 8]
        )
        self.inputs[self._fixes, INPUTS["fix_x"]] = seen[..., 0].T
        self.inputs[self._fixes, INPUTS["fix_y"]] = seen[..., 1].T
        self.inputs[self._fixes, INPUTS["fix_variance"]] = FIX_SIGMA**2
        fixed = number % OF_LAPS < WITH_FIXES
        self.inputs[self._fixes, INPUTS["fix_mode"]] = GATED if fixed else SKIPPED
        part = slice(min(number, 1), None)
        steps = self.steps.part(min(number, 1), len(self.steps.kinds))
        room = np.zeros((1, 18, self.filters.width))
        self.filters.work_through(self.lanes, self.inputs[part], steps, self.table[part], room)
        self._begin = poses[:, -1]

    def state(self, lane: int) -> tuple[Floats, Floats]:
        """State and covariance of what is estimated."""
        return self.filters.state(self.lanes, lane)


def main() -> None:
    """Run both and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--steps", type=int, default=1_000_000, help="of each filter")
    arguments = parser.parse_args()
    laps = {bits: Laps(bits, seed=1) for bits in PRECISIONS}
    count = int(arguments.steps / (LAP * RATE))
    least = dict.fromkeys(laps, np.inf)
    failed, checks = dict.fromkeys(laps, 0), dict.fromkeys(laps, 0)
    off, spread = 0.0, [np.inf, 0.0]
    begin = time.perf_counter()
    for number in range(count):
        for bits, one in laps.items():
            one.lap(number)
            for lane in range(8):
                smallest = smallest_correlation(one.state(lane)[1])
                checks[bits] += 1
                failed[bits] += not smallest > 0.0
                least[bits] = min(least[bits], smallest)
        for lane in range(8):
            (x, P), (y, Q) = laps[64].state(lane), laps[32].state(lane)
            sigma, single = np.sqrt(np.diagonal(P)), np.sqrt(np.diagonal(Q))
            known = np.flatnonzero(sigma[LEARNT] > 0.0) + LEARNT.start
            off = max(off, float(np.abs((y - x)[known] / sigma[known]).max()))
            ratio = single[known] / sigma[known]
            spread = [min(spread[0], float(ratio.min())), max(spread[1], float(ratio.max()))]
    elapsed = time.perf_counter() - begin
    rows = [
        [f"{bits} bits", f"{count * LAP * RATE:,.0f}", str(one.filters.width), str(checks[bits]),
         str(failed[bits]), f"{least[bits]:.1e}"]
        for bits, one in laps.items()
    ]  # fmt: skip
    head = ["numbers", "steps of each filter", "filters", "checks", "failed", "smallest eigenvalue"]
    table(head, rows)
    print(
        f"\nsingle against double precision: what is learnt is off by {off:.3f} sigma at most, its sigma "
        f"{spread[0]:.4f} to {spread[1]:.4f} times as large ({elapsed:.0f} s)"
    )


if __name__ == "__main__":
    main()
