"""What faults do to the estimate, and how soon it is over; friction is the truth.

Every fault is put into the log of a run that is also scored without it, so each figure is paired: the
same drive, robot and noise. Everyday driving for 150 s, a position fix each second until 120 s and none
after.

- outliers: a tenth of the fixes from 20 s to 120 s lie 10 m off, in a random direction
- stuck encoder: the left track reads from 60 s to 63 s what it read at 60 s
- IMU drop-out: no IMU samples from 60 s to 65 s
- wrong parameters: all indices, ICRs, the length of the contact and the rolling resistance that the robot
  file gives are half as much again
- bias while driving: the filter is started at 20 s, on the move, with 0.05 rad/s of gyro bias, five times
  the standard deviation that the robot file gives

The error is the RMS over the runs. It counts as back when its mean over 5 s is within 1.2 times that
without the fault, and NEES (mean over the runs) when it is within twice its ideal or 1.2 times that
without the fault, both for 10 s; seconds are from the end of the fault, or from the start where it
lasts on, and up to the end of the fixes. Intervals are 95 % bootstrap intervals over the runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np
from _friction import (
    NEES_GOAL,
    ONLINE,
    curves,
    fixes_of,
    seconds_to_return,
    smooth,
    told_seconds,
    true_poses,
)
from _study import bootstrap, spread, study_parser, table, told

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import FixSeries, ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import PAPER_PARAMETERS, ConstantIcr, Robot, load_robot
from icreckon.estimator.streaming.run import run
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

SEED = 20_244
FIXES_END, DURATION = 120, 150
SECOND = 1_000_000_000
BACK = 1.2
OUTLIER_SHARE, OUTLIER_DISTANCE = 0.1, 10.0
WRONG_BY = 1.5
BIAS = 0.05
RESAMPLES = 500


class Fault(NamedTuple):
    """A fault: when it begins and ends [s], what it does to the log and to the robot file.

    `begins` is also when the filter is started if `late_start`.
    """

    begins: int
    ends: int
    log: Callable[[Log, int], Log] = lambda log, _: log
    robot: Callable[[Robot], Robot] = lambda robot: robot
    late_start: bool = False


def with_outliers(log: Log, index: int) -> Log:
    """A tenth of the fixes far off."""
    fixes = fixes_of(log)
    rng = np.random.default_rng([SEED, index, 1])
    count = len(fixes.stamps)
    hit = (rng.random(count) < OUTLIER_SHARE) & (fixes.stamps >= log.start + 20 * SECOND)
    angle = rng.uniform(-np.pi, np.pi, count)
    poses = fixes.poses.copy()
    poses[hit, 0] += OUTLIER_DISTANCE * np.cos(angle[hit])
    poses[hit, 1] += OUTLIER_DISTANCE * np.sin(angle[hit])
    return replace(log, fixes=FixSeries(fixes.stamps, poses, fixes.variances))


def with_stuck_encoder(log: Log, _: int) -> Log:
    """The left track repeats itself."""
    stamps, speeds = log.tracks.stamps, log.tracks.speeds.copy()
    stuck = (stamps >= log.start + 60 * SECOND) & (stamps < log.start + 63 * SECOND)
    speeds[stuck, 0] = speeds[np.flatnonzero(stuck)[0], 0]
    return replace(log, tracks=TrackSpeedSeries(stamps, speeds))


def with_drop_out(log: Log, _: int) -> Log:
    """The IMU is silent."""
    imu = log.imu
    if imu is None or imu.linear_acceleration is None:
        raise ValueError("a simulated log has an IMU")
    keep = (imu.stamps < log.start + 60 * SECOND) | (imu.stamps >= log.start + 65 * SECOND)
    silent = ImuSeries(imu.stamps[keep], imu.angular_velocity[keep], imu.linear_acceleration[keep])
    return replace(log, imu=silent)


def with_bias(log: Log, _: int) -> Log:
    """The gyro reads more."""
    imu = log.imu
    if imu is None:
        raise ValueError("a simulated log has an IMU")
    rates = imu.angular_velocity + np.array([0.0, 0.0, BIAS])
    return replace(log, imu=replace(imu, angular_velocity=rates))


def with_wrong_parameters(robot: Robot) -> Robot:
    """What the robot file says of the motion is half as much again."""
    indices, icr, vehicle = robot.indices, robot.constant_icr, robot.vehicle
    names = PAPER_PARAMETERS[1:]
    longer = msgspec.structs.replace(
        vehicle, half_contact_length=WRONG_BY * vehicle.half_contact_length
    )
    soil = robot.contact.soil
    return msgspec.structs.replace(
        robot,
        vehicle=longer,
        indices=msgspec.structs.replace(
            indices, **{name: WRONG_BY * getattr(indices, name) for name in names}
        ),
        constant_icr=icr
        and ConstantIcr(WRONG_BY * icr.x_ICRl, WRONG_BY * icr.x_ICRr, WRONG_BY * icr.y_ICR),
        soil=msgspec.structs.replace(soil, rolling_resistance=WRONG_BY * soil.rolling_resistance),
    )


FAULTS = {
    "outliers": Fault(20, FIXES_END, with_outliers),
    "stuck encoder": Fault(60, 63, with_stuck_encoder),
    "IMU drop-out": Fault(60, 65, with_drop_out),
    "wrong parameters": Fault(0, 0, robot=with_wrong_parameters),
    "bias while driving": Fault(20, 20, with_bias, late_start=True),
}
Job = tuple[str, int, tuple[str, ...]]


def score(job: Job) -> Floats:
    """(faults, 2, 2, n) without and with each fault: squared position error and NEES, each second."""
    variant, index, names = job
    robot = load_robot("auriga-alpha")
    scenario = Scenario(
        duration=float(DURATION),
        seed=SEED,
        truth_rate=5.0,
        outages=((float(FIXES_END), float(DURATION)),),
    )
    whole = simulate(scenario, robot, run_index=index)
    found = []
    without: dict[int, Floats] = {}
    for fault in map(FAULTS.__getitem__, names):
        begin = fault.begins if fault.late_start else 0
        log, pose = whole, (0.0, 0.0, 0.0)
        if begin:
            stamp = whole.start + begin * SECOND
            x, y, yaw = interpolate_poses(true_poses(whole), np.array([stamp]))[0].tolist()
            log, pose = since(whole, stamp), (x, y, yaw)

        def errors(log: Log, robot: Robot, pose: tuple[float, float, float] = pose) -> Floats:
            one = curves(run(log, robot, variant, start=pose), log, whole.start, DURATION)
            return np.array([one.position**2, one.nees])

        if begin not in without:
            without[begin] = errors(log, robot)
        found.append((without[begin], errors(fault.log(log, index), fault.robot(robot))))
    return np.array(found)


def since(log: Log, stamp: int) -> Log:
    """The part of a log from a stamp [ns] on."""
    tracks, imu, fixes = log.tracks, log.imu, fixes_of(log)
    if imu is None or imu.linear_acceleration is None:
        raise ValueError("a simulated log has an IMU")
    t, i, f = (stamps >= stamp for stamps in (tracks.stamps, imu.stamps, fixes.stamps))
    return replace(
        log,
        tracks=TrackSpeedSeries(tracks.stamps[t], tracks.speeds[t]),
        imu=ImuSeries(imu.stamps[i], imu.angular_velocity[i], imu.linear_acceleration[i]),
        fixes=FixSeries(fixes.stamps[f], fixes.poses[f], fixes.variances[f]),
    )


def returns(found: Floats, fault: Fault) -> tuple[float, float]:
    """Seconds until error and NEES are back, of runs (n, 2, 2, seconds)."""
    ends = FIXES_END if fault.ends < FIXES_END else DURATION
    mean = smooth(found.mean(axis=0)[..., fault.ends : ends])
    error = seconds_to_return(np.sqrt(mean[1, 0]), BACK * np.sqrt(mean[0, 0]))
    nees = seconds_to_return(mean[1, 1], np.maximum(NEES_GOAL[1], BACK * mean[0, 1]))
    return error, nees


def fault_row(name: str, variant: str, found: Floats) -> list[str]:
    """A row of the table, of runs (n, 2, 2, seconds)."""
    fault = FAULTS[name]
    # NEES means nothing while the pose is known to nothing, and errors nothing before the start.
    found = np.nan_to_num(found)
    rms = np.sqrt(found[:, :, 0].mean(axis=0))
    later = slice(fault.begins + 1, FIXES_END)
    worst = fault.begins + 1 + int(np.argmax(rms[1, later]))
    ratio = bootstrap(
        lambda x: np.sqrt(x[..., 1].mean(-1) / x[..., 0].mean(-1)),
        found[:, :, 0, fault.begins + 1 : FIXES_END].mean(axis=-1),
    )
    at_end = bootstrap(
        lambda x: np.sqrt(x[..., 1].mean(-1) / x[..., 0].mean(-1)), found[:, :, 0, -1]
    )
    cells = [
        name,
        f"`{variant}`",
        f"{rms[0, worst]:.2f}",
        f"{rms[1, worst]:.2f}",
        told(*ratio),
    ]
    if fault.ends < FIXES_END:
        picks = np.random.default_rng(0).integers(0, len(found), (RESAMPLES, len(found)))
        times = np.array([returns(found[pick], fault) for pick in picks])
        low, high = np.percentile(times, (2.5, 97.5), axis=0, method="nearest")
        cells += [
            told_seconds(np.array(one))
            for one in zip(returns(found, fault), low, high, strict=True)
        ]
    else:
        cells += ["", ""]
    nees = found[:, :, 1, fault.begins + 1 : FIXES_END].mean(axis=(0, 2))
    return [*cells, f"{nees[0]:.1f}", f"{nees[1]:.1f}", told(*at_end)]


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 20, ONLINE)
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    arguments = parser.parse_args()
    names = tuple(arguments.faults)
    jobs = [(name, index, names) for name in arguments.variants for index in range(arguments.runs)]
    scores = np.array(spread(score, jobs, arguments.workers))
    scores = scores.reshape(len(arguments.variants), arguments.runs, *scores.shape[1:])
    print(f"{arguments.runs} runs of {DURATION} s for each row\n")
    head = (
        "fault",
        "variant",
        "error without, m",
        "with, at worst, m",
        "with over without, under fixes",
        "error back after, s",
        "NEES back after, s",
        "NEES without",
        "with",
        "error over that without, after 30 s of dead reckoning",
    )
    rows = [
        fault_row(name, variant, found[:, place])
        for place, name in enumerate(names)
        for variant, found in zip(arguments.variants, scores, strict=True)
    ]
    table(head, rows)


if __name__ == "__main__":
    main()
