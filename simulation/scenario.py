"""A scenario: one simulated run as plain data, from Python or a TOML file, and the run itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.random import Generator, SeedSequence

from estimator.config import convert, read_toml
from estimator.log import Log, TrackSpeedSeries
from estimator.robot import Indices, Robot
from simulation.errors import SimulationError
from simulation.field_types import settle_types
from simulation.noise import EncoderSpec, FixSpec, InertialSpec, noise_preset
from simulation.recorded import read_recording
from simulation.sampling import Floats, sample_times
from simulation.sensing import perfect, sensed, truth_of
from simulation.terrain import Patch, Payload
from simulation.trajectories import (
    check_trajectory,
    make_trajectory,
    trajectory_names,
    trajectory_options,
)
from simulation.truth import DEFAULT_SPREAD, TrueMotion, TruthModel
from simulation.truths import make_truth

# Grid points per second of the true motion: a multiple of the IMU's rate, at least LOWEST_GRID, and
# two for each IMU sample where HIGHEST_GRID allows.
LOWEST_GRID = 200.0
HIGHEST_GRID = 1000.0
# What is beyond these is taken for a slip of the pen: no such sensor samples as often [Hz]; and so
# many samples of one sensor, or points of the true motion, take minutes and gigabytes.
HIGHEST_RATE = 1e4
MOST_SAMPLES = 5e6
# A track or index that is off by more than its own size is another robot.
LARGEST_SPREAD = 1.0
# NumPy takes larger ones, TOML and most other programs do not.
LARGEST_SEED = 2**63 - 1
TRAJECTORY_FILE = "trajectory_file"
RATES = ("track_rate", "imu_rate", "truth_rate", "fix_rate")


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What to simulate.

    Attributes:
        trajectory: name from `simulation.trajectories.TRAJECTORIES`, or "recorded".
        trajectory_options: option of that trajectory -> value; see its docstring.
        trajectory_file: CSV file of the "recorded" trajectory; see `simulation.recorded`.
        duration: length of the run [s]; its first 3 s are standstill.
        seed: seed of the study; a run's streams derive from it and the run's index.
        noise: name from `simulation.noise.NOISE_PRESETS`.
        truth: name from `simulation.truths.TRUTHS`.
        truth_spread: relative spread of the true robot about the robot file.
        slip_noise: factor on the part of the true motion that no model explains; the truth's own
            where left out [-].
        track_lag: time constant of the tracks behind their commands; the truth's own where left out
            [s].
        patches: terrain along the way.
        payloads: loads along the way.
        track_rate: track-speed samples per second [Hz].
        imu_rate: IMU samples per second [Hz].
        truth_rate: true poses, twists and track speeds per second [Hz].
        fix_rate: fixes per second [Hz]; 0 for none.
        outages: start and end [s] since the start of the run of times without fixes.
        include_truth: whether the log holds the truth.
        encoders: figures that replace those of the preset.
        gyro: figures that replace those of the preset.
        accelerometer: figures that replace those of the preset.
        fixes: figures that replace those of the preset.

    Raises:
        SimulationError: a wrong type, an unknown name, or a number that makes no sense.
    """

    trajectory: str = "random"
    trajectory_options: dict[str, float] = {}
    trajectory_file: str | None = None
    duration: float = 300.0
    seed: int = 0
    noise: str = "nominal"
    truth: str = "friction"
    truth_spread: float = DEFAULT_SPREAD
    slip_noise: float | None = None
    track_lag: float | None = None
    patches: tuple[Patch, ...] = ()
    payloads: tuple[Payload, ...] = ()
    track_rate: float = 50.0
    imu_rate: float = 100.0
    truth_rate: float = 50.0
    fix_rate: float = 1.0
    outages: tuple[tuple[float, float], ...] = ()
    include_truth: bool = True
    encoders: EncoderSpec = EncoderSpec()
    gyro: InertialSpec = InertialSpec()
    accelerometer: InertialSpec = InertialSpec()
    fixes: FixSpec = FixSpec()

    def __post_init__(self) -> None:
        settle_types(self)
        check_trajectory(self.trajectory, self.trajectory_options, self.trajectory_file)
        self.make_truth()
        noise_preset(self.noise)
        for name in ("duration", "track_rate", "imu_rate", "truth_rate"):
            self._require(name, positive=True)
        for name in ("truth_spread", "slip_noise", "track_lag", "fix_rate"):
            if getattr(self, name) is not None:
                self._require(name, positive=False)
        if self.truth_spread > LARGEST_SPREAD:
            raise SimulationError(
                f"truth_spread is relative (0.15 is 15 %) and must be at most {LARGEST_SPREAD:g}, "
                f"found {self.truth_spread!r}"
            )
        _check_whole("seed", self.seed)
        self._check_samples()
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

    def make_truth(self) -> TruthModel:
        """What really moves the robot."""
        return make_truth(
            self.truth,
            self.truth_spread,
            slip_noise=self.slip_noise,
            track_lag=self.track_lag,
            patches=self.patches,
            payloads=self.payloads,
        )

    def _check_samples(self) -> None:
        rates = [(f"{name} = {getattr(self, name)!r} Hz", getattr(self, name)) for name in RATES]
        for told, rate in rates:
            if rate > HIGHEST_RATE:
                raise SimulationError(
                    f"{told} is more than any such sensor has; give at most {HIGHEST_RATE:.0f} Hz"
                )
        grid = grid_rate(self.imu_rate)
        rates.append((f"the true motion at {grid:.0f} Hz (of imu_rate = {self.imu_rate!r})", grid))
        for told, rate in rates:
            samples = rate * self.duration
            if samples > MOST_SAMPLES:
                raise SimulationError(
                    f"{told} over {self.duration!r} s makes {samples:.2g} samples, more than "
                    f"{MOST_SAMPLES:.2g}; lower the rate or the duration"
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
    """The random streams of a run, from the study's seed and the run's index and nothing else.

    Raises:
        SimulationError: one of the two is no whole number from 0 to `LARGEST_SEED`.
    """
    _check_whole("seed", seed)
    _check_whole("run_index", run_index)
    children = SeedSequence([seed, run_index]).spawn(len(Streams._fields))
    return Streams(*(np.random.default_rng(child) for child in children))


def load_scenario(path: str | Path) -> Scenario:
    """A scenario from a TOML file; docs/scenario.md shows every key.

    Args:
        path: the file. The path of a `trajectory_file` in it is relative to its folder.

    Raises:
        SimulationError: no such file, no TOML, a misspelt key, a wrong type or a bad value.
    """
    path = Path(path)
    scenario = convert(read_toml(path, SimulationError), Scenario, str(path), SimulationError)
    if scenario.trajectory_file is None:
        return scenario
    return msgspec.structs.replace(
        scenario, trajectory_file=str(path.parent / scenario.trajectory_file)
    )


def change_scenario(scenario: Scenario, changes: dict[str, Any], source: str) -> Scenario:
    """A scenario with some of its keys changed; another trajectory drops its `lost_options`.

    Args:
        scenario: what to start from.
        changes: nested dictionaries as a scenario file has them.
        source: where the changes come from, for messages.

    Raises:
        SimulationError: a misspelt key, a wrong type or a bad value.
    """
    data: dict[str, Any] = msgspec.to_builtins(scenario)
    lost = lost_options(scenario, changes)
    options = scenario.trajectory_options
    data["trajectory_options"] = {name: options[name] for name in options if name not in lost}
    if TRAJECTORY_FILE in lost:
        data[TRAJECTORY_FILE] = None
    return convert(merged(data, changes), Scenario, source, SimulationError)


def lost_options(scenario: Scenario, changes: dict[str, Any]) -> list[str]:
    """What `change_scenario` drops: options that another trajectory has not, and trajectory_file."""
    old, new = scenario.trajectory, changes.get("trajectory", scenario.trajectory)
    if new == old or new not in trajectory_names():
        return []
    lost = [name for name in scenario.trajectory_options if name not in trajectory_options(new)]
    return lost if scenario.trajectory_file is None else [*lost, TRAJECTORY_FILE]


def simulate(
    scenario: Scenario,
    robot: Robot,
    *,
    run_index: int = 0,
    recording: TrackSpeedSeries | None = None,
) -> Log:
    """The log of a simulated run.

    Args:
        scenario: what to simulate.
        robot: the robot as its file describes it.
        run_index: which run of the study.
        recording: track speeds to drive, for the trajectory "recorded" without a trajectory_file.

    Returns:
        The log; the first stamp is `simulation.sampling.EPOCH`.

    Raises:
        SimulationError: speeds beyond the robot's max_track_speed, a trajectory_file that cannot be
            read, no `Robot`, a bad run_index, or what the truth refuses.
    """
    return run_scenario(scenario, robot, run_index=run_index, recording=recording).log


def run_scenario(
    scenario: Scenario,
    robot: Robot,
    *,
    run_index: int = 0,
    recording: TrackSpeedSeries | None = None,
) -> Simulation:
    """A simulated run, with what no sensor shows; arguments and errors as for `simulate`."""
    if not isinstance(robot, Robot):
        raise SimulationError(f"{robot!r} is no Robot; load it with load_robot({robot!r})")
    streams = random_streams(scenario.seed, run_index)
    motion = drive(scenario, robot, streams, recording=recording)
    read = sensed(perfect(motion, scenario, robot), scenario, robot, streams)
    truth = None
    if scenario.include_truth:
        truth = truth_of(motion, sample_times(scenario.duration, scenario.truth_rate))
    log = Log(
        name=f"{robot.name} {scenario.trajectory} seed {scenario.seed} run {run_index}",
        tracks=read.tracks,
        imu=read.imu.series,
        fixes=read.fixes,
        truth=truth,
    )
    return Simulation(scenario, log, motion, read.imu.gyro_bias, read.imu.accelerometer_bias)


def drive(
    scenario: Scenario,
    robot: Robot,
    streams: Streams,
    *,
    recording: TrackSpeedSeries | None = None,
) -> TrueMotion:
    """The true motion of a run.

    Args:
        scenario: what to drive; its sensors do not count, but for the IMU's rate.
        robot: the robot as its file describes it.
        streams: draw trajectory and truth.
        recording: track speeds to drive, see `simulate`.

    Raises:
        SimulationError: see `simulate`.
    """
    duration = scenario.duration
    if scenario.trajectory_file is not None:
        if recording is not None:
            raise SimulationError(
                f"two recordings to drive: trajectory_file = {scenario.trajectory_file!r} and the "
                "one given to this run; leave one out"
            )
        recording = read_recording(Path(scenario.trajectory_file))
    command = make_trajectory(
        scenario.trajectory,
        duration,
        robot,
        streams.trajectory,
        scenario.trajectory_options,
        recording,
    )
    return scenario.make_truth().run(
        command, duration, robot, streams.truth, rate=grid_rate(scenario.imu_rate)
    )


def grid_rate(imu_rate: float) -> float:
    """Grid points per second of the true motion for an IMU rate [Hz]."""
    wanted = max(2.0 * imu_rate, LOWEST_GRID)
    points = np.ceil(wanted / imu_rate)
    return float(imu_rate * max(1.0, min(points, np.floor(HIGHEST_GRID / imu_rate))))


def _check_whole(name: str, value: int) -> None:
    if not (isinstance(value, int | np.integer) and 0 <= value <= LARGEST_SEED):
        raise SimulationError(
            f"{name} must be a whole number from 0 to {LARGEST_SEED}, found {value!r}"
        )


def merged(data: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Nested tables with some of their keys changed."""
    result = dict(data)
    for key, value in changes.items():
        old = result.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            value = merged(old, value)
        result[key] = value
    return result
