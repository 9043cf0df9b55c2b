"""The in-memory log: screening, shapes, and the order in which it hands out measurements."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

import icreckon
from conftest import make_log
from icreckon import (
    BodyVelocity,
    EstimatorError,
    FixSeries,
    HeadingFix,
    HeightFix,
    ImuSample,
    ImuSeries,
    Log,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    TrackSpeedSeries,
    Truth,
    ZeroVelocity,
)
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.input_checks import STREAMS, key_of
from icreckon.estimator.log.log import screen
from icreckon.estimator.log.series import running_integral


def stamps(*values):
    return np.array(values, dtype=np.int64)


@pytest.mark.parametrize(
    ("stamps", "kept", "reason"),
    [
        ([1, 2, 2, 2, 3], [True, True, False, False, True], {"duplicate stamp": 2}),
        ([10, 11, 12, 9, 13, 14], [True] * 3 + [False] + [True] * 2, {"stamp goes backward": 1}),
        ([10, 11, 3600, 12, 13], [True, True, False, True, True], {"stamp jumps ahead": 1}),
    ],
)
def test_one_bad_stamp_costs_its_sample_and_no_other(stamps, kept, reason):
    keep, reasons = screen("tracks", stamps, np.zeros(len(stamps)))
    assert keep.tolist() == kept
    assert reasons == {f"tracks: {words}": count for words, count in reason.items()}


def test_each_sample_is_counted_once_by_its_first_defect():
    keep, reasons = screen(
        "fixes",
        [1, 2, 2, 1, 3, 4, 5],
        [0.0, 0.0, np.nan, 0.0, np.inf, 0.0, 0.0],
        positive=[1.0, 1.0, -1.0, 1.0, 0.0, 0.0, 1.0],
    )
    assert keep.tolist() == [True, True, False, False, False, False, True]
    assert reasons == {
        "fixes: not finite": 2,
        "fixes: variance not positive": 1,
        "fixes: stamp goes backward": 1,
    }
    assert sum(reasons.values()) == np.count_nonzero(~keep)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: TrackSpeedSeries(stamps(1, 2), np.zeros((2, 3))), "speeds"),
        (lambda: TrackSpeedSeries(stamps(1), np.zeros((1, 2)), np.zeros(1)), "left_wheels"),
        (lambda: ImuSeries(stamps(1), np.zeros((1, 2))), "angular_velocity"),
        (lambda: ImuSeries(stamps(1), np.zeros((1, 3)), np.zeros(3)), "linear_acceleration"),
        (lambda: FixSeries(stamps(1), np.zeros((1, 3)), np.zeros((1, 1))), "variances"),
    ],
)
def test_wrong_shape_is_refused_by_name(make, name):
    with pytest.raises(EstimatorError, match=f"{name} must have shape .* found"):
        make()


def test_at_equal_stamps_tracks_come_first_then_imu_then_fixes():
    at = stamps(5, 7)
    log = Log(
        "equal",
        TrackSpeedSeries(at, np.array([[0.1, 0.2], [0.3, 0.4]])),
        ImuSeries(at, np.ones((2, 3))),
        FixSeries(at, np.array([[1.0, 2.0, np.nan], [3.0, 4.0, 0.5]]), np.full((2, 2), 0.25)),
    )
    assert list(log.measurements()) == [
        TrackSpeeds(5, 0.1, 0.2),
        ImuSample(5, (1.0, 1.0, 1.0)),
        PositionFix(5, 1.0, 2.0, 0.25),
        TrackSpeeds(7, 0.3, 0.4),
        ImuSample(7, (1.0, 1.0, 1.0)),
        PositionFix(7, 3.0, 4.0, 0.25),
        HeadingFix(7, 0.5, 0.25),
    ]


def test_start_and_end_are_those_of_tracks_and_imu():
    log = Log(
        "spans",
        TrackSpeedSeries(stamps(2_000_000_000, 5_000_000_000), np.zeros((2, 2))),
        ImuSeries(stamps(1_000_000_000, 4_000_000_000), np.zeros((2, 3))),
        FixSeries(stamps(0), np.zeros((1, 3)), np.ones((1, 2))),
    )
    assert (log.start, log.end) == (1_000_000_000, 5_000_000_000)
    assert log.duration == 4.0


def test_log_of_nothing_says_so():
    log = Log("nothing", TrackSpeedSeries(stamps(), np.zeros((0, 2))))
    with pytest.raises(EstimatorError, match="'nothing' holds neither track speeds nor IMU"):
        _ = log.duration
    assert list(log.measurements()) == []


COVARIANCE = ((0.04, 0.01, 0.0), (0.01, 0.05, 0.02), (0.0, 0.02, 0.3))


def all_kinds():
    """Measurements of all kinds, in order, many with equal stamps; one IMU sample has no force."""
    found = list(make_log(seconds=2.0).measurements())
    at = next(m.stamp for m in found[20:] if isinstance(m, PositionFix))
    found += [
        BodyVelocity(at, 0.3, 0.0, 0.01),
        PoseFix(at, 0.1, 0.2, 0.3, COVARIANCE),
        PoseFix(at + 1, 0.1, 0.2, 0.3, COVARIANCE),
        ZeroVelocity(at, (0.1, 0.2, 0.3)),
        HeadingFix(at + 1, 0.3, 0.4),
        HeightFix(at + 1, 12.0, 0.5),
        ImuSample(at + 1, (0.0, 0.0, 0.1)),
        ZeroVelocity(at + 2),
    ]
    return sorted(found, key=key_of)


def test_a_log_of_its_measurements_has_the_same_measurements():
    for measurements in (all_kinds(), list(make_log().measurements())):
        assert list(Log.from_measurements(measurements).measurements()) == measurements
    kinds = {type(m) for m in all_kinds()}
    assert kinds == set(STREAMS), "or a kind is not tested"


def test_the_order_that_measurements_are_given_in_does_not_matter():
    measurements = all_kinds()
    shuffled = [measurements[i] for i in np.random.default_rng(0).permutation(len(measurements))]
    log = Log.from_measurements((m for m in shuffled), name="mixed")
    assert log.name == "mixed"
    assert list(log.measurements()) == measurements
    for series in (log.tracks, log.imu, log.fixes):
        assert (np.diff(series.stamps) > 0).all()
    # A heading that comes with a position is part of that fix.
    assert sum(isinstance(m, HeadingFix) for m in log.others) == 1
    assert log.dropped == {}


def test_what_cannot_be_right_is_dropped_and_counted():
    good = all_kinds()
    bad = [
        TrackSpeeds(1, np.nan, 0.0),
        good[5],
        PositionFix(1, 0.0, 0.0, -1.0),
        PoseFix(2, 0.0, 0.0, 0.0, ((1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
        ZeroVelocity(3, (0.0, 1.0, 1.0)),
    ]
    log = Log.from_measurements(good + bad)
    assert list(log.measurements()) == good
    assert log.dropped == {
        "tracks: left is not finite": 1,
        f"{STREAMS[type(good[5])]}: duplicate stamp": 1,
        "position: variance not positive": 1,
        "pose: covariance not positive definite": 1,
        "zero velocity: sigma not positive": 1,
    }


def test_a_part_of_a_log_has_what_lies_between():
    log = make_log()
    begin, end = log.start + 1_000_000_000, log.start + 2_000_000_000
    part = log.between(begin, end)
    wanted = [one for one in log.measurements() if begin <= one.stamp <= end]
    assert list(part.measurements()) == wanted
    for cut in (part.truth.poses, part.truth.twists, part.truth.tracks):
        assert begin <= cut.stamps[0] < cut.stamps[-1] <= end
    assert log.between(log.start, log.end).tracks.speeds.shape == log.tracks.speeds.shape
    bare = replace(log, imu=None, fixes=None, truth=None)
    assert bare.between(begin, end).imu is None


@pytest.mark.parametrize("shape", [(), (2,)])
@pytest.mark.parametrize("kind", [float, complex])
def test_it_is_the_trapezoidal_rule_at_uneven_stamps(shape: tuple[int, ...], kind: type) -> None:
    rng = np.random.default_rng(1)
    stamps = 1_700_000_000 * 10**9 + np.cumsum(rng.integers(1, 10**8, 50))
    values = rng.normal(size=(50, *shape)).astype(kind)
    if kind is complex:
        values += 1j * rng.normal(size=values.shape)
    seconds = (stamps - stamps[0]) * NANOSECOND
    expected = cumulative_trapezoid(values, seconds, axis=0, initial=0.0)
    assert running_integral(stamps, values) == pytest.approx(expected, abs=1e-12)


ROBOT = icreckon.load_robot("auriga-alpha")
STAMPS = np.arange(50) * 20_000_000
TRACKS = TrackSpeedSeries(STAMPS, np.full((50, 2), 0.2))
IMU = ImuSeries(STAMPS, np.zeros((50, 3)))
LOG = Log("a", TRACKS, IMU)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: TrackSpeedSeries(STAMPS * 1e-9, np.zeros((50, 2))), r"integers \[ns\].*astype"),
        (lambda: TrackSpeedSeries([1, 2], np.zeros((2, 2))), "stamps must be a numpy array"),
        (
            lambda: TrackSpeedSeries(STAMPS, np.full((50, 2), "1")),
            "speeds must be numbers, found <U1",
        ),
        (lambda: ImuSeries(np.array([1, 3, 2]), np.zeros((3, 3))), "stamps of angular_velocity go"),
        (lambda: Truth(np.zeros((3, 3))), r"poses must be PoseSeries\(\.\.\.\), found ndarray"),
        (lambda: Log("x", IMU), r"tracks must be TrackSpeedSeries\(\.\.\.\), found ImuSeries"),
        (lambda: Log("x", TRACKS, imu=TRACKS), "imu must be ImuSeries.* or None, found TrackSp"),
        (lambda: icreckon.compare(ROBOT, LOG), r"log must be Log\(\.\.\.\), found Robot"),
        (lambda: icreckon.compare(LOG, "warthog"), "robot must be a Robot"),
        (lambda: icreckon.calibrate([TRACKS], ROBOT), "each of logs must be Log"),
        (lambda: icreckon.simulate(ROBOT, icreckon.Scenario()), "scenario must be Scenario"),
    ],
)
def test_it_is_named(make: Any, words: str) -> None:
    with pytest.raises(icreckon.IcreckonError, match=words) as found:
        make()
    assert len(str(found.value)) < 300


def test_values_of_other_types_are_floats() -> None:
    series = TrackSpeedSeries(STAMPS, np.ones((50, 2), np.float32), *[np.ones((50, 1), int)] * 2)
    arrays = series.speeds, series.left_wheels, series.right_wheels
    assert all(array.dtype == float and (array == 1.0).all() for array in arrays)
