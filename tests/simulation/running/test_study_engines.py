"""Engines of studies give the same statistics of the same runs."""

import numpy as np
import pytest

from conftest import thorough
from icreckon import EncoderSpec, FixSpec, Scenario, Study, Terrain
from icreckon.simulation.running import batch_engine as study_batch
from icreckon.simulation.running import streaming_engine as study_streaming
from icreckon.simulation.running.engines import choose_engine
from icreckon.simulation.study.cells import Cell, Plan, expand

VARIANTS = ("constant-online", "inertia-online")
POOR = EncoderSpec(resolution=0.002, dropouts_per_hour=300.0)


def plan_of(variants=VARIANTS, **changes: object) -> Plan:
    given = {
        "duration": 40.0,
        "truth_rate": 10.0,
        "outages": ((15.0, 38.0),),
        "noise": "industrial",
    }
    scenario = Scenario(**{**given, **changes})  # type: ignore[arg-type]
    return expand(
        Study(name="engines", scenario=scenario, variants=variants, runs=11, truths=3, seed=4)
    )


def assert_engines_agree(cell: Cell, runs: range, group: range | None = None) -> None:
    """Compare both engines over some runs, which the batch engine computes within a group."""
    group = group or runs
    batch = study_batch.block(cell, cell.filters, group.start, len(group)).values
    streamed = study_streaming.block(cell, cell.filters, runs.start, len(runs)).values
    batch = batch[:, runs.start - group.start :][:, : len(runs)]
    # A hole of the encoders at standstill leaves few digits to agree in.
    np.testing.assert_allclose(batch, streamed, rtol=1e-6, atol=1e-9, equal_nan=True)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        thorough({"fix_rate": 0.0, "outages": ()}),
        {"fixes": FixSpec(heading_sigma=0.02, outlier_share=0.2), "fix_rate": 3.0},
        {"encoders": POOR, "trajectory": "aggressive"},
        {"terrain": Terrain(rolling_deg=5.0, wavelength=10.0, slope_deg=2.0)},
    ],
    ids=["outage", "no fixes", "between samples", "poor encoders", "rolling ground"],
)
def test_side_by_side_and_one_after_the_other_come_to_the_same(changes: dict[str, object]) -> None:
    # The lanes of each variant are compared in test_agreement.py, so one will do here.
    cell = plan_of(("constant-online",) if changes else VARIANTS, **changes).cells[0]
    # The last of eleven runs, and some of the others, are in a group that is not full.
    assert_engines_agree(cell, range(9, 11), group=range(11))


def test_a_block_does_not_depend_on_the_one_it_is_cut_from() -> None:
    cell = plan_of().cells[0]
    whole = study_batch.block(cell, cell.filters, 0, 11)
    part = study_batch.block(cell, cell.filters, 3, 4)
    # Steps in which no lane stands are compiled apart, so the last bit depends on the others.
    # An error of 1e-3 rad between yaws of some radians is known to 1e-15.
    found = whole.values[:, 3:7]
    assert np.allclose(found, part.values, rtol=1e-13, atol=1e-14, equal_nan=True)


@pytest.mark.parametrize(
    ("changes", "engine"),
    [
        ({}, "batch"),
        ({"fix_rate": 3.0}, "batch"),
        ({"truth_rate": 7.0}, "batch"),
        ({"encoders": EncoderSpec(dropouts_per_hour=9.0), "track_rate": 200.0}, "streaming"),
    ],
)
def test_auto_takes_the_fastest_that_can(changes: dict[str, object], engine: str) -> None:
    assert choose_engine(plan_of(**changes)).name == engine  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("run", "changes"),
    [
        (2, {"truth_rate": 20.0}),
        thorough(2, {"truth_rate": 37.0, "imu_rate": 37.0}),
        (2, {"track_rate": 3.0}),
        (2, {"imu_rate": 60.0, "fix_rate": 0.7}),
        # One run alone is in all lanes: where its encoders drop out, no lane has a sample.
        (10, {"encoders": EncoderSpec(dropouts_per_hour=600.0, dropout_duration=0.5)}),
    ],
    ids=str,
)
def test_a_single_run_at_any_rate_comes_to_the_same(run: int, changes: dict[str, object]) -> None:
    assert_engines_agree(plan_of(("constant-online",), **changes).cells[0], range(run, run + 1))


def test_readings_that_are_refused_beforehand_are_refused_by_both() -> None:
    cell = plan_of(encoders=EncoderSpec(speed_noise_density=1.0)).cells[0]
    found = study_batch.block(cell, cell.filters, 0, 2)
    streamed = study_streaming.block(cell, cell.filters, 0, 2)
    assert np.array_equal(found.values, streamed.values, equal_nan=True)
