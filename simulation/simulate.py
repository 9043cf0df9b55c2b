"""Simulated run: true motion, error-free readings, their errors, and the log."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import PoseSeries, TrackSpeedSeries, Truth, TwistSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.base.random_streams import Streams, random_streams
from icreckon.simulation.base.sampling import sample_times, to_stamps
from icreckon.simulation.drives.recorded import read_recording
from icreckon.simulation.drives.smooth_speeds import STANDSTILL
from icreckon.simulation.drives.trajectories import make_trajectory
from icreckon.simulation.scenario import Scenario, errors_of, grid_rate
from icreckon.simulation.sensors.encoders import with_encoder_errors
from icreckon.simulation.sensors.fixes import measured_pose_times, with_fix_errors
from icreckon.simulation.sensors.imu import Imu, perfect_imu, with_inertial_errors
from icreckon.simulation.truth.true_motion import TrueMotion

LONGEST_STAND = 60.0  # standing after a recording that needs no warning [s]


@dataclass(frozen=True)
class Simulation:
    """Simulated run with its true motion and sensor biases."""

    log: Log  # the measurements, with the truth if the scenario includes it
    motion: TrueMotion  # the true motion at its full rate
    gyro_bias: Floats  # (n, 3) at the IMU's stamps, in the IMU's axes [rad/s]
    accelerometer_bias: Floats  # (n, 3) at the IMU's stamps, in the IMU's axes [m/s²]


class PerfectReadings(NamedTuple):
    """Error-free sensor readings of a true motion."""

    tracks: Floats  # (n, 2) mean speeds of the tracks since the sample before [m/s]
    # angular velocities (m, 3) [rad/s] and specific forces (m, 3) [m/s²] in the IMU's axes
    imu: tuple[Floats, Floats]
    fixes: Floats  # (k, 3) poses [m, m, rad], those of outages included


def simulate(
    scenario: Scenario,
    robot: Robot,
    *,
    run_index: int = 0,
    motion_index: int | None = None,
    recording: TrackSpeedSeries | None = None,
) -> Log:
    """Simulate a run and return its log.

    Args:
        scenario: configuration of the run.
        robot: the robot as described by its file.
        run_index: index of the run within the study.
        motion_index: index of its true motion, if another: a study of few `truths` repeats them.
        recording: track speeds to drive, for the trajectory "recorded" without a trajectory_file.

    Returns:
        The log; the first stamp is `icreckon.simulation.base.sampling.EPOCH`.

    Raises:
        SimulationError: speeds beyond the robot's max_track_speed, a trajectory_file that cannot be
            read, an argument that is not a `Robot`, a bad run_index, or a motion that the truth
            cannot follow.
    """
    return run_scenario(
        scenario, robot, run_index=run_index, motion_index=motion_index, recording=recording
    ).log


def run_scenario(
    scenario: Scenario,
    robot: Robot,
    *,
    run_index: int = 0,
    motion_index: int | None = None,
    recording: TrackSpeedSeries | None = None,
) -> Simulation:
    """Simulate a run, true motion and biases included; arguments as in `simulate`."""
    if not isinstance(scenario, Scenario):
        raise SimulationError(
            f"scenario must be Scenario(...), found {type(scenario).__name__}: simulate(scenario, robot)"
        )
    if not isinstance(robot, Robot):
        raise SimulationError(f"{robot!r} is no Robot; load it with load_robot({robot!r})")
    streams = random_streams(scenario.seed, run_index if motion_index is None else motion_index)
    motion = simulate_motion(scenario, robot, streams, recording=recording)
    truth = None
    if scenario.include_truth:
        truth = truth_of(motion, sample_times(scenario.duration, scenario.truth_rate))
    readings = perfect_readings(motion, scenario, robot)
    log, imu = log_with_errors(readings, truth, scenario, robot, run_index)
    return Simulation(log, motion, imu.gyro_bias, imu.accelerometer_bias)


def simulate_motion(
    scenario: Scenario, robot: Robot, streams: Streams, *, recording: TrackSpeedSeries | None = None
) -> TrueMotion:
    """Simulate the true motion of a run; of the sensors, only the IMU's rate counts.

    Of the random streams, those of trajectory and truth are used. Recording and errors: see `simulate`.
    """
    duration = scenario.duration
    if scenario.trajectory_file is not None:
        if recording is not None:
            raise SimulationError(
                f"two recordings to drive: trajectory_file = {scenario.trajectory_file!r} and the "
                "one given to this run; leave one out"
            )
        recording = read_recording(Path(scenario.trajectory_file))
    if recording is not None and len(recording.stamps):
        recording_end = float(recording.stamps[-1] - recording.stamps[0]) * NANOSECOND + STANDSTILL
        if recording_end > 1.1 * duration or recording_end < duration - LONGEST_STAND:
            is_cut = recording_end > duration
            effect = "its rest is not driven" if is_cut else "then the robot stands"
            warnings.warn(
                f"the recording ends after {recording_end:.1f} s, the run after {duration:g} s: "
                f"{effect}; set duration",
                stacklevel=3,
            )
    command = make_trajectory(
        scenario.trajectory,
        duration,
        robot,
        streams.trajectory,
        scenario.trajectory_options,
        recording,
    )
    rate = grid_rate(scenario.imu_rate)
    return scenario.make_truth().run(command, duration, robot, streams.truth, rate=rate)


def perfect_readings(motion: TrueMotion, scenario: Scenario, robot: Robot) -> PerfectReadings:
    """Error-free readings of a true motion at the sample times of a scenario."""
    duration, imu_rate = scenario.duration, scenario.imu_rate
    fix_errors = errors_of(scenario, robot).fixes
    return PerfectReadings(
        motion.mean_track_speeds(sample_times(duration, scenario.track_rate)),
        perfect_imu(motion, sample_times(duration, imu_rate), imu_rate, robot),
        motion.poses_at(measured_pose_times(fix_times(scenario), fix_errors)),
    )


def log_with_errors(
    perfect: PerfectReadings, truth: Truth | None, scenario: Scenario, robot: Robot, run_index: int
) -> tuple[Log, Imu]:
    """Log of a run, and its IMU: error-free readings with the errors of a scenario.

    Seed of the scenario and index of the run draw the errors; the truth is stored as it is.
    """
    streams, errors = random_streams(scenario.seed, run_index), errors_of(scenario, robot)
    tracks = with_encoder_errors(
        perfect.tracks,
        sample_times(scenario.duration, scenario.track_rate),
        scenario.track_rate,
        errors.encoders,
        streams.tracks,
    )
    imu = with_inertial_errors(
        perfect.imu,
        sample_times(scenario.duration, scenario.imu_rate),
        scenario.imu_rate,
        robot,
        errors.gyro,
        errors.accelerometer,
        streams.gyro,
        streams.accelerometer,
    )
    fixes = None
    if scenario.fix_rate > 0.0:
        fixes = with_fix_errors(
            perfect.fixes, fix_times(scenario), errors.fixes, scenario.outages, streams.fixes
        )
    name = f"{robot.name} {scenario.trajectory} seed {scenario.seed} run {run_index}"
    return Log(name, tracks, imu.series, fixes, truth), imu


def truth_of(motion: TrueMotion, times: Floats) -> Truth:
    """Truth at given times (n,) [s], as stored in a log."""
    stamps, spatial = to_stamps(times), motion.spatial_at(times)
    return Truth(
        poses=PoseSeries(stamps, motion.poses_at(times), spatial),
        twists=TwistSeries(stamps, motion.twists_at(times)),
        tracks=TrackSpeedSeries(stamps, motion.track_speeds_at(times)),
        source=motion.source,
    )


def fix_times(scenario: Scenario) -> Floats:
    """Arrival times (n,) of fixes, those in outages included [s]."""
    if scenario.fix_rate == 0.0:
        return np.zeros(0)
    return sample_times(scenario.duration, scenario.fix_rate)
