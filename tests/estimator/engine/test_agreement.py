"""Streaming, side by side, in lanes of many logs, and plain: one filter, the same estimates."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import msgspec
import numpy as np
import pytest

from agreement_scenes import (
    CONSIDERED,
    DEFAULT,
    SCENES,
    WANDERING,
    Scene,
    first,
    has_gaps,
    jump,
    repeat,
    robot_with,
    scatter,
    turn,
    with_poses,
    with_stuck_track,
)
from conftest import thorough
from fed_estimators import feed_all
from icreckon import VARIANTS, Log, Robot, Scenario, Terrain, feed_arrays, run, simulate
from icreckon.estimator.base.state import FAST_SLIP, GRAVITY
from icreckon.estimator.batch.inputs import has_heading, measured_of
from icreckon.estimator.batch.runs import work_through_runs
from icreckon.estimator.engine.filters import BatchFilter, Lanes
from icreckon.estimator.engine.layout import covariance_name
from icreckon.estimator.engine.schedule import steps_of
from icreckon.estimator.robot.settings import GateSettings, Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.sensors.specs import EncoderSpec, FixSpec
from same_runs import (
    ROBOT,
    assert_same_estimate,
    assert_same_run,
    drive,
    every,
    fed_one_by_one,
    without,
)


@pytest.mark.parametrize("name", SCENES)
def test_runs_by_arrays_are_those_one_by_one(name: str) -> None:
    scene = SCENES[name]
    log, options = scene.log(), {"settings": scene.settings, **scene.options()}
    for variant in scene.variants:
        expected = fed_one_by_one(log, scene.robot, variant, **options)
        assert_same_run(run(log, scene.robot, variant, **options), expected)
    assert scene.seen(expected), expected.health


ARRAYS = [
    "all everyday variants", "track speeds that are seldom told", "a track that is stuck",
    "a gyro that jumps", "an IMU without accelerometers", "states that are considered",
    "a track that spins", "a slide", "a gyro that is clipped", "no IMU for seconds",
    "no track speeds for seconds", "an IMU slower than the tracks", "forces that are missing",
]  # fmt: skip


def missing_forces() -> Log:
    log = drive()
    forces = log.imu.linear_acceleration.copy()
    forces[400:500] = np.nan
    return replace(log, imu=replace(log.imu, linear_acceleration=forces))


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_agree_with_streaming(name: str) -> None:
    scene = SCENES.get(name) or Scene(missing_forces)
    log, variant = replace(scene.log(), fixes=None), scene.variants[-1]
    options = {"settings": scene.settings, **scene.options()}
    by_arrays, one_by_one = (PoseEstimator(scene.robot, variant, **options) for _ in range(2))
    used = feed_arrays(by_arrays, log.tracks, log.imu)
    assert used == sum(map(one_by_one.feed, log.measurements()))
    assert_same_estimate(by_arrays, one_by_one)


def short(fix_rate: float = 5.0, seconds: float = 0.8) -> Log:
    return first(drive(fix_rate=fix_rate), seconds)


PLAIN = {
    "full-linear": Scene(short, ("full-linear",)),
    "states that are considered": Scene(
        short, ("inertia-online",), Settings(considered=CONSIDERED)
    ),
    "fixes that wander": Scene(short, settings=WANDERING),
    "slow IMU, no track speeds": Scene(
        lambda: without(every(short(seconds=5.0), "imu", 5), "tracks", 1.0, 2.5), seen=has_gaps
    ),
}


@pytest.mark.parametrize("name", [*PLAIN, *map(thorough, sorted(VARIANTS.keys() - PLAIN.keys()))])
def test_plain_agrees_with_compiled(name: str) -> None:
    scene = PLAIN.get(name) or Scene(short, (name,))
    settings = msgspec.structs.replace(scene.settings, engine="plain")
    for variant in scene.variants:
        expected = run(scene.log(), ROBOT, variant, settings=scene.settings, **scene.options())
        found = run(scene.log(), ROBOT, variant, settings=settings, **scene.options())
        assert_same_run(found, expected)
    assert scene.seen(expected)


COUNTED = ("gyro", "accelerometer_x", "accelerometer_y", "position", "heading")
BASE = Scenario(duration=10.0, seed=5, fix_rate=2.0)


@cache
def logs_of(count: int = 2, **changes: object) -> tuple[Log, ...]:
    scenario = msgspec.structs.replace(BASE, **changes)
    return tuple(simulate(scenario, ROBOT, run_index=run) for run in range(count))


Counts = dict[str, np.ndarray]


@dataclass(frozen=True)
class Block:
    """Logs of equal stamps, the filter that runs over all of them, and what must be seen."""

    logs: Callable[[], Sequence[Log]]
    variant: str = "inertia-online"
    settings: Settings = DEFAULT
    robot: Robot = ROBOT
    rounding: float = 1e-9
    seen: Callable[[Counts, list[PoseEstimator]], bool] = lambda *_: True


def knocked(log: Log) -> Log:
    """A log whose accelerometers have another bias from 6 s on."""
    forces = log.imu.linear_acceleration.copy()
    forces[600:, :2] += 8.0
    return replace(log, imu=replace(log.imu, linear_acceleration=forces))


SLOPE: dict[str, Any] = {
    "terrain": Terrain(slope_deg=8.0, uphill_deg=30.0),
    "trajectory": "aggressive",
    "duration": 20.0,
}
# Radii that differ, and an IMU away from the origin.
UNEVEN = msgspec.structs.replace(
    robot_with("imu", position=(0.2, -0.1, 0.3)),
    tracks=msgspec.structs.replace(ROBOT.tracks, difference=0.01, difference_sigma=0.02),
)
# The robot file says that there is neither bias nor slope.
SURE = msgspec.structs.replace(
    robot_with("imu", accelerometer_bias_sigma=0.0, accelerometer_bias_walk=0.0),
    slope=msgspec.structs.replace(ROBOT.slope, sigma=0.0, walk=0.0),
)


def on_slope(_: Counts, streams: list[PoseEstimator]) -> bool:
    return all(np.hypot(*one.state[GRAVITY]) > 0.3 for one in streams)


def dropouts(reads: str) -> Callable[[], Sequence[Log]]:
    encoders = EncoderSpec(dropouts_per_hour=2000.0, dropout_duration=1.0, dropout_reads=reads)
    return lambda: logs_of(4, encoders=encoders, trajectory="aggressive")


STRAY = FixSpec(heading_sigma=0.02, outlier_share=0.1, outlier_sigma=10.0)
BLOCKS = {
    "gyro": Block(lambda: logs_of(4), "gyro"),
    "inertia-online": Block(
        lambda: logs_of(4), seen=lambda counts, _: bool(counts["standstill"].min() > 0.0)
    ),
    "a slope": Block(lambda: logs_of(**SLOPE), robot=UNEVEN, seen=on_slope),
    "a slope, linear model": Block(
        lambda: logs_of(**SLOPE), "full-linear", robot=UNEVEN, seen=on_slope
    ),
    "tracks as fast as the IMU": Block(lambda: logs_of(track_rate=50.0, imu_rate=50.0)),
    "slow tracks": Block(lambda: logs_of(track_rate=20.0, imu_rate=100.0)),
    "rates that share no time": Block(lambda: logs_of(track_rate=25.0, imu_rate=60.0)),
    # Where a hole is found to be standstill, a variance of 5000 (rad/s)² becomes one of 1e-8 in an
    # update, which leaves few of the sixteen digits of a number to agree in.
    "encoders that drop out": Block(dropouts("nothing"), rounding=1e-7),
    "encoders that repeat": Block(dropouts("last")),
    "encoders that read zero": Block(dropouts("zero")),
    "a stuck encoder": Block(lambda: [with_stuck_track(log) for log in logs_of()]),
    "stray fixes with headings between samples": Block(
        lambda: logs_of(
            3, duration=25.0, fix_rate=1.5, imu_rate=37.0, trajectory="aggressive", fixes=STRAY
        ),
        seen=lambda counts, _: bool(
            counts["position_rejected"].max() > 0.0 and counts["heading_used"].min() > 10.0
        ),
    ),
    "a lost filter": Block(
        lambda: [
            with_poses(log, turn)
            for log in logs_of(duration=60.0, trajectory="aggressive", fix_rate=1.0)
        ],
        seen=lambda _, streams: any(one.health.sensors["position"].rejected for one in streams),
    ),
    "fixes that scatter, or repeat": Block(
        lambda: [
            with_poses(log, change)
            for log in logs_of(duration=20.0, fix_rate=5.0)
            for change in (scatter, repeat)
        ],
        seen=lambda _, streams: bool(
            streams[0].health.times.get("scattering", 0)
            and "repeats itself" in streams[1].health.sensors["position"].rejected
        ),
    ),
    "fixes that move away": Block(
        lambda: [
            with_poses(log, partial(jump, at=15, by=30.0))
            for log in logs_of(duration=40.0, fix_rate=1.0)
        ],
        "constant-online",
        seen=lambda counts, _: bool(counts["position_rejected"].min() >= 10.0),
    ),
    "parameters at their bounds": Block(
        logs_of,
        robot=robot_with("indices", eta0=1.02, eta1=0.0, eta2=0.0),
        seen=lambda _, streams: min(one.parameters["eta0"] for one in streams) >= 1.0,
    ),
    "gates that reject nothing": Block(logs_of, settings=Settings(gates=GateSettings(patience=0))),
    "a bias that nobody expects": Block(
        lambda: [knocked(log) for log in logs_of(trajectory="aggressive", duration=20.0)],
        "constant-online",
        robot=SURE,
        seen=lambda counts, streams: all(
            counts[f"accelerometer_{axis}_rejected"].min() > 0.0
            and all(abs(one.biases[f"accelerometer_bias_{axis}"]) > 1.0 for one in streams)
            for axis in "xy"
        ),
    ),
}


def state_of(filters: BatchFilter, lanes: Lanes, lane: int) -> tuple[np.ndarray, np.ndarray]:
    """State and covariance of one filter, of the states that it estimates."""
    states, rows, found = filters.shape.states, filters.rows, lanes.workspace[:, lane]
    P = [[found[rows[covariance_name(min(i, j), max(i, j))]] for j in states] for i in states]
    return found[[rows[f"x{i}"] for i in states]], np.array(P)


@pytest.mark.parametrize("name", BLOCKS)
def test_lanes_agree_with_streaming(name: str) -> None:
    block = BLOCKS[name]
    # Studies leave out the height.
    side_by_side = BatchFilter(block.robot, VARIANTS[block.variant], block.settings)
    streams = [
        feed_all(PoseEstimator(block.robot, block.variant, settings=block.settings), log)
        for log in block.logs()
    ]
    logs = [block.logs()[k % len(streams)] for k in range(side_by_side.width)]
    measured = measured_of(logs, block.robot)
    steps = steps_of(
        measured.track_stamps,
        measured.imu_stamps,
        measured.fix_stamps,
        measured.imu_stamps[::10],
        heading=has_heading(measured.fixes),
    )
    (worked,) = work_through_runs(
        [side_by_side], [measured], steps, start=np.zeros(3), start_sigma=np.zeros(3)
    )
    counts = side_by_side.counts(worked.lanes)
    for lane in range(side_by_side.width):
        stream = streams[lane % len(streams)]
        x, P = state_of(side_by_side, worked.lanes, lane)
        states = side_by_side.shape.states
        of_states = np.array(states)[
            kept := [k for k, i in enumerate(states) if i < FAST_SLIP.start]
        ]
        expected = stream.covariance[np.ix_(of_states, of_states)]
        sigma = np.sqrt(np.diagonal(expected))
        scale = np.where(sigma > 0.0, sigma, 1.0)
        assert np.abs((x[kept] - stream.state[of_states]) / scale).max() < block.rounding
        wrong = (P[np.ix_(kept, kept)] - expected) / np.outer(scale, scale)
        assert np.abs(wrong).max() < block.rounding
        for sensor, health in stream.health.sensors.items():
            if sensor in COUNTED:
                assert counts[f"{sensor}_used"][lane] == health.used
                assert counts[f"{sensor}_rejected"][lane] == health.rejected.get("gate", 0)
                nis = counts[f"{sensor}_nis"][lane]
                assert nis == pytest.approx(health.nis_sum, rel=block.rounding)
        assert counts["standstill"][lane] == stream.health.standstill_updates
    assert block.seen(counts, streams)
