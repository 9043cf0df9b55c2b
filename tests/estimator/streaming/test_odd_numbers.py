"""Numbers that are no measurements: refused or an error, and the estimator goes on."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from fed_estimators import known
from icreckon import EstimatorError, PoseEstimator, TrackSpeedSeries, load_robot
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    HeightFix,
    ImuSample,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)
from icreckon.estimator.robot.settings import GateSettings, Settings

ALPHA = load_robot("auriga-alpha")
EPOCH = 1_700_000_000_000_000_000
STEP = 10_000_000
HUGE = 10**400


class OwnFloat(float):
    """A subclass of a float, as units and automatic differentiation have them."""


class OwnInt(int):
    """A subclass of an integer."""


NUMBERS = [
    Decimal("0.5"), Fraction(1, 2), np.float16(0.5), np.float32(0.5), np.longdouble(0.5),
    np.array(0.5), OwnFloat(0.5),
]  # fmt: skip
NANS = [Decimal("NaN"), math.nan]
BEYOND = [
    HUGE, -HUGE, 10**5000, Fraction(HUGE, 3), Decimal("1e400"), np.longdouble("1e4000"),
    *NANS, -math.inf,
]  # fmt: skip
NO_NUMBERS = [
    "0.5", b"1", True, np.True_, 1j, np.complex128(1.0), Decimal("sNaN"), None, (), [0.5],
    np.array([0.5]), np.array("x"), np.datetime64("2020"), object(),
]  # fmt: skip
STAMPS = [HUGE, -HUGE, 10**5000, 2**63, 2**63 - 1, 2**62, -(2**63), -(2**61) - 1, np.uint64(2**63)]
NO_STAMPS = [1e18, np.float64(EPOCH), Decimal(EPOCH), "1", None, True, 1j, np.datetime64("2020")]


def of_kinds(stamp, value):
    """Measurements with a value in each of their fields."""
    one = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return [
        TrackSpeeds(stamp, value, 0.1),
        TrackSpeeds(stamp, 0.1, value),
        ImuSample(stamp, (0.0, 0.0, value), None),
        ImuSample(stamp, (0.0, 0.0, 0.1), (value, 0.0, 9.8)),
        PositionFix(stamp, value, 0.0, 1.0),
        PositionFix(stamp, 0.0, 0.0, value),
        PositionFix(stamp, 0.0, 0.0, 1.0, value, 0.0),
        HeadingFix(stamp, value, 1.0),
        HeadingFix(stamp, 0.0, value),
        BodyVelocity(stamp, value, 0.0, 1.0),
        BodyVelocity(stamp, 0.1, 0.0, value),
        PoseFix(stamp, value, 0.0, 0.0, one),
        PoseFix(stamp, 0.0, 0.0, 0.0, ((value, 0.0, 0.0), *one[1:])),
        ZeroVelocity(stamp, (value, 1.0, 1.0)),
    ]


def drive(estimator, start):
    for k in range(30):
        stamp = start + k * STEP
        estimator.feed(TrackSpeeds(stamp, 0.3, 0.35))
        estimator.feed(ImuSample(stamp + 3, (0.0, 0.0, 0.04), (0.0, 0.0, 9.81)))
    return start + 30 * STEP


def count_of(estimator):
    return sum(estimator.health.rejections().values())


@pytest.mark.parametrize("started", [False, True])
def test_what_is_no_number_is_an_error_and_what_is_beyond_floats_is_rejected(started):
    odd, even = PoseEstimator(ALPHA), PoseEstimator(ALPHA)
    if started:
        for estimator in (odd, even):
            drive(estimator, EPOCH)
    before = known(even)
    after = EPOCH + 30 * STEP
    for value in NO_NUMBERS:
        for m in of_kinds(after, value):
            if isinstance(m, ImuSample) and value is None and m.linear_acceleration is None:
                continue
            with pytest.raises(EstimatorError, match=r"must be (a number|three )") as found:
                odd.feed(m)
            assert len(str(found.value)) < 400
    assert count_of(odd) == 0
    for value in BEYOND:
        for m in of_kinds(after, value):
            if isinstance(m, ImuSample) and m.linear_acceleration and value in NANS:
                continue  # there is no accelerometer then
            rejected = count_of(odd)
            assert odd.feed(m) is False
            assert count_of(odd) == rejected + 1
    assert known(odd) == before
    for estimator in (odd, even):
        drive(estimator, after)
    assert known(odd) == known(even)


@pytest.mark.parametrize("stamp", STAMPS, ids=lambda stamp: f"{int(stamp).bit_length()} bits")
def test_a_stamp_beyond_64_bits_is_rejected_and_the_next_counts(stamp):
    odd, even = PoseEstimator(ALPHA), PoseEstimator(ALPHA)
    for estimator in (odd, even):
        drive(estimator, EPOCH)
    for m in of_kinds(stamp, 0.5):
        for _ in range(12):  # as often as a clock that jumps ahead needs to be accepted
            assert odd.feed(m) is False
    assert odd.health.sensors["tracks"].rejected == {"stamp out of range": 24}
    for use in (odd.mark, odd.forget, odd.relative_motion):
        with pytest.raises(EstimatorError, match="stamp out of range"):
            use(stamp)
    for estimator in (odd, even):
        drive(estimator, EPOCH + 30 * STEP)
    assert known(odd) == known(even)


@pytest.mark.parametrize("stamp", NO_STAMPS, ids=lambda stamp: type(stamp).__name__)
def test_what_is_no_stamp_is_an_error(stamp):
    estimator = PoseEstimator(ALPHA)
    drive(estimator, EPOCH)
    before = known(estimator)
    for m in of_kinds(stamp, 0.5):
        with pytest.raises(EstimatorError, match="a stamp is an integer of nanoseconds, found"):
            estimator.feed(m)
    for use in (estimator.forget, *([] if stamp is None else [estimator.mark])):
        with pytest.raises(EstimatorError, match="a stamp is an integer of nanoseconds, found"):
            use(stamp)
    assert known(estimator) == before


@pytest.mark.parametrize("number", NUMBERS, ids=lambda number: type(number).__name__)
def test_numbers_of_any_kind_count_as_floats(number):
    odd, even = (PoseEstimator(ALPHA, start_sigma=(0.1, 0.1, 0.1)) for _ in range(2))
    for k, (ours, theirs) in enumerate(
        zip(of_kinds(EPOCH, number), of_kinds(EPOCH, 0.5), strict=True)
    ):
        stamp = EPOCH + k * STEP
        for estimator, m in ((odd, ours), (even, theirs)):
            m = type(m)(OwnInt(stamp), *(getattr(m, name) for name in m.__match_args__[1:]))
            estimator.feed(m)
    assert known(odd) == known(even)
    assert odd.health == even.health


@pytest.mark.parametrize(
    ("fix", "reason"),
    [
        (PositionFix(EPOCH, 1e11, 0.0, 1.0), "absurdly far"),
        (PositionFix(EPOCH, 0.0, -1e300, 1.0), "absurdly far"),
        (PositionFix(EPOCH, 0.0, 0.0, 1.0, 0.0, 1e4), "absurdly far"),
        (PoseFix(EPOCH, 1e300, 0.0, 0.0, np.eye(3)), "absurdly far"),
        (PositionFix(EPOCH, 0.0, 0.0, 1.0, up=1e4), "absurdly far"),
        (HeightFix(EPOCH, 1e160, 1.0), "absurdly far"),
        (PoseFix(EPOCH, math.nan, 1e300, 0.0, np.eye(3)), "x is not finite"),
    ],
)
def test_fixes_off_the_map_are_rejected(fix, reason):
    estimator = PoseEstimator(ALPHA, settings=Settings(gates=GateSettings(patience=0)))
    assert estimator.feed(fix) is False
    (sensor,) = estimator.health.sensors.values()
    assert sensor.rejected == {reason: 1}


@pytest.mark.parametrize(
    ("per_second", "least", "most"),
    [(1, 30, 70), (1000, 30, 70), (1_000_000, 500, 600)],
    ids=["seconds", "milliseconds", "microseconds"],
)
def test_stamps_in_another_unit_are_an_error_after_a_while(per_second, least, most):
    estimator = PoseEstimator(ALPHA)
    stamps = 1_700_000_000 * per_second + np.arange(600) * max(1, per_second // 50)
    measurements = [TrackSpeeds(stamp, 0.5, 0.5) for stamp in stamps.tolist()]
    with pytest.raises(EstimatorError, match="stamps must be nanoseconds"):
        all(map(estimator.feed, measurements))
    assert least <= estimator.health.sensors["tracks"].used <= most
    with pytest.raises(EstimatorError, match="stamps must be nanoseconds"):
        TrackSpeedSeries(stamps, np.zeros((600, 2)))
