"""Sweeps and variants that cannot act are refused; results that agree to rounding are reported."""

from typing import Any

import msgspec
import pytest
from test_study_results import STUDY, stubbed

from icreckon.report.study.page import study_page
from icreckon.report.study.text import same_results
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.running.engines import ENGINES
from icreckon.simulation.running.manifest import manifest
from icreckon.simulation.running.streaming_engine import block
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import EncoderSpec, FixSpec
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.idle import refuse_idle
from icreckon.simulation.study.plan import (
    FilterSpec,
    LatinHypercube,
    Study,
    Sweep,
    load_study,
    study_names,
)
from icreckon.simulation.study.results import Runs, cell_summaries, study_results
from icreckon.simulation.study.statistics import statistics
from icreckon.simulation.truth.terrain import Payload, Terrain
from readme import code_blocks

SCENARIO = Scenario(duration=12.0, outages=((6.0, 12.0),))
INERTIA = ("constant-online", "inertia-online")
CONSTANT = ("gyro", "constant-online")


def check(
    sweep: Sweep | None = None, variants: Any = INERTIA, robot: str = "auriga-alpha", **changes: Any
) -> None:
    scenario = msgspec.structs.replace(SCENARIO, **changes)
    study = Study(name="a", scenario=scenario, variants=variants, sweep=sweep, robot=robot, runs=2)
    refuse_idle(expand(study))


@pytest.mark.parametrize(
    ("key", "values", "why"),
    [
        ("filter.vehicle.sprocket_radius", [0.1, 0.11, 0.12], "simulated tracks report speeds"),
        ("robot.vehicle.sprocket_radius", [0.1, 0.12], "simulated tracks report speeds"),
        ("true_robot.vehicle.mass", [200.0, 300.0], "cancels"),
        ("true_robot.indices.eta0", [2.0, 3.0], "kinematic truth"),
        ("filter.vehicle.max_track_speed", [1.2, 1.4], "gaps and absurd readings"),
        ("filter.imu.gyro_axes", ["xyz", "z"], "all axes but z"),
        ("gyro.bias_instability_time", [100.0, 200.0], "give bias_instability"),
        ("gyro.misalignment_sigma", [0.01, 0.02], "level gyro"),
        ("terrain.uphill_deg", [0.0, 90.0], "give slope_deg, rolling_deg or kerb_height"),
        ("terrain.wavelength", [10.0, 20.0], "give rolling_deg"),
        ("fixes.outlier_sigma", [1.0, 2.0], "give outlier_share"),
        ("encoders.dropout_duration", [1.0, 2.0], "give dropouts_per_hour"),
    ],
)
def test_a_swept_key_that_reaches_nothing_is_refused(key: str, values: list[Any], why: str) -> None:
    told = (
        rf"sweep: '{key}' changes nothing: {values[0]!r} and {values[1]!r} come to the same.*{why}"
    )
    with pytest.raises(SimulationError, match=told):
        check(Sweep(grid={key: values}))


@pytest.mark.parametrize(
    ("key", "values", "changes"),
    [
        ("filter.vehicle.mass", [200.0, 300.0], {}),
        (
            "true_robot.vehicle.mass",
            [200.0, 300.0],
            {"payloads": (Payload(mass=50.0, time=(2.0, 9.0)),)},
        ),
        ("true_robot.indices.eta0", [2.0, 3.0], {"truth": "kinematic"}),
        ("true_robot.soil.friction", [0.5, 0.9], {}),
        ("fixes.outlier_sigma", [1.0, 2.0], {"fixes": FixSpec(outlier_share=0.1)}),
        ("encoders.dropout_duration", [1.0, 2.0], {"encoders": EncoderSpec(dropouts_per_hour=9.0)}),
        ("terrain.slope_deg", [0.0, 3.0], {}),
        ("terrain.uphill_deg", [0.0, 90.0], {"terrain": Terrain(slope_deg=3.0)}),
        ("terrain.wavelength", [10.0, 20.0], {"terrain": Terrain(rolling_deg=3.0)}),
        ("gyro.misalignment_sigma", [0.01, 0.02], {"terrain": Terrain(rolling_deg=3.0)}),
        ("filter.vehicle.max_track_speed", [0.01, 1.2], {}),
        ("trajectory_options.tightest", [0.2, 0.4], {"trajectory": "arcs"}),
    ],
)
def test_a_key_that_acts_is_not_refused(key, values, changes):
    check(Sweep(grid={key: values}), **changes)


def test_one_value_that_does_not_act_alone_is_no_reason_to_refuse() -> None:
    """Without fixes their noise does not matter; in the other cells it does."""
    check(Sweep(grid={"fix_rate": [0.0, 1.0], "fixes.sigma": [0.1, 0.2]}))


