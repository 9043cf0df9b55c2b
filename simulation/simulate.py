"""Simulated run: true motion, sensor readings, and the log of both."""

from dataclasses import dataclass
from pathlib import Path

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.base.random_streams import Streams, random_streams
from icreckon.simulation.base.sampling import sample_times
from icreckon.simulation.drives.recorded import read_recording
from icreckon.simulation.drives.trajectories import make_trajectory
from icreckon.simulation.scenario import Scenario, grid_rate
from icreckon.simulation.sensing import perfect, sensed, truth_of
from icreckon.simulation.truth.true_motion import TrueMotion


@dataclass(frozen=True)
class Simulation:
    """Simulated run with its true motion and sensor biases.

    Attributes:
        scenario: configuration of the run.
        log: the measurements, with the truth if the scenario includes it.
        motion: the true motion at its full rate.
        gyro_bias: (n, 3) at the IMU's stamps, in the IMU's axes [rad/s].
        accelerometer_bias: (n, 3) at the IMU's stamps, in the IMU's axes [m/s²].
    """

    scenario: Scenario
    log: Log
    motion: TrueMotion
    gyro_bias: Floats
    accelerometer_bias: Floats


def simulate(
    scenario: Scenario,
    robot: Robot,
    *,
    run_index: int = 0,
    recording: TrackSpeedSeries | None = None,
) -> Log:
    """Simulate a run and return its log.

    Args:
        scenario: configuration of the run.
        robot: the robot as described by its file.
        run_index: index of the run within the study.
        recording: track speeds to drive, for the trajectory "recorded" without a trajectory_file.

    Returns:
        The log; the first stamp is `icreckon.simulation.base.sampling.EPOCH`.

    Raises:
        SimulationError: speeds beyond the robot's max_track_speed, a trajectory_file that cannot be
            read, an argument that is not a `Robot`, a bad run_index, or a motion that the truth
            cannot follow.
    """
    return run_scenario(scenario, robot, run_index=run_index, recording=recording).log


def run_scenario(
    scenario: Scenario,
    robot: Robot,
    *,
    run_index: int = 0,
    recording: TrackSpeedSeries | None = None,
) -> Simulation:
    """Simulate a run, true motion and biases included; arguments as in `simulate`."""
    if not isinstance(scenario, Scenario):
        raise SimulationError(
            f"scenario must be Scenario(...), found {type(scenario).__name__}: simulate(scenario, robot)"
        )
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
    """Simulate the true motion of a run.

    Args:
        scenario: configuration of the run; of its sensors, only the IMU's rate is used.
        robot: the robot as described by its file.
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
