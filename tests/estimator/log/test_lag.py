"""Lag of one series behind another: found where it shows, and a reason where it does not."""

import numpy as np
import pytest

from icreckon.estimator.log.lag import LEAST_TURN, Curve, Lag, NoLag, find_lag, places_of, turned
from icreckon.estimator.log.series import PoseSeries

RATE = 50.0


def stamps_of(times: np.ndarray) -> np.ndarray:
    return (times * 1e9).astype(np.int64)


def rates(times: np.ndarray, seed: int = 3) -> np.ndarray:
    """Yaw rate [rad/s] with a new value every two seconds."""
    knots = np.arange(-20.0, 400.0, 2.0)
    return np.interp(times, knots, np.random.default_rng(seed).normal(0.0, 0.5, len(knots)))


def weaving(
    late: float = 0.0, *, seconds: float = 120.0, noise: float = 0.003
) -> tuple[Curve, Curve]:
    """Heading at 10 Hz that is late, and the gyro's angle, whose bias is 0.01 rad/s."""
    times = np.arange(0.0, seconds, 1.0 / RATE)
    gyro = turned(stamps_of(times), rates(times) + 0.01)
    fine = np.arange(-20.0, seconds, 1.0 / RATE)
    angle = np.cumsum(rates(fine)) / RATE
    own = np.arange(0.0, seconds, 0.1)
    yaw = np.interp(own - late, fine, angle) + np.random.default_rng(1).normal(0.0, noise, len(own))
    return Curve(stamps_of(own), yaw), gyro


@pytest.mark.parametrize("late", [-0.4, 0.0, 0.137, 0.5, 1.1, 3.3, -7.0])
def test_a_known_lag_is_found(late: float) -> None:
    """Also that of a clock that is seconds off."""
    found = find_lag(*weaving(late))
    # The sums of both sides differ by half a sample.
    assert found.seconds == pytest.approx(late, abs=0.5 / RATE + 0.005)
    assert found.sigma < 0.01


def test_jumps_do_not_move_it_and_a_scale_is_none() -> None:
    heading, gyro = weaving(0.3)
    jumping = heading.values.copy()
    jumping[200:] += 3.0
    jumping[700:] -= 2.0
    jumping[::97] += 1.0
    found = find_lag(Curve(heading.stamps, 7.0 * jumping), gyro)
    assert found.seconds == pytest.approx(0.3, abs=0.02)


def test_its_error_is_its_spread() -> None:
    """Over drives of half a minute with much noise."""
    found = []
    for seed in range(24):
        heading, gyro = weaving(0.2, seconds=40.0, noise=0.0)
        noise = np.random.default_rng(100 + seed).normal(0.0, 0.1, len(heading.values))
        found.append(find_lag(Curve(heading.stamps, heading.values + noise), gyro))
    lags = [one for one in found if isinstance(one, Lag)]
    assert len(lags) > 20
    spread = np.std([one.seconds for one in lags])
    assert 0.4 < np.median([one.sigma for one in lags]) / spread < 2.5


def test_a_lag_that_does_not_show_has_a_reason() -> None:
    heading, gyro = weaving(0.3)
    times = (gyro.stamps - gyro.stamps[0]) * 1e-9
    noise = np.random.default_rng(5).normal(0.0, 0.02, len(times))
    quiet = turned(gyro.stamps, noise)
    fixed = Curve(heading.stamps, np.full(len(heading.stamps), 0.7))
    other = Curve(heading.stamps, np.cumsum(rates(heading.stamps * 1e-9, seed=9)) / 10.0)
    turning = Curve(heading.stamps, 0.4 * heading.stamps * 1e-9)
    steady = turned(gyro.stamps, np.full(len(times), 0.4))
    for what, late, reference, reason in (
        ("stands, or drives straight on", heading, quiet, "too little"),
        ("a truth without turning", fixed, gyro, "too little"),
        ("turns evenly", turning, steady, "too little"),
        ("beyond the search", weaving(14.0)[0], gyro, "nothing agrees"),
        ("another robot", other, gyro, "nothing agrees"),
        ("too short", *weaving(0.3, seconds=9.0), "too short"),
        ("no samples", Curve(heading.stamps[:1], heading.values[:1]), gyro, "no samples"),
        ("noise", weaving(0.3, noise=1.5, seconds=30.0)[0], gyro, ""),
    ):
        found = find_lag(late, reference, least=LEAST_TURN)
        assert isinstance(found, NoLag), what
        assert reason in found.reason, what


def test_places_show_it_by_changes_of_speed() -> None:
    times = np.arange(0.0, 120.0, 1.0 / RATE)
    yaw = np.cumsum(rates(times)) / RATE
    for speed, shown in (
        (0.8 + 0.3 * rates(times, seed=8), True),
        (np.full(len(times), 0.8), False),
    ):
        step = speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]) / RATE
        path = PoseSeries(stamps_of(times), np.column_stack([np.cumsum(step, axis=0), yaw]))
        # In a turned frame, and late.
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        places = path.poses[::5, :2] @ turn + np.random.default_rng(2).normal(
            0.0, 0.01, (len(times[::5]), 2)
        )
        late = PoseSeries(
            path.stamps[::5] + 250_000_000, np.column_stack([places, np.zeros(len(places))])
        )
        found = find_lag(places_of(late), places_of(path), least=0.05)
        assert isinstance(found, Lag) == shown
        if isinstance(found, Lag):
            assert found.seconds == pytest.approx(0.25, abs=0.01)


def test_windows_across_gaps_do_not_count() -> None:
    """Of a truth that was away, and of a gyro; in a gap nothing may be interpolated."""
    heading, gyro = weaving(0.3, noise=0.0)
    for gaps in ((heading, gyro), (gyro, heading)):
        kept = np.ones(len(gaps[0].stamps), dtype=bool)
        for begin in range(10, 110, 20):
            at = gaps[0].stamps * 1e-9
            kept &= (at < begin) | (at > begin + 8.0)
        with_gaps = Curve(gaps[0].stamps[kept], gaps[0].values[kept])
        late, reference = (with_gaps, gyro) if gaps[0] is heading else (heading, with_gaps)
        found = find_lag(late, reference)
        assert found.seconds == pytest.approx(0.3, abs=0.015)
