"""A fault that is no part of the package: a motor driver that clips the track speeds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, cast

import msgspec
import numpy as np
import pytest

from fed_estimators import feed_all
from icreckon import (
    STATE_NAMES,
    BatchError,
    EstimatorError,
    Exclude,
    Found,
    ImuSample,
    Inflate,
    Log,
    Measurement,
    OwnFault,
    PoseEstimator,
    PositionFix,
    Replace,
    Scenario,
    SimulationError,
    TrackSpeeds,
    add_fault,
    feed_arrays,
    load_robot,
    remove_fault,
    run,
    run_many,
    simulate,
)
from icreckon.estimator.base.records import Stamp
from icreckon.estimator.filter.fault_table import Effect, FilterView
from icreckon.replay.comparison.compare import compare
from icreckon.simulation.running.run_study import run_study
from icreckon.simulation.study.plan import load_study

# --- the fault ----------------------------------------------------------------------------------------


class Clipped(OwnFault):
    """Track speeds at the limit of the motor driver are larger in truth."""

    name: ClassVar[str] = "clipped"
    effect: ClassVar[str] = "the forward slip becomes uncertain"
    limit: ClassVar[float] = 0.5  # [m/s]
    since: Stamp | None = None

    def watch(self, measurement: Measurement, _view: FilterView) -> Effect | None:
        """Inflate the slip at the limit."""
        if not isinstance(measurement, TrackSpeeds):
            return None
        if max(abs(measurement.left), abs(measurement.right)) < self.limit:
            self.since = None
            return None
        if self.since is None:
            self.since = measurement.stamp
        return Inflate({"slip_x": 0.1})

    def find(self) -> Found | None:
        """Find it while it lasts."""
        if self.since is None:
            return None
        return Found("tracks", "a motor driver is at its limit", since=self.since)


# --- its tests ----------------------------------------------------------------------------------------

ALPHA = load_robot("auriga-alpha")
STEP = 10_000_000


@pytest.fixture(autouse=True)
def clipped() -> Iterator[None]:
    add_fault(Clipped)
    yield
    remove_fault("clipped")


def drive(count: int, fast_from: int) -> list[Measurement]:
    found: list[Measurement] = []
    for k in range(count):
        speed = 0.5 if k >= fast_from else 0.4
        found.append(TrackSpeeds(1 + k * 2 * STEP, speed, speed))
        found.append(ImuSample(1 + k * 2 * STEP + STEP, (0.0, 0.0, 0.0)))
    return found


def fed(measurements: list[Measurement]) -> PoseEstimator:
    return feed_all(PoseEstimator(ALPHA, "constant-online"), measurements)


def test_it_is_found_and_has_its_effect() -> None:
    well, ill = fed(drive(100, 100)), fed(drive(100, 90))
    assert well.health.finding("clipped") is None
    found = ill.health.finding("clipped")
    assert (found.sensor, found.since) == ("tracks", 1 + 180 * STEP)
    assert found.effect == Clipped.effect
    slip = STATE_NAMES.index("slip_x")
    assert ill.covariance[slip, slip] > 4.0 * well.covariance[slip, slip]


def test_late_measurements_saved_files_and_clocks_follow(tmp_path: Path) -> None:
    in_order, late = fed(drive(100, 90)), fed(drive(100, 90))
    fix = PositionFix(1 + 185 * STEP, 0.7, 0.0, 0.01)
    whole = fed(sorted([*drive(100, 90), fix], key=lambda m: m.stamp))
    assert late.feed(fix)
    np.testing.assert_allclose(late.state, whole.state, atol=1e-12)
    in_order.save(tmp_path / "saved.json")
    again = PoseEstimator.restore(tmp_path / "saved.json", ALPHA)
    assert again.health.findings == in_order.health.findings
    again.set_clock(5 * 10**9)
    found = again.health.finding("clipped")
    assert found.since == 1 + 180 * STEP + 5 * 10**9


class Doubtful(OwnFault):
    """Excludes fixes far ahead, and halves the yaw rate."""

    name: ClassVar[str] = "doubtful"
    effect: ClassVar[str] = "fixes are excluded"

    def watch(self, measurement: Measurement, view: FilterView) -> Effect | None:
        """Exclude or replace."""
        if isinstance(measurement, PositionFix) and measurement.x > view.snapshot().state[0] + 1.0:
            return Exclude()
        if isinstance(measurement, ImuSample):
            w = 0.5 * measurement.angular_velocity[2]
            return Replace(ImuSample(measurement.stamp, (0.0, 0.0, w)))
        return None


def test_measurements_are_excluded_and_replaced() -> None:
    add_fault(Doubtful)
    try:
        estimator = PoseEstimator(ALPHA, "gyro")
        for k in range(200):
            estimator.feed(TrackSpeeds(k * STEP, 0.4, 0.4))
            estimator.feed(ImuSample(k * STEP, (0.0, 0.0, 0.1)))
        assert estimator.pose[2] == pytest.approx(0.05 * 2.0, rel=0.02)
        assert not estimator.feed(PositionFix(199 * STEP, 5.0, 0.0, 0.01))
        assert estimator.feed(PositionFix(199 * STEP + 1, 0.4, 0.0, 1.0))
        position = estimator.health.sensors["position"]
        assert (position.used, position.rejected) == (1, {"doubtful": 1})
    finally:
        remove_fault("doubtful")


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(EstimatorError, match="such a fault already"):
        add_fault(Clipped)
    with pytest.raises(EstimatorError, match="a class of OwnFault with a name"):
        add_fault(int)  # type: ignore[arg-type]
    with pytest.raises(EstimatorError, match="no such fault"):
        remove_fault("unknown")

    class Wrong(OwnFault):
        name: ClassVar[str] = "wrong"
        effect: ClassVar[str] = "none"
        must: int

    with pytest.raises(EstimatorError, match="defaults"):
        add_fault(Wrong)


class Broken(OwnFault):
    """A fault whose effect is another at each test."""

    name: ClassVar[str] = "broken"
    effect: ClassVar[str] = "none"
    effects: ClassVar[Any] = None
    counted: list[int] = msgspec.field(default_factory=list)

    def watch(self, measurement: Measurement, _view: FilterView) -> Effect | None:
        """Count, and return what the test says."""
        self.counted.append(measurement.stamp)
        return cast("Effect | None", self.effects(measurement))


@pytest.fixture
def broken() -> Iterator[type[Broken]]:
    add_fault(Broken)
    yield Broken
    remove_fault("broken")
    Broken.effects = None


@pytest.mark.parametrize(
    ("effects", "text"),
    [
        (lambda _: 1 / 0, "ZeroDivisionError"),
        (lambda _: True, "no effect: True"),
        (lambda _: Inflate({"slipx": 1.0}), "no state 'slipx'"),
        (lambda _: Inflate({"slip_x": float("nan")}), "a sigma is from 0 to 1e6"),
        (lambda m: Replace(TrackSpeeds(m.stamp + 1, 0.1, 0.1)), "same type and stamp"),
        (lambda m: Replace(TrackSpeeds(m.stamp, float("nan"), 0.1)), "not finite"),
    ],
)
def test_a_fault_that_fails_is_given_up_and_reported(broken, effects, text):
    broken.effects = staticmethod(effects)
    estimator = PoseEstimator(ALPHA, "gyro")
    assert estimator.feed(TrackSpeeds(1, 0.1, 0.1))
    assert estimator.feed(TrackSpeeds(2 * STEP, 0.1, 0.1))
    found = estimator.health.finding("broken")
    assert text in found.text
    # As does one that fails at a late measurement.
    assert estimator.feed(PositionFix(STEP, 0.0, 0.0, 1.0))


def test_logs_arrays_and_processes_stream_it_and_lanes_and_studies_refuse_it(tmp_path) -> None:
    log = simulate(Scenario(duration=10.0, trajectory="straight"), ALPHA)
    fast = Log.from_measurements(
        TrackSpeeds(m.stamp, 0.6, 0.6) if isinstance(m, TrackSpeeds) else m
        for m in log.measurements()
    )
    assert run(fast, ALPHA, "gyro").health.finding("clipped") is not None
    both = compare(fast, ALPHA, ["gyro", "constant-online"], workers=2).runs.values()
    assert all(one.health.finding("clipped") is not None for one in both)
    one_by_one, arrays = (PoseEstimator(ALPHA, "gyro") for _ in range(2))
    used = sum(map(one_by_one.feed, fast.measurements()))
    assert feed_arrays(arrays, fast.tracks, fast.imu) <= used
    assert arrays.health.finding("clipped") is not None
    with pytest.raises(BatchError, match="faults of your own"):
        run_many([log], ALPHA, "gyro")
    with pytest.raises(SimulationError, match="faults of your own"):
        run_study(load_study("slopes"), tmp_path)