def test_cases_and_keys_of_cases_that_change_nothing_are_refused() -> None:
    wheel = {"filter.vehicle.sprocket_radius": 0.2}
    cases = {"robot": {"right": {}, "wrong": wheel}}
    with pytest.raises(SimulationError, match="'robot' changes nothing: 'right' and 'wrong'"):
        check(Sweep(cases=cases))
    cases["robot"]["wrong"] = wheel | {"filter.vehicle.mass": 300.0}
    with pytest.raises(SimulationError, match=r"sprocket_radius' changes nothing: case 'wrong'"):
        check(Sweep(cases=cases))
    # A key that says what would hold anyway is no mistake.
    plain = {"filter.vehicle.mass": 300.0, "noise": "nominal"}
    check(Sweep(cases={"robot": {"right": {}, "wrong": plain}}))


def test_a_key_of_a_latin_hypercube_is_refused_though_others_act() -> None:
    ranges = {"filter.vehicle.mass": [200.0, 300.0], "gyro.factor": [0.5, 2.0]}
    check(Sweep(latin=LatinHypercube(points=4, ranges=ranges)))
    with pytest.raises(SimulationError, match=r"'filter\.vehicle\.mass' changes nothing.*cancels"):
        check(Sweep(latin=LatinHypercube(points=4, ranges=ranges)), variants=CONSTANT)


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        (
            {"variant": "constant-online", "robot": {"vehicle": {"mass": 300.0}}},
            r"robot\.vehicle\.mass of variant 'b' changes nothing in this study \(.*cancels",
        ),
        (
            {"variant": "inertia-online", "settings": {"hold": 0.5}},
            r"settings\.hold of variant 'b' changes nothing in this study \(no track speeds become",
        ),
        (
            {"variant": "inertia-online", "settings": {"history": 3.0}},
            r"settings\.history of variant 'b' changes nothing .*nothing comes late",
        ),
        ({"variant": "constant-online"}, "variants 'constant-online' and 'b' are the same filter"),
    ],
)
def test_a_variant_that_is_no_other_is_refused(spec: dict[str, Any], told: str) -> None:
    with pytest.raises(SimulationError, match=told):
        check(variants=("constant-online", FilterSpec(**spec, label="b")))


@pytest.mark.parametrize("name", study_names())
def test_the_shipped_studies_sweep_what_acts(name: str) -> None:
    refuse_idle(expand(load_study(name)))


def test_the_study_of_the_docs_acts_in_all_its_parts(tmp_path: Any) -> None:
    (text,) = code_blocks("toml", "docs/reference/study-file.md")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    study = load_study(tmp_path / "study.toml")
    refuse_idle(expand(study))
    heavy = study.filters()[-1]
    assert heavy.label == "heavy"
    short = msgspec.structs.replace(
        study,
        sweep=None,
        horizons=(5.0,),
        baseline=None,
        variants=(heavy, msgspec.structs.replace(heavy, label="right", robot={})),
        scenario=msgspec.structs.replace(study.scenario, duration=12.0, outages=((6.0, 12.0),)),
    )
    (cell,) = expand(short).cells
    found = block(cell, cell.filters, 0, 1)
    column = [one.name for one in statistics(cell.horizons)].index("position_rmse_m")
    errors = [found[label].values[0, column] for label in ("heavy", "right")]
    # The mass alone, which is what the variant is there for.
    assert abs(errors[0] / errors[1] - 1.0) > 1e-3


def test_variants_and_cells_of_the_same_results_are_named() -> None:
    runs = stubbed(STUDY)
    runs.values[1] = runs.values[0]
    runs.values[:, 3] = runs.values[:, 0]
    results = study_results(
        Runs(runs.plan, runs.values),
        manifest(runs.plan, ENGINES["streaming"]),
        cell_summaries(runs),
    )
    assert results["alike"] == {
        "variants": [["constant-online", "inertia-online"]],
        "cells": [[0, 3]],
    }
    first, second = same_results(results)
    assert first.startswith("constant-online and inertia-online gave the same results to rounding")
    assert second.startswith(
        "cell 0 (gyro.factor = 1, noise = nominal) and cell 3 (gyro.factor = 10, noise = tactical) gave"
    )
    page = study_page(results, [])
    assert page.index(first) < page.index(second) < page.index('class="headline"')


def test_terrain_without_what_it_belongs_to_is_refused_unless_that_is_swept() -> None:
    waves = Terrain(wavelength=5.0)
    with pytest.raises(SimulationError, match=r"scenario: \[terrain\] wavelength has no effect"):
        check(terrain=waves)
    check(Sweep(grid={"terrain.rolling_deg": [1.0, 3.0]}), terrain=waves)
