"""A scenario: one simulated run as plain data, and the run itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.random import Generator, SeedSequence
from numpy.typing import NDArray

from estimator.log import Log, PoseSeries, TrackSpeedSeries, Truth, TwistSeries
from estimator.robot import Indices, Robot
from simulation.errors import SimulationError
from simulation.sensors import (
    accelerometer_noise,
    gyro_noise,
    noise_preset,
    read_fixes,
    read_imu,
    read_tracks,
    sample_times,
    to_stamps,
    track_noise,
)
from simulation.trajectories import check_trajectory, make_trajectory
from simulation.truth import DEFAULT_SPREAD, TrueMotion, check_truth, make_truth

Floats = NDArray[np.float64]

# Grid points per second of the true motion: a multiple of the IMU's rate, at least LOWEST_GRID, and
# two for each IMU sample where HIGHEST_GRID allows.
LOWEST_GRID = 200.0
HIGHEST_GRID = 1000.0
# More samples of one sensor than this are taken for a slip of the pen.
MOST_SAMPLES = 2e7


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What to simulate.

    Attributes:
        trajectory: name from `simulation.trajectories.TRAJECTORIES`.
        duration: length of the run [s]; its first 3 s are standstill.
        seed: seed of the study; a run's streams derive from it and the run's index.
        noise: name from `simulation.sensors.NOISE_PRESETS`.
        noise_overrides: field of `simulation.sensors.SensorNoise` -> value.
        truth: name from `simulation.truth.TRUTHS`.
        truth_spread: relative spread of the true parameters about those of the robot file.
        track_rate: track-speed samples per second [Hz].
        imu_rate: IMU samples per second [Hz].
        truth_rate: true poses, twists and track speeds per second [Hz].
        fix_rate: fixes per second [Hz]; 0 for none.
        fix_sigma: standard deviation of each coordinate of a fix [m].
        fix_heading_sigma: of its yaw [rad], or None for fixes without heading.
        outages: start and end [s] since the start of the run of times without fixes.
        include_truth: whether the log holds the truth.

    Raises:
        SimulationError: an unknown name, or a number that makes no sense.
    """

    trajectory: str = "random"
    duration: float = 300.0
    seed: int = 0
    noise: str = "nominal"
    noise_overrides: dict[str, float] = {}
    truth: str = "kinematic"
    truth_spread: float = DEFAULT_SPREAD
    track_rate: float = 50.0
    imu_rate: float = 100.0
    truth_rate: float = 50.0
    fix_rate: float = 1.0
    fix_sigma: float = 0.05
    fix_heading_sigma: float | None = None
    outages: tuple[tuple[float, float], ...] = ()
    include_truth: bool = True

    def __post_init__(self) -> None:
        check_trajectory(self.trajectory)
        check_truth(self.truth)
        noise_preset(self.noise, self.noise_overrides)
        for name in ("duration", "track_rate", "imu_rate", "truth_rate"):
            self._require(name, positive=True)
        for name in ("truth_spread", "fix_rate", "fix_sigma", "fix_heading_sigma", "seed"):
            if getattr(self, name) is not None:
                self._require(name, positive=False)
        for name in ("track_rate", "imu_rate", "truth_rate", "fix_rate"):
            samples = getattr(self, name) * self.duration
            if samples > MOST_SAMPLES:
                raise SimulationError(
                    f"{name} = {getattr(self, name)!r} Hz over {self.duration!r} s makes {samples:.0g} "
                    f"samples, more than {MOST_SAMPLES:.0g}; lower the rate or the duration"
                )
        for start, end in self.outages:
            if not start < end:
                raise SimulationError(
                    f"an outage must end after it starts, found {start!r} to {end!r} s"
                )
            if not (start >= 0.0 and end <= self.duration):
                raise SimulationError(
                    f"an outage must lie within the run of {self.duration!r} s, "
                    f"found {start!r} to {end!r} s"
                )

    def _require(self, name: str, *, positive: bool) -> None:
        value = getattr(self, name)
        if not (np.isfinite(value) and value >= 0 and not (positive and value == 0)):
            wanted = "a positive number" if positive else "zero or a positive number"
            raise SimulationError(f"{name} must be {wanted}, found {value!r}")


