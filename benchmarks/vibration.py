"""A shaking gyro: resting tracks, a turntable, and a drive, with the noise of the robot file wrong.

    python benchmarks/vibration.py [--runs N] [--variants NAMES] [--data DATA]

The gyro of Auriga-alpha has a bias of -0.005 rad/s and noise of 0.05 rad/s at 100 Hz (a density of
0.005 rad/s/√Hz): white, or a sinusoid of the same power. The robot file has this density, or another one.
Figures are RMS over the runs, and the filter's own standard deviation (RMS) times three.

- At rest: ten minutes with resting tracks; error of yaw and of the bias at the end.
- Turntable: two minutes with resting tracks; from 60 s to 90 s the robot is turned. Lost is the turn that
  the yaw does not show, and the change of the bias.
- Drive: 60 s with friction as truth after ten seconds at rest; error of the position over the distance.
  Accelerometers are shaken, too, with 0.5 m/s² in each sample, where the file has 0.1.

With --data the noise that the filter measures in the sample logs is printed, over that of the robot
files: least, median and largest from the first second on.

A calm gyro has a tenth of this noise, and so have the accelerometers. A sinusoid of 50 Hz that is sampled
at 50 Hz is a constant, which no filter separates from a turn.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from _logs import LOGS
from _study import spread, study_parser, table

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.batch.feed_arrays import feed_arrays
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.imu_noise import NoiseRecord, measure_noise, measured_noise
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import run_scenario

DENSITY, BIAS = 0.005, -0.005
REST, TURN, TURN_BEGIN, TURN_END = 600.0, 120.0, 60.0, 90.0
STAND, DRIVE, DRIVE_RATE = 10.0, 60.0, 100.0
FORCE_SIGMA = 0.5
# What the file has, over what is.
FACTORS = (1.0 / 30.0, 0.32, 1.0, 30.0)
RATES = (50, 100, 200, 400)
HERTZ = (12.0, 30.0, 50.0)
TURNS = (0.02, 0.06, 0.3)
VARIANTS = ("gyro", "differential", "constant-online", "inertia-online", "friction-online")


class Job(NamedTuple):
    """A run.

    Attributes:
        what: "rest", "turn" or "drive".
        variant: filter variant.
        rate: rate of the IMU [Hz].
        factor: noise density of the robot file over the true one.
        hertz: frequency of the vibration; 0 for white noise.
        turn: rate of the turntable [rad/s].
        seed: seed of the noise.
        shaken: noise over that of the other runs.
    """

    what: str
    variant: str = "constant-online"
    rate: int = 100
    factor: float = 1.0
    hertz: float = 0.0
    turn: float = 0.0
    seed: int = 0
    shaken: float = 1.0


class Found(NamedTuple):
    """Errors of a run, and standard deviations that the filter gives.

    Attributes:
        yaw: error of yaw [deg].
        yaw_sigma: its own standard deviation [deg].
        bias: error of the bias [rad/s].
        drift: error of the position over the distance [%].
        standing: share of samples at which the robot was found standing.
    """

    yaw: float
    yaw_sigma: float
    bias: float
    drift: float
    standing: float


def robot_of(job: Job) -> Robot:
    """Robot with the file's noise of a run."""
    robot = load_robot("auriga-alpha")
    density = DENSITY * job.shaken * job.factor
    imu = msgspec.structs.replace(robot.imu, gyro_noise_density=density, position=(0.0, 0.0, 0.0))
    return msgspec.structs.replace(robot, imu=imu)


def shaking(job: Job, t: Floats, rng: np.random.Generator) -> Floats:
    """Noise (n,) of the gyro at some times [rad/s]."""
    if job.hertz:
        sigma = DENSITY * job.shaken * 10.0
        phase = rng.uniform(0.0, 2.0 * np.pi)
        return np.asarray(sigma * np.sqrt(2.0) * np.sin(2.0 * np.pi * job.hertz * t + phase))
    return DENSITY * job.shaken * np.sqrt(job.rate) * rng.standard_normal(len(t))


def at_rest(job: Job) -> Found:
    """Resting tracks, on a turntable or not."""
    rng = np.random.default_rng(job.seed)
    seconds = REST if job.what == "rest" else TURN
    t = np.arange(int(seconds * job.rate)) / job.rate
    turned = np.where((t > TURN_BEGIN) & (t < TURN_END), job.turn, 0.0)
    rates = np.zeros((len(t), 3))
    rates[:, 2] = turned + BIAS + shaking(job, t, rng)
    forces = np.column_stack(
        [FORCE_SIGMA * job.shaken * rng.standard_normal((len(t), 2)), np.full(len(t), 9.81)]
    )
    track_t = np.arange(int(seconds * 50.0)) / 50.0
    estimator = PoseEstimator(robot_of(job), job.variant, settings=Settings(history=0.0))
    tracks = TrackSpeedSeries(stamps_of(track_t), np.zeros((len(track_t), 2)))
    feed_arrays(estimator, tracks, ImuSeries(stamps_of(t), rates, forces))
    standing = estimator.health.standstill_updates / len(t)
    return found_in(estimator, float(np.trapezoid(turned, t)), float("nan"), standing)


