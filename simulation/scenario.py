"""Scenario of one simulated run as plain data, from Python or a TOML file."""

from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from icreckon.estimator.base.checks import Bound, NotNegative, Positive
from icreckon.estimator.base.config import convert, read_toml
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.base.field_types import settle_types
from icreckon.simulation.base.random_streams import check_whole
from icreckon.simulation.drives.trajectories import (
    check_trajectory,
    trajectory_names,
    trajectory_options,
)
from icreckon.simulation.sensors.specs import (
    EncoderSpec,
    FixSpec,
    InertialSpec,
    SensorErrors,
    SensorSpecs,
    noise_preset,
    sensor_errors,
)
from icreckon.simulation.truth.friction import FrictionTruth
from icreckon.simulation.truth.kinematic import KinematicTruth
from icreckon.simulation.truth.terrain import Patch, Payload, Terrain, refuse_idle_keys
from icreckon.simulation.truth.true_motion import DEFAULT_SPREAD

# Grid points per second of the true motion: a multiple of the IMU's rate, at least LOWEST_GRID, and
# two for each IMU sample where HIGHEST_GRID allows.
LOWEST_GRID = 200.0
HIGHEST_GRID = 1000.0
# This many samples of one sensor, or points of the true motion, take minutes and gigabytes.
MOST_SAMPLES = 5e6
HIGHEST_RATE = 1e4  # no such sensor samples more often [Hz]
Rate = Annotated[
    float, Bound("a positive number of Hz, 10000 at most", 0.0, HIGHEST_RATE, above=True)
]
# A track or index that is off by more than its own size is another robot.
Spread = Annotated[float, Bound("from 0 to 1 (relative: 0.15 is 15 %)", 0.0, 1.0)]
# Truth models by name.
TRUTHS: dict[str, type[FrictionTruth | KinematicTruth]] = {
    "friction": FrictionTruth,
    "kinematic": KinematicTruth,
}
TRAJECTORY_FILE = "trajectory_file"
RATES = ("track_rate", "imu_rate", "truth_rate", "fix_rate")


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Configuration of a simulated run.

    Attributes:
        trajectory: name from `icreckon.simulation.drives.drives.TRAJECTORIES`, or "recorded".
        trajectory_options: option of that trajectory -> value; see its docstring.
        trajectory_file: CSV file of the "recorded" trajectory; see `icreckon.simulation.drives.recorded`.
        duration: length of the run [s]; its first 3 s are standstill.
        seed: seed of the study; a run's streams derive from it and the run's index.
        noise: name from `icreckon.simulation.sensors.specs.NOISE_PRESETS`.
        truth: name from `icreckon.simulation.scenario.TRUTHS`.
        truth_spread: relative spread of the true robot about the robot file.
        slip_noise: factor on the slip residual of the true motion, which no model explains; None for
            the truth's default [-].
        track_lag: time constant of the tracks behind their commands; None for the truth's default [s].
        terrain: shape of the ground of the whole run.
        patches: ground that differs along the path.
        payloads: loads along the path.
        track_rate: track-speed samples per second [Hz].
        imu_rate: IMU samples per second [Hz].
        truth_rate: true poses, twists and track speeds per second [Hz].
        fix_rate: fixes per second [Hz]; 0 for none.
        outages: start and end of each span without fixes, since the start of the run [s].
        include_truth: whether the log contains the truth.
        encoders: parameters that override those of the preset.
        gyro: parameters that override those of the preset.
        accelerometer: parameters that override those of the preset.
        fixes: parameters that override those of the preset.

    Raises:
        SimulationError: a wrong type, an unknown name, or a number out of range.
    """

    trajectory: str = "random"
    trajectory_options: dict[str, float] = {}
    trajectory_file: str | None = None
    duration: Positive = 300.0
    seed: int = 0
    noise: str = "nominal"
    truth: str = "friction"
    truth_spread: Spread = DEFAULT_SPREAD
    slip_noise: NotNegative | None = None
    track_lag: NotNegative | None = None
    terrain: Terrain = Terrain()
    patches: tuple[Patch, ...] = ()
    payloads: tuple[Payload, ...] = ()
    track_rate: Rate = 50.0
    imu_rate: Rate = 100.0
    truth_rate: Rate = 50.0
    fix_rate: Annotated[float, Bound("from 0 to 10000 Hz", 0.0, HIGHEST_RATE)] = 1.0
    outages: tuple[tuple[float, float], ...] = ()
    include_truth: bool = True
    encoders: EncoderSpec = EncoderSpec()
    gyro: InertialSpec = InertialSpec()
    accelerometer: InertialSpec = InertialSpec()
    fixes: FixSpec = FixSpec()

    def __post_init__(self) -> None:
        settle_types(self)
        check_trajectory(self.trajectory, self.trajectory_options, self.trajectory_file)
        self.make_truth()  # raises if it does not exist or a number is out of range
        noise_preset(self.noise)  # raises if it does not exist
        check_whole("seed", self.seed)
        self._check_samples()
        self._check_spans()

    def make_truth(self) -> FrictionTruth | KinematicTruth:
        """Make the truth model that moves the simulated robot.

        Raises:
            SimulationError: an unknown truth (the message names the nearest), or one that does not
                support the lag, terrain or payload.
        """
        if self.truth not in TRUTHS:
            hint = nearest_hint(self.truth, list(TRUTHS))
            raise SimulationError(f"no truth named {self.truth!r}{hint}")
        options: dict[str, Any] = {
            "spread": self.truth_spread,
            "slip_noise": self.slip_noise,
            "track_lag": self.track_lag,
            "terrain": None if self.terrain.is_level else self.terrain,
            "patches": self.patches or None,
            "payloads": self.payloads or None,
        }
        given = {key: value for key, value in options.items() if value is not None}
        truth = TRUTHS[self.truth]
        unknown = [key for key in given if key not in truth.__dataclass_fields__]
        if unknown:
            raise SimulationError(
                f"the {self.truth} truth does not support {' or '.join(unknown)}; use truth = 'friction'"
            )
        return truth(**given)

    def _check_samples(self) -> None:
        """Reject a rate that makes more than `MOST_SAMPLES`."""
        rates = {f"{name} = {getattr(self, name)!r} Hz": getattr(self, name) for name in RATES}
        grid = grid_rate(self.imu_rate)
        rates[f"the true motion at {grid:.0f} Hz (of imu_rate = {self.imu_rate!r})"] = grid
        for setting, rate in rates.items():
            samples = rate * self.duration
            if samples > MOST_SAMPLES:
                raise SimulationError(
                    f"{setting} over {self.duration!r} s makes {samples:.2g} samples, more than "
                    f"{MOST_SAMPLES:.2g}; lower the rate or the duration"
                )

    def _check_spans(self) -> None:
        """Reject patches or payloads outside of the run, and outages not within it."""
        for what, spans in (("patches", self.patches), ("payloads", self.payloads)):
            times = [span.time for span in spans]
            if times and not any(start < self.duration and end > 0.0 for start, end in times):
                raise SimulationError(
                    f"time of all {what} is outside of the run of {self.duration!r} s, found {times!r}"
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


def load_scenario(path: str | Path) -> Scenario:
    """Load a scenario from a TOML file; keys: docs/reference/scenario-file.md.

    Args:
        path: the file. The path of a `trajectory_file` in it is relative to its folder.

    Raises:
        SimulationError: no such file, invalid TOML, a misspelt key, a wrong type or a bad value, or a key
            of `[terrain]` that has no effect.
    """
    path = Path(path)
    written = read_toml(path, SimulationError)
    scenario = convert(written, Scenario, str(path), SimulationError)
    refuse_idle_keys([scenario.terrain], written.get("terrain", {}), str(path))
    if scenario.trajectory_file is None:
        return scenario
    file = str(path.parent / scenario.trajectory_file)
    return msgspec.structs.replace(scenario, trajectory_file=file)


def errors_of(scenario: Scenario, robot: Robot) -> SensorErrors:
    """Errors of the sensors: by the scenario, its noise preset, or the robot file."""
    specs = {name: getattr(scenario, name) for name in SensorSpecs.__struct_fields__}
    return sensor_errors(SensorSpecs(**specs), scenario.noise, robot)


def change_scenario(scenario: Scenario, changes: dict[str, Any], source: str) -> Scenario:
    """Copy of a scenario with changed keys; a new trajectory drops `lost_options`.

    Args:
        scenario: the base scenario.
        changes: nested dictionaries, structured like a scenario file.
        source: origin of the changes, for messages.

    Raises:
        SimulationError: a misspelt key, a wrong type or a bad value.
    """
    data: dict[str, Any] = msgspec.to_builtins(scenario)
    for name in lost_options(scenario, changes):
        if name == TRAJECTORY_FILE:
            data[TRAJECTORY_FILE] = None
        else:
            del data["trajectory_options"][name]
    return convert(_merged(data, changes), Scenario, source, SimulationError)


def lost_options(scenario: Scenario, changes: dict[str, Any]) -> list[str]:
    """Keys that `change_scenario` drops with a change of trajectory.

    Dropped are the options that the new trajectory lacks, and trajectory_file.
    """
    old, new = scenario.trajectory, changes.get("trajectory", scenario.trajectory)
    if new == old or new not in trajectory_names():
        return []
    lost = [name for name in scenario.trajectory_options if name not in trajectory_options(new)]
    return lost if scenario.trajectory_file is None else [*lost, TRAJECTORY_FILE]


def grid_rate(imu_rate: float) -> float:
    """Grid points per second of the true motion [Hz] for an IMU rate [Hz]."""
    wanted = max(2.0 * imu_rate, LOWEST_GRID)
    points = np.ceil(wanted / imu_rate)
    return float(imu_rate * max(1.0, min(points, np.floor(HIGHEST_GRID / imu_rate))))


def _merged(data: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Merge changes into a copy of nested tables; lists and numbers are replaced."""
    result = dict(data)
    for key, value in changes.items():
        old = result.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            value = _merged(old, value)
        result[key] = value
    return result
