"""Filters side by side against the streaming filter on the same measurements."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from conftest import thorough
from icreckon.estimator.base.errors import BatchError, EstimatorError
from icreckon.estimator.base.state import FAST_SLIP, GRAVITY
from icreckon.estimator.batch.inputs import has_heading, measured_of
from icreckon.estimator.batch.many import run_many
from icreckon.estimator.batch.runs import scatters, work_through_runs
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.schedule import steps_of
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ZeroVelocity
from icreckon.estimator.log.series import FixSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import GateSettings, Settings
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import EncoderSpec, FixSpec
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import Terrain

ROBOT = load_robot("auriga-alpha")
# What rounding may come to, in standard deviations.
ROUNDING = 1e-9
COUNTED = ("gyro", "accelerometer_x", "accelerometer_y", "position", "heading")
DURATION = 25.0
BASE = Scenario(duration=DURATION, seed=5, fix_rate=1.0)


def logs_of(scenario: Scenario, count: int) -> tuple[Log, ...]:
    return _logs_of(msgspec.json.encode(scenario), count)


@cache
def _logs_of(scenario: bytes, count: int) -> tuple[Log, ...]:
    decoded = msgspec.json.decode(scenario, type=Scenario)
    return tuple(simulate(decoded, ROBOT, run_index=run) for run in range(count))


def streamed(log: Log, robot: Robot, variant: str, settings: Settings) -> PoseEstimator:
    estimator = PoseEstimator(robot, variant, settings=settings)
    for measurement in log.measurements():
        estimator.feed(measurement)
    return estimator


def assert_same(
    variant: str,
    logs: Sequence[Log],
    settings: Settings = Settings(),  # noqa: B008 - it cannot be changed
    robot: Robot = ROBOT,
    rounding: float = ROUNDING,
) -> tuple[dict[str, np.ndarray], list[PoseEstimator]]:
    """Run both on the same logs: state, covariance and counts must be those of the streaming filter."""
    side_by_side = BatchFilter(robot, VARIANTS[variant], settings)
    streams = [streamed(log, robot, variant, settings) for log in logs]
    logs = [logs[k % len(streams)] for k in range(side_by_side.width)]
    measured = measured_of(logs, robot)
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
    counts, compared = side_by_side.counts(worked.lanes), 0
    for lane in range(side_by_side.width):
        stream = streams[lane % len(streams)]
        of_fixes = stream.health.scatter
        assert scatters(measured, steps, worked.lanes, lane) == bool(of_fixes.sigma + of_fixes.used)
        if of_fixes.sigma + of_fixes.used:
            continue
        compared += 1
        x, P = side_by_side.state(worked.lanes, lane)
        kept = slice(0, FAST_SLIP.start)
        sigma = np.sqrt(np.diagonal(stream.covariance))[kept]
        scale = np.where(sigma > 0.0, sigma, 1.0)
        assert np.abs((x - stream.state)[kept] / scale).max() < rounding
        wrong = (P - stream.covariance)[kept, kept] / np.outer(scale, scale)
        assert np.abs(wrong).max() < rounding
        for sensor, health in stream.health.sensors.items():
            if sensor in COUNTED:
                assert counts[f"{sensor}_used"][lane] == health.used
                assert counts[f"{sensor}_rejected"][lane] == health.rejected.get("gate", 0)
                assert counts[f"{sensor}_nis"][lane] == pytest.approx(health.nis_sum, rel=rounding)
        assert counts["standstill"][lane] == stream.health.standstill_updates
    assert compared
    return counts, streams


def turned_from(log: Log, first: int) -> Log:
    """A log whose fixes from one on are those of a path that is turned and moved."""
    fixes = log.fixes
    assert fixes is not None
    poses = fixes.poses.copy()
    x, y = poses[first:, 0].copy(), poses[first:, 1].copy()
    poses[first:, 0], poses[first:, 1] = 5.0 - y, x - 3.0
    return replace(log, fixes=FixSeries(fixes.stamps, poses, fixes.variances))


RARE = ("full-linear", "constant-fixed", "inertia-fixed")


@pytest.mark.parametrize("variant", [thorough(one) if one in RARE else one for one in VARIANTS])
def test_they_agree_in_every_variant(variant: str) -> None:
    counts, _ = assert_same(variant, logs_of(BASE, 4))
    assert counts["standstill"].min() > 0.0


@pytest.mark.parametrize("variant", [thorough(one) if one in RARE else one for one in VARIANTS])
def test_they_agree_on_a_slope(variant: str) -> None:
    """And with radii that differ, and an IMU away from the origin."""
    scenario = msgspec.structs.replace(
        BASE, terrain=Terrain(slope_deg=8.0, uphill_deg=30.0), trajectory="aggressive"
    )
    imu = msgspec.structs.replace(ROBOT.imu, position=(0.2, -0.1, 0.3))
    tracks = msgspec.structs.replace(ROBOT.tracks, difference=0.01, difference_sigma=0.02)
    robot = msgspec.structs.replace(ROBOT, imu=imu, tracks=tracks)
    _, streams = assert_same(variant, logs_of(scenario, 2), robot=robot)
    for stream in streams:
        assert variant == "gyro" or np.hypot(*stream.state[GRAVITY]) > 0.3


@pytest.mark.thorough
def test_they_agree_without_accelerometer() -> None:
    assert_same("inertia-online", logs_of(BASE, 2), Settings(use_accelerometer=False))


@pytest.mark.parametrize(
    ("track_rate", "imu_rate"),
    [
        (50.0, 50.0),
        (20.0, 100.0),
        thorough(100.0, 50.0),
        (25.0, 60.0),
    ],
)
def test_they_agree_at_any_rates(track_rate: float, imu_rate: float) -> None:
    scenario = msgspec.structs.replace(BASE, track_rate=track_rate, imu_rate=imu_rate)
    assert_same("inertia-online", logs_of(scenario, 2))


@pytest.mark.parametrize("reads", ["nothing", "last", "zero"])
def test_they_agree_when_encoders_drop_out(reads: str) -> None:
    encoders = EncoderSpec(dropouts_per_hour=2000.0, dropout_duration=1.0, dropout_reads=reads)
    scenario = msgspec.structs.replace(BASE, encoders=encoders, trajectory="aggressive")
    # Where a hole is found to be standstill, a variance of 5000 (rad/s)² becomes one of 1e-8 in an
    # update, which leaves few of the sixteen digits of a number to agree in.
    few_digits = reads == "nothing"
    assert_same("inertia-online", logs_of(scenario, 4), rounding=1e-7 if few_digits else ROUNDING)


def test_they_agree_on_encoders_that_count() -> None:
    encoders = EncoderSpec(resolution=2e-3)
    assert_same("constant-online", logs_of(msgspec.structs.replace(BASE, encoders=encoders), 4))


def test_they_agree_on_a_stuck_encoder() -> None:
    logs = []
    for log in logs_of(BASE, 2):
        speeds = log.tracks.speeds.copy()
        stuck = slice(600, 850)
        speeds[stuck, 0] = speeds[600, 0]
        logs.append(replace(log, tracks=type(log.tracks)(log.tracks.stamps, speeds)))
    assert_same("inertia-online", logs)


@pytest.mark.parametrize(
    ("fix_rate", "imu_rate"),
    [thorough(3.0, 100.0), thorough(7.0, 50.0), (1.5, 37.0)],
)
def test_they_agree_on_fixes_between_imu_samples(fix_rate: float, imu_rate: float) -> None:
    scenario = msgspec.structs.replace(
        BASE,
        fix_rate=fix_rate,
        imu_rate=imu_rate,
        trajectory="aggressive",
        fixes=FixSpec(heading_sigma=0.02, outlier_share=0.1, outlier_sigma=10.0),
    )
    counts, _ = assert_same("inertia-online", logs_of(scenario, 3))
    assert counts["position_rejected"].max() > 0.0
    assert counts["heading_used"].min() > 10.0


def test_a_lost_filter_finds_its_heading_from_fixes_between_imu_samples() -> None:
    scenario = msgspec.structs.replace(BASE, duration=60.0, trajectory="aggressive", fix_rate=1.5)
    assert_same("constant-online", [turned_from(log, 40) for log in logs_of(scenario, 2)])


def test_they_agree_on_headings() -> None:
    scenario = msgspec.structs.replace(BASE, fixes=FixSpec(heading_sigma=0.02))
    counts, _ = assert_same("inertia-online", logs_of(scenario, 2))
    assert counts["heading_used"].min() > 10.0


def test_they_agree_on_outliers_and_when_the_gate_gives_in() -> None:
    scenario = msgspec.structs.replace(
        BASE, duration=60.0, fixes=FixSpec(outlier_share=0.3, outlier_sigma=10.0)
    )
    counts, _ = assert_same("inertia-online", logs_of(scenario, 4))
    assert counts["position_rejected"].min() > 2.0
    moved = []
    for log in logs_of(msgspec.structs.replace(BASE, duration=40.0), 2):
        fixes = log.fixes
        assert fixes is not None
        poses = fixes.poses.copy()
        poses[15:, 0] += 30.0
        moved.append(replace(log, fixes=FixSeries(fixes.stamps, poses, fixes.variances)))
    counts, _ = assert_same("constant-online", moved)
    assert counts["position_rejected"].min() >= 10.0


def test_they_agree_when_a_wrong_heading_is_found_from_refused_fixes() -> None:
    scenario = msgspec.structs.replace(BASE, duration=90.0, trajectory="aggressive")
    turned = [turned_from(log, 40) for log in logs_of(scenario, 4)]
    _, streams = assert_same("inertia-online", turned)
    assert any(stream.health.sensors["position"].rejected for stream in streams)


def test_they_agree_where_parameters_run_into_their_bounds() -> None:
    indices = msgspec.structs.replace(ROBOT.indices, eta0=1.02, eta1=0.0, eta2=0.0)
    robot = msgspec.structs.replace(ROBOT, indices=indices)
    _, streams = assert_same("inertia-online", logs_of(BASE, 2), robot=robot)
    assert min(stream.parameters["eta0"] for stream in streams) >= 1.0


def test_gates_that_reject_nothing_agree_too() -> None:
    assert_same("inertia-online", logs_of(BASE, 2), Settings(gates=GateSettings(patience=0)))


def test_a_filter_does_not_depend_on_those_beside_it() -> None:
    """To rounding: if one lane stands, all take another kernel, which rounds in its own way."""
    scenario = msgspec.structs.replace(
        BASE, trajectory="aggressive", fixes=FixSpec(outlier_share=0.2)
    )
    logs = logs_of(scenario, 4)
    found = []
    for order in ((0, 1, 2, 3), (3, 0, 0, 0), (2, 2, 1, 3)):
        filters = BatchFilter(ROBOT, VARIANTS["inertia-online"], Settings())
        chosen = [logs[order[lane % 4]] for lane in range(filters.width)]
        measured = measured_of(chosen, ROBOT)
        stamps = measured.track_stamps, measured.imu_stamps, measured.fix_stamps
        steps = steps_of(*stamps, measured.imu_stamps[::10], heading=False)
        zero = np.zeros(3)
        (worked,) = work_through_runs([filters], [measured], steps, start=zero, start_sigma=zero)
        found.append({run: worked.lanes.workspace[:, order.index(run)] for run in set(order)})
    for run in range(4):
        columns = [columns[run] for columns in found if run in columns]
        for column in columns[1:]:
            scale = np.maximum(np.abs(columns[0]), 1e-6)
            assert (np.abs(column - columns[0]) / scale).max() < 1e-7


@pytest.mark.thorough
@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_single_precision_says_nearly_the_same(variant: str) -> None:
    """A hundredth of a standard deviation over two minutes, with standstill and drop-outs."""
    encoders = EncoderSpec(dropouts_per_hour=200.0, dropout_reads="last")
    scenario = msgspec.structs.replace(BASE, duration=120.0, encoders=encoders)
    logs = logs_of(scenario, 8)
    found = []
    for bits in (64, 32):
        filters = BatchFilter(ROBOT, VARIANTS[variant], Settings(), bits)
        measured = measured_of([logs[lane % 8] for lane in range(filters.width)], ROBOT)
        stamps = measured.track_stamps, measured.imu_stamps, measured.fix_stamps
        steps = steps_of(*stamps, measured.fix_stamps[:0], heading=False)
        zero = np.zeros(3)
        (worked,) = work_through_runs([filters], [measured], steps, start=zero, start_sigma=zero)
        assert worked.lanes.workspace.dtype.itemsize == bits / 8
        found.append([filters.state(worked.lanes, lane) for lane in range(filters.width)])
    # There are twice as many lanes in single precision; a machine has 2 to 8 in double.
    for (x, P), (y, Q) in zip(*found, strict=False):
        sigma = np.sqrt(np.diagonal(P))
        known = sigma > 0.0
        assert np.abs((y - x)[known] / sigma[known]).max() < 0.01
        assert np.allclose(np.sqrt(np.diagonal(Q))[known], sigma[known], rtol=2e-3)
        correlations = Q[np.ix_(known, known)] / np.outer(sigma[known], sigma[known])
        assert np.linalg.eigvalsh(correlations)[0] > 1e-3


def test_other_precisions_are_refused() -> None:
    with pytest.raises(BatchError, match="bits = 16"):
        BatchFilter(ROBOT, VARIANTS["constant-online"], Settings(), 16)


@pytest.mark.parametrize(
    ("variant", "considered"),
    [
        ("inertia-online", ("eta0", "accelerometer_bias_y")),
        thorough("constant-online", ("zeta0", "gyro_bias")),
    ],
)
def test_they_agree_with_consider_states(variant: str, considered: tuple[str, ...]) -> None:
    assert_same(variant, logs_of(BASE, 2), Settings(considered=considered))


def test_runs_of_other_stamps_are_refused() -> None:
    log, other = logs_of(BASE, 1)[0], simulate(msgspec.structs.replace(BASE, imu_rate=50.0), ROBOT)
    with pytest.raises(BatchError, match="other stamps"):
        measured_of([log, other], ROBOT)


def test_many_logs_are_run_as_one_by_one() -> None:
    """More than there are lanes, and not a multiple of them."""
    logs = logs_of(BASE, 9)
    found = run_many(logs, ROBOT, "constant-online", every=0.5, start=(1.0, 2.0, 0.3))
    assert len(found) == 9
    for log, trajectory in zip(logs[::4], found[::4], strict=True):
        assert len(trajectory.stamps) == 2 * DURATION + 1
        estimator = PoseEstimator(ROBOT, "constant-online", start=(1.0, 2.0, 0.3))
        measurements = list(log.measurements())
        for row, stamp in enumerate(trajectory.stamps):
            while measurements and measurements[0].stamp <= stamp:
                estimator.feed(measurements.pop(0))
            one = estimator.snapshot()
            assert np.allclose(trajectory.poses[row], one.state[:3], rtol=0.0, atol=1e-9)
            assert np.allclose(trajectory.twists[row], one.twist, rtol=0.0, atol=1e-9)
            for covariance, expected in (
                (trajectory.pose_covariances[row], one.covariance[:3, :3]),
                (trajectory.twist_covariances[row], one.twist_covariance),
            ):
                assert np.allclose(covariance, expected, rtol=1e-8, atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"logs": []}, "no logs"),
        ({"every": 0.0}, "every must be a time"),
        ({"variant": "constant-onlin"}, "constant-online"),
    ],
)
def test_what_cannot_be_run_side_by_side_is_refused(changes: dict[str, object], told: str) -> None:
    given = {"logs": logs_of(BASE, 1), "variant": "constant-online", "every": 0.1, **changes}
    with pytest.raises(EstimatorError, match=told):
        run_many(given["logs"], ROBOT, given["variant"], every=given["every"])  # type: ignore[arg-type]


def test_logs_that_hold_more_than_lanes_can_take_are_refused() -> None:
    log = logs_of(BASE, 1)[0]
    assert log.fixes is not None
    pushed = replace(log, others=(ZeroVelocity(log.start),))
    with pytest.raises(BatchError, match="ZeroVelocity"):
        run_many([pushed], ROBOT, "constant-online")
    speeds = log.tracks.speeds.copy()
    speeds[40, 1] = 1e4
    absurd = replace(log, tracks=type(log.tracks)(log.tracks.stamps, speeds))
    with pytest.raises(BatchError, match="no such sensor"):
        run_many([absurd], ROBOT, "constant-online")
    poses = log.fixes.poses.copy()
    poses[3, 2] = 0.1
    mixed = replace(log, fixes=FixSeries(log.fixes.stamps, poses, log.fixes.variances))
    with pytest.raises(BatchError, match="some have none"):
        run_many([mixed], ROBOT, "constant-online")


def test_a_bias_that_nobody_expects_is_found_when_the_gate_gives_in() -> None:
    """The streaming filter makes the bias uncertain then, though the robot file says there is none."""
    imu = msgspec.structs.replace(
        ROBOT.imu, accelerometer_bias_sigma=0.0, accelerometer_bias_walk=0.0
    )
    slope = msgspec.structs.replace(ROBOT.slope, sigma=0.0, walk=0.0)
    robot = msgspec.structs.replace(ROBOT, imu=imu, slope=slope)
    knocked = []
    for log in logs_of(msgspec.structs.replace(BASE, trajectory="aggressive"), 2):
        assert log.imu is not None
        assert log.imu.linear_acceleration is not None
        forces = log.imu.linear_acceleration.copy()
        forces[1200:, :2] += 8.0
        series = replace(log.imu, linear_acceleration=forces)
        knocked.append(replace(log, imu=series))
    counts, streams = assert_same("constant-online", knocked, robot=robot)
    for axis in "xy":
        assert counts[f"accelerometer_{axis}_rejected"].min() >= 10.0
        assert all(abs(stream.biases[f"accelerometer_bias_{axis}"]) > 1.0 for stream in streams)