def driving(job: Job) -> Found:
    """A stand and a drive, with friction as truth."""
    rng = np.random.default_rng(job.seed)
    rate = float(job.rate)
    scenario = Scenario(
        duration=DRIVE, seed=20_246, noise="perfect", slip_noise=0.0, imu_rate=rate, fix_rate=0.0
    )
    robot = robot_of(job)
    log = run_scenario(scenario, robot, run_index=job.seed).log
    if log.imu is None or log.truth is None or log.imu.linear_acceleration is None:
        raise ValueError("the simulator gives an IMU and a truth")
    # Before the drive the robot stands.
    waits = np.arange(int(STAND * rate)) / rate
    stamps = np.concatenate([stamps_of(waits), log.imu.stamps - log.imu.stamps[0] + stamp(STAND)])
    rates = np.concatenate([np.zeros((len(waits), 3)), log.imu.angular_velocity])
    forces = np.concatenate(
        [np.tile([0.0, 0.0, 9.81], (len(waits), 1)), log.imu.linear_acceleration]
    )
    rates[:, 2] += BIAS + shaking(job, stamps * 1e-9, rng)
    forces[:, :2] += FORCE_SIGMA * job.shaken * rng.standard_normal((len(stamps), 2))
    track_t = np.arange(int(STAND * 50.0)) / 50.0
    begin = int(log.tracks.stamps[0])
    track_stamps = np.concatenate([stamps_of(track_t), log.tracks.stamps - begin + stamp(STAND)])
    speeds = np.concatenate([np.zeros((len(track_t), 2)), log.tracks.speeds])
    truth = log.truth.poses
    start = truth.poses[0].tolist()
    settings = Settings(history=0.0)
    estimator = PoseEstimator(robot, job.variant, settings=settings, start=tuple(start))
    feed_arrays(estimator, TrackSpeedSeries(track_stamps, speeds), ImuSeries(stamps, rates, forces))
    at = int(stamps[-1]) - stamp(STAND) + int(log.imu.stamps[0])
    end = interpolate_poses(truth, np.array([min(at, int(truth.stamps[-1]))]))[0]
    distance = float(np.hypot(*np.diff(truth.poses[:, :2], axis=0).T).sum())
    drift = 100.0 * float(np.hypot(*(estimator.pose - end)[:2])) / distance
    return found_in(estimator, float(end[2]), drift, float("nan"))


def found_in(estimator: PoseEstimator, yaw: float, drift: float, standing: float) -> Found:
    """Errors of an estimator at the end of its run."""
    return Found(
        float(np.degrees(estimator.pose[2] - yaw)),
        float(np.degrees(estimator.pose_covariance[2, 2] ** 0.5)),
        estimator.biases["gyro_bias"] - BIAS,
        drift,
        standing,
    )


def stamp(seconds: float) -> int:
    """Stamp at a time [ns]."""
    return round(seconds * 1e9)


