"""Does it matter whether fixes come at the stamps of IMU samples, or between them?

Everyday driving of 60 s with friction as the truth, an IMU at 100 Hz; position fixes or body velocities
at 5 Hz, which fall on the stamps of IMU samples, or at 4.987 Hz, which do not. Drive, robot and noise are
the same. From 20 s on: the yaw's standard deviation as claimed, and RMS errors of yaw and position.
Intervals are 95 % bootstrap intervals over the runs.

    python benchmarks/fix_phase.py --runs 10
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from _friction import ONLINE, true_poses
from _study import bootstrap, spread, study_parser, table, told

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import BodyVelocity, Measurement
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

SEED = 20_248
DURATION, SETTLED = 60.0, 20.0
RATES = {"in phase": 5.0, "out of phase": 4.987}
KINDS = ("position fixes", "body velocities")
VELOCITY_SIGMA = 0.05
SECOND = 1_000_000_000
Job = tuple[str, str, str, int]


def with_velocities(log: Log, rate: float, index: int) -> Iterator[Measurement]:
    """The log with body velocities of a rate [Hz] in place of its fixes."""
    if log.truth is None or log.truth.twists is None:
        raise ValueError("a simulated log has a truth")
    rng = np.random.default_rng([SEED, index, 1])
    stamps = log.start + np.arange(1, int(DURATION * rate)) * round(SECOND / rate)
    twists = log.truth.twists
    at = [np.interp(stamps, twists.stamps, values) for values in twists.twists.T[:2]]
    read = np.array(at).T + VELOCITY_SIGMA * rng.standard_normal((len(stamps), 2))
    pending = list(
        map(BodyVelocity, stamps.tolist(), *read.T.tolist(), [VELOCITY_SIGMA**2] * len(stamps))
    )
    pending.reverse()
    for measurement in replace(log, fixes=None).measurements():
        while pending and pending[-1].stamp < measurement.stamp:
            yield pending.pop()
        yield measurement


def score(job: Job) -> Floats:
    """Claimed variance and squared error of yaw [rad²], and squared position error [m²], of one run."""
    variant, kind, phase, index = job
    rate = RATES[phase]
    robot = load_robot("auriga-alpha")
    scenario = Scenario(duration=DURATION, seed=SEED, fix_rate=rate)
    log = simulate(scenario, robot, run_index=index)
    fixes = kind == KINDS[0]
    stamps, poses, variances = [], [], []
    estimator = PoseEstimator(robot, variant)
    for measurement in log.measurements() if fixes else with_velocities(log, rate, index):
        estimator.feed(measurement)
        if estimator.stamp is not None and estimator.stamp > log.start + SETTLED * SECOND:
            stamps.append(estimator.stamp)
            poses.append(estimator.pose)
            variances.append(estimator.pose_covariance[2, 2])
    errors = np.array(poses) - interpolate_poses(true_poses(log), np.array(stamps))
    yaw = wrap_angle(errors[:, 2])
    return np.array([np.mean(variances), np.mean(yaw**2), np.mean(errors[:, :2] ** 2) * 2.0])


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 10, ONLINE)
    arguments = parser.parse_args()
    cells = [
        (name, kind, phase) for name in arguments.variants for kind in KINDS for phase in RATES
    ]
    jobs = [(*cell, index) for cell in cells for index in range(arguments.runs)]
    found = np.array(spread(score, jobs, arguments.workers))
    print(f"{arguments.runs} runs of {DURATION:.0f} s for each row\n")
    rows = []
    for (name, kind, phase), of_cell in zip(
        cells, found.reshape(len(cells), arguments.runs, 3), strict=True
    ):
        told_of = [
            told(*(unit * x for x in bootstrap(_rms, of_cell[:, [column]])), form)
            for column, unit, form in ((0, 1e3, ".1f"), (1, 1e3, ".1f"), (2, 1e2, ".1f"))
        ]
        rows.append([f"`{name}`", kind, f"{phase}, {RATES[phase]:g} Hz", *told_of])
    heads = ("yaw sigma claimed, mrad", "yaw error, mrad", "position error, cm")
    table(("variant", "measurements", "rate", *heads), rows)


def _rms(samples: Floats) -> Floats:
    return np.asarray(np.sqrt(samples[..., 0].mean(axis=-1)))


if __name__ == "__main__":
    main()