@dataclass(frozen=True)
class Simulation:
    """A simulated run, with what no sensor shows.

    Attributes:
        scenario: what was asked for.
        log: the run as its sensors saw it, with the truth where the scenario includes it.
        motion: the true motion at its full rate.
        gyro_bias: (n, 3) at the IMU's stamps, in the IMU's axes [rad/s].
        accelerometer_bias: (n, 3) at the IMU's stamps, in the IMU's axes [m/s²].
    """

    scenario: Scenario
    log: Log
    motion: TrueMotion
    gyro_bias: Floats
    accelerometer_bias: Floats

    @property
    def true_parameters(self) -> Indices | None:
        """The index parameters behind the motion, or None where the truth has none."""
        return self.motion.parameters


class Streams(NamedTuple):
    """Independent random streams of one run; new ones go to the end, so that old runs stay."""

    trajectory: Generator
    truth: Generator
    tracks: Generator
    gyro: Generator
    accelerometer: Generator
    fixes: Generator


def random_streams(seed: int, run_index: int = 0) -> Streams:
    """The random streams of a run, from the study's seed and the run's index and nothing else."""
    children = SeedSequence([seed, run_index]).spawn(len(Streams._fields))
    return Streams(*(np.random.default_rng(child) for child in children))


def simulate(scenario: Scenario, robot: Robot, *, run_index: int = 0) -> Log:
    """The log of a simulated run.

    Args:
        scenario: what to simulate.
        robot: the robot as its file describes it.
        run_index: which run of the study.

    Returns:
        The log; the first stamp is `simulation.sensors.EPOCH`.
    """
    return run_scenario(scenario, robot, run_index=run_index).log


def run_scenario(scenario: Scenario, robot: Robot, *, run_index: int = 0) -> Simulation:
    """A simulated run, with what no sensor shows; arguments as for `simulate`."""
    streams = random_streams(scenario.seed, run_index)
    duration = scenario.duration
    command = make_trajectory(scenario.trajectory, duration, robot, streams.trajectory)
    motion = make_truth(scenario.truth, scenario.truth_spread).run(
        command, duration, robot, streams.truth, rate=grid_rate(scenario.imu_rate)
    )
    noise = noise_preset(scenario.noise, scenario.noise_overrides)
    tracks = read_tracks(
        motion,
        sample_times(duration, scenario.track_rate),
        scenario.track_rate,
        track_noise(noise, robot),
        streams.tracks,
    )
    imu = read_imu(
        motion,
        sample_times(duration, scenario.imu_rate),
        scenario.imu_rate,
        robot,
        gyro_noise(noise, robot),
        accelerometer_noise(noise, robot),
        streams.gyro,
        streams.accelerometer,
    )
    fixes = None
    if scenario.fix_rate > 0.0:
        fixes = read_fixes(
            motion,
            sample_times(duration, scenario.fix_rate),
            scenario.fix_sigma,
            scenario.fix_heading_sigma,
            noise.fix_factor,
            scenario.outages,
            streams.fixes,
        )
    truth = None
    if scenario.include_truth:
        truth = _truth(motion, sample_times(duration, scenario.truth_rate))
    log = Log(
        name=f"{robot.name} {scenario.trajectory} seed {scenario.seed} run {run_index}",
        tracks=tracks,
        imu=imu.series,
        fixes=fixes,
        truth=truth,
    )
    return Simulation(scenario, log, motion, imu.gyro_bias, imu.accelerometer_bias)


def grid_rate(imu_rate: float) -> float:
    """Grid points per second of the true motion for an IMU rate [Hz]."""
    wanted = max(2.0 * imu_rate, LOWEST_GRID)
    points = np.ceil(wanted / imu_rate)
    return float(imu_rate * max(1.0, min(points, np.floor(HIGHEST_GRID / imu_rate))))


def _truth(motion: TrueMotion, times: Floats) -> Truth:
    stamps = to_stamps(times)
    return Truth(
        poses=PoseSeries(stamps, motion.poses_at(times)),
        twists=TwistSeries(stamps, motion.twists_at(times)),
        tracks=TrackSpeedSeries(stamps, motion.track_speeds_at(times)),
        source=motion.source,
    )