def stamps_of(t: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Stamps (n,) at some times [ns]."""
    return np.rint(t * 1e9).astype(np.int64)


def score(job: Job) -> Found:
    """Errors of one run."""
    return driving(job) if job.what == "drive" else at_rest(job)


def jobs_of(variants: list[str], runs: int) -> dict[str, list[tuple[tuple[str, ...], list[Job]]]]:
    """Rows of each table: labels, and the runs."""

    def seeded(make: Callable[[int], Job]) -> list[Job]:
        return [make(seed) for seed in range(runs)]

    of_file = {factor: f"{factor:.2g}" for factor in FACTORS}
    rest = [
        (
            (f"{rate}", of_file[f]),
            seeded(lambda k, r=rate, f=f: Job("rest", rate=r, factor=f, seed=k)),
        )
        for rate in RATES
        for f in FACTORS
    ]
    by_variant = [
        ((name, of_file[f]), seeded(lambda k, n=name, f=f: Job("rest", n, factor=f, seed=k)))
        for name in variants
        for f in (0.32, 1.0)
    ]
    coloured = [
        (
            (f"{hertz:g}", f"{rate}", of_file[f]),
            seeded(lambda k, h=hertz, r=rate, f=f: Job("rest", rate=r, factor=f, hertz=h, seed=k)),
        )
        for hertz in HERTZ
        for rate in RATES
        for f in (FACTORS[0], 1.0)
    ]
    turns = [
        (
            (f"{turn:g}", name, of_file[f]),
            seeded(lambda k, w=turn, f=f, s=s: Job("turn", factor=f, turn=w, seed=k, shaken=s)),
        )
        for turn in TURNS
        for name, s, f in (("calm", 0.1, 1.0), ("shaken", 1.0, 0.32), ("shaken", 1.0, FACTORS[0]))
    ]
    drives = [
        (
            (name, label, of_file[f]),
            seeded(lambda k, n=name, f=f, s=s: Job("drive", n, factor=f, seed=k, shaken=s)),
        )
        for name in variants
        for label, s, f in (("calm", 0.1, 1.0), *(("shaken", 1.0, f) for f in FACTORS))
    ]
    return {
        "At rest, 10 min, by rate": rest,
        "At rest, 10 min, by variant": by_variant,
        "At rest, 10 min, sinusoid": coloured,
        "Turntable": turns,
        "Drive": drives,
    }


AXES = ("gyro", "accelerometer_x", "accelerometer_y")


def measured_in(data: Path, name: str) -> Floats:
    """Measured noise (n, 3) over that of the robot file, after each IMU sample of a log."""
    robot = load_robot(LOGS[name])
    log, sensors, record = read_log(data / name, robot), SensorModels(robot), NoiseRecord()
    if log.imu is None or log.imu.linear_acceleration is None:
        raise ValueError(f"{name} has no IMU with accelerometers")
    rates = sensors.yaw_rates(log.imu.angular_velocity)
    forces = sensors.along_ground_of(log.imu.linear_acceleration)
    samples = np.column_stack([rates, forces]).tolist()
    found = np.empty((len(samples), 3))
    for k, (at, sample) in enumerate(zip(log.imu.stamps.tolist(), samples, strict=True)):
        measure_noise(record, at, *sample, Settings().hold)
        found[k] = [measured_noise(getattr(record, axis)) for axis in AXES]
    of_force = robot.imu.accelerometer_noise_density
    later = log.imu.stamps >= log.imu.stamps[0] + stamp(1.0)
    return np.asarray(found[later] / [robot.imu.gyro_noise_density, of_force, of_force])


def print_logs(data: Path) -> None:
    """Print the noise of the sample logs."""
    rows = []
    for name in LOGS:
        low, middle, high = np.percentile(measured_in(data, name), (0, 50, 100), axis=0).tolist()
        cells = zip(low, middle, high, strict=True)
        rows.append((name, *(" / ".join(f"{one:.2f}" for one in cell) for cell in cells)))
    print("\nMeasured noise over that of the robot file: least / median / largest\n")
    table(("log", *AXES), rows)


HEADS = {
    "At rest, 10 min, by rate": ("IMU [Hz]", "file's noise over true"),
    "At rest, 10 min, by variant": ("variant", "file's noise over true"),
    "At rest, 10 min, sinusoid": ("vibration [Hz]", "IMU [Hz]", "file's noise over true"),
    "Turntable": ("turn [rad/s]", "gyro", "file's noise over true"),
    "Drive": ("variant", "gyro", "file's noise over true"),
}


def rms(values: list[float]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Print all tables."""
    parser = study_parser(__doc__, 8, VARIANTS)
    parser.add_argument("--data", type=Path, help="folder of the sample logs")
    options = parser.parse_args()
    if options.data is not None:
        print_logs(options.data)
        return
    for title, rows in jobs_of(options.variants, options.runs).items():
        jobs = [job for _, of_row in rows for job in of_row]
        scores = iter(spread(score, jobs, options.workers))
        head = (*HEADS[title], "yaw error [deg]", "own 3 sigma [deg]", "bias error [rad/s]")
        head = (*head, "drift [%]") if title == "Drive" else (*head, "found standing [%]")
        body = []
        for labels, of_row in rows:
            found = [next(scores) for _ in of_row]
            last = (
                f"{np.mean([one.drift for one in found]):.2f}"
                if title == "Drive"
                else f"{100.0 * np.mean([one.standing for one in found]):.1f}"
            )
            yaw, sigma = rms([one.yaw for one in found]), rms([one.yaw_sigma for one in found])
            bias = rms([one.bias for one in found])
            body.append((*labels, f"{yaw:.2f}", f"{3.0 * sigma:.2f}", f"{bias:.5f}", last))
        print(f"\n{title}\n")
        table(head, body)


if __name__ == "__main__":
    main()
