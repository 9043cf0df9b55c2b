"""Blocks of a study on the streaming filter: one run after the other, as a robot would have it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
from msgspec import msgpack

from estimator.frames import Floats
from estimator.log import Log, PoseSeries, TrackSpeedSeries, Truth, TwistSeries
from estimator.robot import Robot
from estimator.run import run
from simulation.encoders import read_tracks
from simulation.fixes import read_fixes
from simulation.inertial import read_imu
from simulation.noise import (
    SensorSpecs,
    accelerometer_errors,
    encoder_errors,
    fix_errors,
    gyro_errors,
    noise_preset,
)
from simulation.recorded import read_recording
from simulation.sampling import sample_times, to_stamps
from simulation.scenario import Scenario, grid_rate, random_streams
from simulation.study_cells import Cell, Filter
from simulation.study_plan import DEFAULT_TRUTHS
from simulation.study_statistics import run_statistics, statistics
from simulation.trajectories import make_trajectory
from simulation.truth import TrueMotion

# Cells of a sweep mostly share their true motions; so many are kept.
KEPT_MOTIONS = 2 * DEFAULT_TRUTHS
# What of a scenario has no part in the true motion.
SENSED = (
    "noise",
    "track_rate",
    "truth_rate",
    "fix_rate",
    "outages",
    *SensorSpecs.__struct_fields__,
)


def block(cell: Cell, filters: Sequence[Filter], first_run: int, count: int) -> dict[str, Floats]:
    """The statistics of some runs of a cell; see `simulation.study_engines.Block`."""
    names = statistics(cell.horizons)
    found = {one.label: np.empty((count, len(names))) for one in filters}
    for row in range(count):
        log = study_log(cell, first_run + row)
        seen = replace(log, truth=None)
        for one in filters:
            result = run(seen, one.robot, one.variant, settings=one.settings)
            found[one.label][row] = run_statistics(result, log, cell.horizons)
    return found


def study_log(cell: Cell, run_index: int) -> Log:
    """The log of a run: the true motion of its number modulo `cell.truths`, and noise of its own.

    Of the first `cell.truths` runs it is what `simulation.scenario.simulate` gives.
    """
    scenario, robot = cell.scenario, cell.robot
    motion = true_motion(driven(scenario), msgpack.encode(robot), run_index % cell.truths)
    streams = random_streams(scenario.seed, run_index)
    duration, preset = scenario.duration, noise_preset(scenario.noise)
    tracks = read_tracks(
        motion,
        sample_times(duration, scenario.track_rate),
        scenario.track_rate,
        encoder_errors(robot, scenario.encoders, preset),
        streams.tracks,
    )
    imu = read_imu(
        motion,
        sample_times(duration, scenario.imu_rate),
        scenario.imu_rate,
        robot,
        gyro_errors(robot, scenario.gyro, preset),
        accelerometer_errors(robot, scenario.accelerometer, preset),
        streams.gyro,
        streams.accelerometer,
    )
    fixes = None
    if scenario.fix_rate > 0.0:
        fixes = read_fixes(
            motion,
            sample_times(duration, scenario.fix_rate),
            fix_errors(scenario.fixes, preset),
            scenario.outages,
            streams.fixes,
        )
    times = sample_times(duration, scenario.truth_rate)
    stamps = to_stamps(times)
    truth = Truth(
        poses=PoseSeries(stamps, motion.poses_at(times)),
        twists=TwistSeries(stamps, motion.twists_at(times)),
        tracks=TrackSpeedSeries(stamps, motion.track_speeds_at(times)),
        source=motion.source,
    )
    name = f"{robot.name} {scenario.trajectory} seed {scenario.seed} run {run_index}"
    return Log(name=name, tracks=tracks, imu=imu.series, fixes=fixes, truth=truth)


def driven(scenario: Scenario) -> bytes:
    """A scenario as far as it has a part in the true motion."""
    defaults = {field.name: field.default for field in msgspec.structs.fields(Scenario)}
    plain = {name: defaults[name] for name in SENSED}
    return msgpack.encode(msgspec.structs.replace(scenario, **plain))


@lru_cache(KEPT_MOTIONS)
def true_motion(scenario_data: bytes, robot_data: bytes, truth_index: int) -> TrueMotion:
    """A true motion, of the scenario and the robot that are packed there."""
    scenario = msgpack.decode(scenario_data, type=Scenario)
    robot = msgpack.decode(robot_data, type=Robot)
    streams = random_streams(scenario.seed, truth_index)
    file, duration = scenario.trajectory_file, scenario.duration
    recording = None if file is None else read_recording(Path(file))
    options = scenario.trajectory_options
    command = make_trajectory(
        scenario.trajectory, duration, robot, streams.trajectory, options, recording
    )
    rate = grid_rate(scenario.imu_rate)
    return scenario.make_truth().run(command, duration, robot, streams.truth, rate=rate)
