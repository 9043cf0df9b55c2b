"""Effective track over the yaw rate, without a filter."""

import json
from pathlib import Path

import numpy as np
import pytest

from command_line import fails, icreckon, succeeds
from icreckon import TrackSpeedSeries
from icreckon.replay.estimates import track_by_rate as by_rate
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.track_by_rate import extremes, track_by_rate, track_windows

STEP = 0.02
RATES = (0.15, 0.4, 0.8, -0.15, -0.4, -0.8)
SECONDS = 10.0


def turning(track, *, hole: bool = False) -> tuple[TrackSpeedSeries, YawRates]:
    """Steady turns, with an effective track [m] by the yaw rate."""
    rates = np.repeat(RATES, round(SECONDS / STEP))
    stamps = (np.arange(len(rates)) * STEP * 1e9).astype(np.int64)
    noise = np.random.default_rng(1).normal(0.0, 0.01, len(rates))
    half = 0.5 * (np.array([track(rate) for rate in rates]) * rates + noise)
    kept = np.ones(len(rates), bool)
    if hole:
        kept[: round(0.9 * SECONDS / STEP)] = np.arange(round(0.9 * SECONDS / STEP)) % 50 == 0
    tracks = TrackSpeedSeries(stamps[kept], np.column_stack([0.5 - half, 0.5 + half])[kept])
    return tracks, YawRates(stamps, rates)


def test_a_track_that_is_the_same_at_all_rates_is_found_so() -> None:
    bins = track_by_rate(track_windows(*turning(lambda _: 1.5)))
    assert [round(one.rate, 2) for one in bins] == sorted(RATES)
    for one in bins:
        assert one.track == pytest.approx(1.5, abs=4.0 * one.sigma)
        assert one.sigma < 0.02
        assert one.seconds == pytest.approx(SECONDS, abs=3.0 * by_rate.WINDOW)
    assert extremes(bins) is None


def test_one_that_depends_on_the_rate_is_reported_with_both_ends() -> None:
    bins = track_by_rate(track_windows(*turning(lambda rate: 1.2 + 0.1 / abs(rate))))
    low, high = extremes(bins)
    assert low.track == pytest.approx(1.325, abs=0.02)
    assert abs(low.rate) == pytest.approx(0.8, abs=0.01)
    assert high.track == pytest.approx(1.867, abs=0.05)


def test_a_bias_of_the_gyro_is_taken_off() -> None:
    tracks, (stamps, rates) = turning(lambda _: 1.5)
    found = track_by_rate(track_windows(tracks, YawRates(stamps, rates + 0.05), 0.05))
    assert all(one.track == pytest.approx(1.5, abs=0.03) for one in found)


def test_holes_and_changes_of_the_rate_do_not_count() -> None:
    tracks, (stamps, rates) = turning(lambda _: 1.5, hole=True)
    windows = track_windows(tracks, YawRates(stamps, rates))
    bins = {round(one.rate, 2): one for one in track_by_rate(windows)}
    assert 0.15 not in bins
    assert bins[0.4].track == pytest.approx(1.5, abs=0.02)
    wild = np.sin(np.arange(len(rates)) * STEP * 4.0)
    assert track_by_rate(track_windows(tracks, YawRates(stamps, wild))) == []


def test_inspect_draws_it_and_says_so_where_nothing_shows_it(tmp_path: Path) -> None:
    words = ("--duration", "150", "--fix-rate", "0", "--seed", "4")
    icreckon("simulate", "--out", "turning", "--trajectory", "arcs", *words, cwd=tmp_path)
    done = succeeds("inspect", "turning", "--picture", "track.png", "--json", cwd=tmp_path)
    assert (tmp_path / "track.png").read_bytes().startswith(b"\x89PNG")
    track = json.loads(done.stdout)["track"]
    assert track["unit"] == "m"
    assert all(abs(one["track"] / track["whole"] - 1.0) < 0.2 for one in track["bins"])
    assert {one["rate"] > 0.0 for one in track["bins"]} == {True, False}
    again = fails("inspect", "turning", "--picture", "track.png", cwd=tmp_path)
    assert "exists already" in again
    icreckon(
        "simulate", "--out", "ahead", "--trajectory", "straight", "--duration", 20, cwd=tmp_path
    )
    assert "does not show the effective track" in fails(
        "inspect", "ahead", "--picture", "none.png", cwd=tmp_path
    )
    assert not (tmp_path / "none.png").exists()
