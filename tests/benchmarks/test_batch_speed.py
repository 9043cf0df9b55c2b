"""Filters side by side are as fast as they are for: a ratio, measured in one run."""

import sys

import pytest

from conftest import REPOSITORY

BENCHMARKS = REPOSITORY / "benchmarks"
# How many times faster than the algebra of filterpy's EKF a full filter must be, per CPU second.
FLOOR = 200.0


@pytest.fixture
def engines(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import engines

    yield engines
    for name in ("engines", "step_time"):
        sys.modules.pop(name, None)


def test_a_full_filter_is_two_hundred_times_as_fast_as_filterpys_algebra(engines) -> None:
    drive = engines.Drive(engines.FULL)
    ratios = []
    for _ in range(5):
        filterpy = 1e-6 * engines.plain_microseconds(1000)
        ratios.append(filterpy / engines.best(drive.seconds, 8))
    assert max(ratios) > FLOOR
