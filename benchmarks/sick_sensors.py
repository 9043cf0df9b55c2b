"""Sensors that lie: error of the motion meanwhile, own uncertainty, and what `health` shows.

    python benchmarks/sick_sensors.py [LOGS] [--runs N] [--faults NAME ...]

Everyday driving of auriga-alpha on the friction model. Each fault begins after 30 s, unless it says
otherwise. The error is that of
the motion from the start of the fault to a second after its end, of position and of yaw, root mean square
over the runs, beside the filter's own standard deviation of that motion; NEES is the mean over the runs
of its squared error over its covariance, over three degrees of freedom (1 is ideal). `shown` is the share
of drives in which `health` shows the fault at its end.

- carried: the tracks read zero for 10 s while the robot moves, after 3 s at rest
- expected: the robot file has `[undetected_slip]` with a share of 0.5

In the table after it two of these faults last to the end of the drive, a minute: in how many drives
they are found, and after how long (median); errors of yaw and position at the end, and own standard
deviations.
In the next the gyro's bias jumps by 0.02 rad/s after 40 s, under fixes of 5 cm each second: yaw
error and own standard deviation so many seconds later, and the share of the jump in the estimated bias.
In another the receiver repeats its position from 30 s on, with fresh stamps, for 30 s: largest error of
the position in that time, and own standard deviation then.
In the last the IMU is tilted by 10 degrees, which the robot file does not have: what `health.tilt`
shows after 48 s.

LOGS is the folder of the sample logs: each time that the gyro is found failing in them is counted, and
each time that the robot is found carried. None of them has such a fault that is known.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import msgspec
import numpy as np
from _logs import logs_without
from _study import table

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import relative, rpy_to_matrix, wrap_angle
from icreckon.estimator.base.state import GYRO_BIAS, YAW
from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.faults import repeating_fixes
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, UndetectedSlip, load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

SECOND = 1_000_000_000
BEGINS, AFTER = 30.0, 1.0
RESTS = 2.8
"""Time within the standstill at the start of a drive [s]."""
JUMP, JUMPS_AT, LATER = 0.02, 40.0, (5, 10, 15, 20, 40)
FIX_RATES = (1.0, 5.0, 20.0)
MOUNTS = ((10.0, 0.0), (0.0, 10.0), (0.0, 0.0))
VARIANTS = ("gyro", "constant-online", "inertia-online", "friction-online")


class Fault(NamedTuple):
    """A fault of a log.

    Attributes:
        lasts: duration [s].
        put: function of a log and of the times since the fault began, for its faulty twin.
        shown: function of the health at its end; True if that shows the fault.
        robot: function of the robot file, for the one that is used.
        begins: when it begins [s].
    """

    lasts: float
    put: Callable[[Log], Log]
    shown: Callable[[Health], bool]
    robot: Callable[[Robot], Robot] = lambda robot: robot
    begins: float = BEGINS


def imu_of(log: Log) -> ImuSeries:
    """IMU of a log that has one."""
    if log.imu is None:
        raise ValueError("a simulated log has an IMU")
    return log.imu


def with_rate(log: Log, lasts: float, change: Callable[[Floats], Floats]) -> Log:
    """Copy of a log whose yaw rates are changed while a fault lasts."""
    imu = imu_of(log)
    since = (imu.stamps - log.start) / SECOND - BEGINS
    hit, rates = (since >= 0.0) & (since < lasts), imu.angular_velocity.copy()
    rates[hit, 2] = change(rates[hit, 2])
    return replace(log, imu=replace(imu, angular_velocity=rates))


def with_tracks(
    log: Log, lasts: float, change: Callable[[Floats], Floats], begins: float = BEGINS
) -> Log:
    """Copy of a log whose track speeds are changed while a fault lasts."""
    stamps, speeds = log.tracks.stamps, log.tracks.speeds.copy()
    since = (stamps - log.start) / SECOND - begins
    hit = (since >= 0.0) & (since < lasts)
    speeds[hit] = change(speeds[hit])
    return replace(log, tracks=TrackSpeedSeries(stamps, speeds))


def gyro_failed(health: Health) -> bool:
    """Return True if a fault of the gyro was found."""
    return sum(health.sensors["gyro"].rejected.values()) > 5


def track_spins(health: Health) -> bool:
    """Return True if a track was found spinning."""
    return health.slip.times > 0


def slides(health: Health) -> bool:
    """Return True if the robot was found sliding, or carried."""
    return health.slip.slides > 0 or health.slip.carries > 0


def with_expected_slip(robot: Robot) -> Robot:
    """Robot file with slip that no sensor shows."""
    return msgspec.structs.replace(robot, undetected_slip=UndetectedSlip(share=0.5))


def with_both_spinning(log: Log) -> Log:
    """Copy of a log both of whose tracks spin, at once."""
    return with_tracks(log, 10.0, lambda speeds: speeds + 0.5)


def with_noise(rates: Floats) -> Floats:
    """Rates with noise of 3 mrad/s, as a sensor has whose element sticks or saturates."""
    return rates + np.random.default_rng(0).normal(0.0, 0.003, len(rates))


def gyro_fault(change: Callable[[Floats], Floats], lasts: float = 10.0) -> Fault:
    """Fault of the gyro."""
    return Fault(lasts, lambda log: with_rate(log, lasts, change), gyro_failed)


# Changes of the yaw rates that may last for good.
FOR_GOOD: dict[str, Callable[[Floats], Floats]] = {
    "gyro reads noise alone": lambda rates: with_noise(np.zeros_like(rates)),
    "gyro's sign is turned": np.negative,
}
# Faults that look like another motion to a filter that has nothing but gyro and tracks.
LIKE_MOTION = {
    "gyro reads noise alone": gyro_fault(FOR_GOOD["gyro reads noise alone"]),
    "gyro clipped at 0.3 rad/s, with noise": gyro_fault(
        lambda rates: with_noise(rates.clip(-0.3, 0.3))
    ),
    "gyro reads 0.05 rad/s more": gyro_fault(lambda rates: rates + 0.05),
    "gyro reads 0.2 rad/s more": gyro_fault(lambda rates: rates + 0.2),
    "gyro reads 1.5 times the rate": gyro_fault(lambda rates: 1.5 * rates),
    "gyro's sign is turned": gyro_fault(FOR_GOOD["gyro's sign is turned"]),
}
FAULTS = {
    "gyro reads 2.0 rad/s": Fault(
        1.0, lambda log: with_rate(log, 1.0, lambda rates: np.full_like(rates, 2.0)), gyro_failed
    ),
    "gyro reads 2.0 rad/s more": Fault(
        1.0, lambda log: with_rate(log, 1.0, lambda rates: rates + 2.0), gyro_failed
    ),
    "gyro repeats its reading": Fault(
        5.0,
        lambda log: with_rate(log, 5.0, lambda rates: np.full_like(rates, rates[0])),
        gyro_failed,
    ),
    "gyro clipped at 0.3 rad/s": Fault(
        10.0, lambda log: with_rate(log, 10.0, lambda rates: rates.clip(-0.3, 0.3)), gyro_failed
    ),
    "left track spins, +0.8 m/s": Fault(
        10.0,
        lambda log: with_tracks(log, 10.0, lambda speeds: speeds + np.array([0.8, 0.0])),
        track_spins,
    ),
    "both tracks spin, +0.5 m/s": Fault(10.0, with_both_spinning, slides),
    "both tracks spin, +0.5 m/s, expected": Fault(
        10.0, with_both_spinning, slides, with_expected_slip
    ),
    "carried": Fault(
        10.0, lambda log: with_tracks(log, 10.0, np.zeros_like, RESTS), slides, begins=RESTS
    ),
    **LIKE_MOTION,
}


class Motion(NamedTuple):
    """Motion over a fault: errors [m, rad], own standard deviations, NEES, and what was shown."""

    error: float
    sigma: float
    yaw: float
    yaw_sigma: float
    nees: float
    shown: bool


def motion_over_fault(log: Log, fault: Fault, robot: Robot, variant: str) -> Motion:
    """Run a variant up to a second after a fault."""
    estimator = PoseEstimator(fault.robot(robot), variant)
    begin = log.start + round(fault.begins * SECOND)
    end = begin + round((fault.lasts + AFTER) * SECOND)
    for measurement in fault.put(log).measurements():
        if measurement.stamp > end:
            break
        estimator.feed(measurement)
        if estimator.stamp == begin and begin not in estimator.marks:
            estimator.mark(begin)
    found = estimator.relative_motion(begin)
    if log.truth is None:
        raise ValueError("a simulated log has a truth")
    true = interpolate_poses(log.truth.poses, np.array([begin, end]))
    error = found.pose - relative(true[0], true[1])
    error[2] = (error[2] + np.pi) % (2.0 * np.pi) - np.pi
    P = found.covariance
    return Motion(
        float(np.hypot(*error[:2])),
        float(np.sqrt(np.trace(P[:2, :2]))),
        float(np.degrees(error[2])),
        float(np.degrees(np.sqrt(P[2, 2]))),
        float(error @ np.linalg.solve(P, error)) / 3.0,
        fault.shown(estimator.health),
    )


def drives(robot: Robot, runs: int) -> list[Log]:
    """Drives without a fault."""
    return [
        simulate(Scenario(duration=48.0, seed=seed, trajectory="random", fix_rate=0.0), robot)
        for seed in range(runs)
    ]


def fault_row(drives: list[Log], robot: Robot, name: str, variant: str) -> list[str]:
    """Row of the table of faults."""
    found = [motion_over_fault(log, FAULTS[name], robot, variant) for log in drives]
    return [
        name,
        f"`{variant}`",
        f"{rms([one.error for one in found]):.2f}",
        f"{rms([one.sigma for one in found]):.2f}",
        f"{rms([one.yaw for one in found]):.1f}",
        f"{rms([one.yaw_sigma for one in found]):.1f}",
        f"{np.mean([one.nees for one in found]):.1f}",
        f"{sum(one.shown for one in found)} of {len(found)}",
    ]


def failed_for_good(robot: Robot, variant: str, runs: int, name: str) -> list[str]:
    """Row of the table of gyros that fail for good."""
    times, errors = [], []
    for seed in range(runs):
        lasting = Scenario(duration=90.0, seed=seed, trajectory="random", fix_rate=0.0)
        log = with_rate(simulate(lasting, robot), 60.0, FOR_GOOD[name])
        one = run(log, robot, variant)
        if log.truth is None:
            raise ValueError("a simulated log has a truth")
        gyro, true = one.health.gyro, interpolate_poses(log.truth.poses, one.stamps[-1:])[0]
        if gyro.since is not None:
            times.append((gyro.since - log.start) / SECOND - BEGINS)
        off, sigma = one.trajectory.poses[-1] - true, one.state_sigmas[-1]
        yaw = np.degrees([wrap_angle(off[2]), sigma[YAW]])
        errors.append((*yaw, np.hypot(*off[:2]), np.hypot(*sigma[:2])))
    cells = [f"{rms(np.array(column)):.1f}" for column in zip(*errors, strict=True)]
    after = f"{np.median(times):.0f}" if times else ""
    return [name, f"`{variant}`", f"{len(times)} of {runs}", after, *cells]


def bias_jumps(robot: Robot, variant: str, runs: int) -> list[str]:
    """Row of the table of biases that jump: error, own sigma and share learnt; refused fixes."""
    found, refused = [], 0
    for seed in range(runs):
        log = simulate(Scenario(duration=90.0, seed=seed, trajectory="random"), robot)
        begin = log.start + round(JUMPS_AT * SECOND)
        imu = imu_of(log)
        rates = imu.angular_velocity.copy()
        rates[imu.stamps > begin, 2] += JUMP
        one = run(replace(log, imu=replace(imu, angular_velocity=rates)), robot, variant)
        if log.truth is None:
            raise ValueError("a simulated log has a truth")
        rows = np.searchsorted(one.stamps, [begin, *(begin + k * SECOND for k in LATER)])
        true = interpolate_poses(log.truth.poses, one.stamps[rows])
        off = wrap_angle(one.trajectory.poses[rows, 2] - true[:, 2])
        learnt = (one.states[rows, GYRO_BIAS] - one.states[rows[0], GYRO_BIAS]) / JUMP
        found.append((off, one.state_sigmas[rows, YAW], learnt))
        refused += one.health.sensors["position"].rejected.get("gate", 0)
    off, sigmas, learnt = np.array(found).transpose(1, 0, 2)
    cells = [
        f"{np.degrees(rms(off[:, k])):.1f}, {np.degrees(rms(sigmas[:, k])):.1f}; "
        f"{learnt[:, k].mean():.0%}"
        for k in range(1, len(LATER) + 1)
    ]
    return [f"`{variant}`", *cells, f"{refused / runs:.1f}"]


def stuck_receiver(robot: Robot, variant: str, runs: int, rate: float) -> list[str]:
    """Row of the table of receivers that repeat a position: not used, and used."""
    refused = _stuck_receiver(robot, variant, runs, rate)
    with patch.object(repeating_fixes, "most_driven", return_value=math.inf):
        used = _stuck_receiver(robot, variant, runs, rate)
    return [f"{rate:g}", f"`{variant}`", *refused, *used[:2]]


def _stuck_receiver(robot: Robot, variant: str, runs: int, rate: float) -> list[str]:
    """Largest error, own sigma then, and runs in which `health` shows it."""
    found, refused = [], 0
    for seed in range(runs):
        scenario = Scenario(duration=60.0, seed=seed, trajectory="random", fix_rate=rate)
        log = simulate(scenario, robot)
        if log.fixes is None or log.truth is None:
            raise ValueError("a simulated log has fixes and a truth")
        poses, since = log.fixes.poses.copy(), log.fixes.stamps - log.start >= BEGINS * SECOND
        poses[since] = poses[since][0]
        one = run(replace(log, fixes=replace(log.fixes, poses=poses)), robot, variant)
        after = one.stamps - log.start >= BEGINS * SECOND
        true = interpolate_poses(log.truth.poses, one.stamps[after])
        off = np.hypot(*(one.trajectory.poses[after, :2] - true[:, :2]).T)
        worst = int(off.argmax())
        found.append((off[worst], np.hypot(*one.state_sigmas[after][worst, :2])))
        refused += "repeats itself" in one.health.sensors["position"].rejected
    off, sigma = np.array(found).T
    return [f"{rms(off):.2f}", f"{rms(sigma):.2f}", f"{refused} of {runs}"]


def tilt_found(robot: Robot, variant: str, runs: int, mount: tuple[float, float]) -> list[str]:
    """Row of the table of tilted IMUs."""
    R, found = rpy_to_matrix(np.radians(mount[0]), np.radians(mount[1]), 0.0), []
    for log in drives(robot, runs):
        imu = imu_of(log)
        if imu.linear_acceleration is None:
            raise ValueError("a simulated IMU has accelerometers")
        rates, forces = imu.angular_velocity @ R, imu.linear_acceleration @ R
        turned = replace(imu, angular_velocity=rates, linear_acceleration=forces)
        tilt = run(replace(log, imu=turned), robot, variant).health.tilt
        if tilt is not None:
            found.append((tilt.roll_deg, tilt.pitch_deg, tilt.is_wrong))
    roll, pitch, wrong = np.array(found).T
    shown = f"{round(wrong.sum())} of {runs}"
    tilted = f"{mount[0]:g}, {mount[1]:g}"
    return [tilted, f"`{variant}`", f"{roll.mean():.1f}", f"{pitch.mean():.1f}", shown]


def false_alarms(folder: Path) -> None:
    """Print what is found in the sample logs."""
    hours, faults, carries = 0.0, 0, 0
    for name, robot_name in logs_without("wetexplorer").items():
        robot = load_robot(robot_name)
        log = read_log(folder / name, robot)
        health = run_side_by_side(log, robot, ["gyro"])["gyro"].health
        print(f"{name}: gyro failed {health.gyro.times} times, carried {health.slip.carries} times")
        hours += log.duration / 3600.0
        faults, carries = faults + health.gyro.times, carries + health.slip.carries
    print(f"real logs, {hours:.2f} h: gyro failed {faults} times, carried {carries} times")


def rms(values: list[float] | Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    given = parser.parse_args()
    robot = load_robot("auriga-alpha")
    healthy = drives(robot, given.runs)
    variants, runs = given.variants, given.runs
    sigmas = ("error, m", "own sigma, m", "yaw error, deg", "own sigma, deg")
    table(
        ("fault", "variant", *sigmas, "NEES", "shown"),
        (fault_row(healthy, robot, name, one) for name in given.faults for one in variants),
    )
    print()
    head = ("fault", "variant", "found", "after, s", *sigmas[2:], *sigmas[:2])
    table(head, (failed_for_good(robot, one, runs, name) for name in FOR_GOOD for one in variants))
    print()
    head = ("variant", *(f"{k} s" for k in LATER), "refused fixes")
    table(head, (bias_jumps(robot, one, runs) for one in variants))
    print()
    head = ("fixes a second", "variant", *sigmas[:2], "shown", "if used: error, m", "own sigma, m")
    table(head, (stuck_receiver(robot, one, runs, rate) for rate in FIX_RATES for one in variants))
    print()
    inertial = [one for one in variants if one != "gyro"]
    table(
        ("IMU tilted by, deg", "variant", "found roll", "pitch", "reported"),
        (tilt_found(robot, one, runs, mount) for mount in MOUNTS for one in inertial),
    )
    print()
    if given.logs is not None:
        false_alarms(given.logs)


if __name__ == "__main__":
    main()
