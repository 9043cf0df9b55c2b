"""What a study sums up, and how it says so."""

import copy
import html
import io
import json
import re

import msgspec
import numpy as np
import pytest
from scipy import stats

import study_stub
from command_line import blank
from icreckon import Scenario, Study, Sweep, drift, pose_nees, run, velocity_errors
from icreckon.estimator.log.scores import HORIZONS, without_fixes
from icreckon.report.study import figures as study_drawings
from icreckon.report.study.figures import study_figures
from icreckon.report.study.folder import study_page
from icreckon.report.study.text import headline, notes, same_results, summary_tables
from icreckon.simulation.running.engines import STREAMING
from icreckon.simulation.running.manifest import as_json, manifest
from icreckon.simulation.running.streaming_engine import study_log
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import LatinHypercube
from icreckon.simulation.study.results import Runs, cell_summaries, groups_of, study_results
from icreckon.simulation.study.statistics import DRIFT, run_statistics, statistics
from icreckon.simulation.study.summary import mean_interval, ratio_interval, summarise
from icreckon.simulation.study.tables import results_parquet, runs_parquet

STUDY = Study(
    name="tiny",
    description="Two <cells> & more.",
    scenario=Scenario(duration=40.0, outages=((5.0, 40.0),)),
    variants=("constant-online", "inertia-online"),
    sweep=Sweep(grid={"gyro.factor": [1.0, 10.0, 100.0], "noise": ["nominal", "tactical"]}),
    runs=12,
    truths=6,
)


def stubbed(study):
    plan = expand(study)
    blocks = [study_stub.block(cell, cell.filters, 0, study.runs) for cell in plan.cells]
    values, reasons = (np.stack(parts, axis=1) for parts in zip(*blocks, strict=True))
    return Runs(plan, values, reasons)


@pytest.fixture(scope="module")
def runs():
    return stubbed(STUDY)


def results_of(runs):
    return study_results(runs, manifest(runs.plan, STREAMING), cell_summaries(runs))


def names_of(study):
    return [kind.name for kind in statistics(study.horizons)]


@pytest.fixture(scope="module")
def results(runs):
    return results_of(runs)


@pytest.mark.parametrize(
    ("horizons", "reported"), [(HORIZONS, 30.0), ((5.0, 30.0, 20.0, 34.0), 34.0)]
)
def test_the_longest_horizon_that_somebody_asks_for_is_reported(horizons, reported):
    results = results_of(stubbed(msgspec.structs.replace(STUDY, horizons=horizons)))
    assert results["drift"] == DRIFT.format(reported)


def test_runs_that_share_their_motion_count_as_one():
    rng = np.random.default_rng(2)
    of_motions = rng.normal(3.0, 1.0, 8)
    # Ten copies of each motion tell no more than one.
    values, motions = np.tile(of_motions, 10), np.tile(np.arange(8), 10)
    once = mean_interval(of_motions, np.arange(8))
    assert mean_interval(values, motions) == pytest.approx(once, rel=1e-12)


def test_intervals_of_positive_statistics_stay_above_zero():
    motions, one = np.arange(4), np.ones(4)
    found = summarise(np.array([0.1, 0.1, 0.2, 2.6]), one, motions)
    assert 0.0 < found.mean_low < found.mean < found.mean_high
    assert 0.0 < found.ratio_low < found.ratio < found.ratio_high
    assert found.difference_low < found.difference < found.difference_high


@pytest.mark.parametrize("runs_of_each", [1, 5])
def test_intervals_hold_the_truth_as_often_as_they_say(runs_of_each):
    rng = np.random.default_rng(3)
    inside, times, motions = 0, 1500, np.tile(np.arange(12), runs_of_each)
    inside_ratio = 0
    for _ in range(times):
        shared = rng.normal(0.0, 0.3, 12)[motions]
        a = 2.0 + shared + rng.normal(0.0, 0.2, len(motions))
        b = 4.0 + shared + rng.normal(0.0, 0.2, len(motions))
        _, low, high = mean_interval(a, motions)
        inside += low < 2.0 < high
        _, low, high = ratio_interval(a, b, motions)
        inside_ratio += low < 0.5 < high
    # Four standard deviations of a share of 95 % over so many times.
    assert inside / times == pytest.approx(0.95, abs=4.0 * np.sqrt(0.05 * 0.95 / times))
    assert inside_ratio / times == pytest.approx(0.95, abs=4.0 * np.sqrt(0.05 * 0.95 / times))


def test_a_summary_is_what_numpy_says():
    rng = np.random.default_rng(4)
    a, b = rng.gamma(2.0, 1.0, 20), rng.gamma(2.0, 1.0, 20)
    a[3], b[7] = np.nan, np.nan
    found = summarise(a, b, np.arange(20))
    both = np.isfinite(a) & np.isfinite(b)
    apart = stats.ttest_rel(a[both], b[both]).confidence_interval(0.95)
    assert (found.n, found.pairs, found.true_motions) == (19, 18, 19)
    assert found.mean == pytest.approx(np.nanmean(a), rel=1e-14)
    assert found.median == np.nanmedian(a)
    assert (found.p05, found.p95) == tuple(np.nanpercentile(a, (5, 95)))
    assert found.difference == pytest.approx((a - b)[both].mean(), rel=1e-12)
    interval = found.difference_low, found.difference_high
    assert interval == pytest.approx((apart.low, apart.high), rel=1e-12)
    assert found.ratio == pytest.approx(a[both].mean() / b[both].mean(), rel=1e-14)


def test_what_no_run_has_is_nan_and_one_motion_has_no_interval():
    nothing = summarise(np.full(4, np.nan), np.ones(4), np.arange(4))
    assert nothing.n == nothing.pairs == 0
    assert np.isnan([nothing.mean, nothing.median, nothing.ratio, nothing.difference]).all()
    one = summarise(np.array([1.0, 2.0]), np.array([0.0, 0.0]), np.zeros(2, int))
    assert one.mean == 1.5
    assert np.isnan([one.mean_low, one.ratio]).all()


def test_the_statistics_of_a_run_are_those_of_the_scores():
    study = msgspec.structs.replace(STUDY, sweep=None, variants=("constant-online",))
    cell = expand(study).cells[0]
    log = study_log(cell, 0)
    result = run(log, cell.filters[0].robot, "constant-online")
    values = run_statistics(result, log, cell.horizons).tolist()
    found = dict(zip(names_of(STUDY), values, strict=True))
    within = without_fixes(log.fixes.stamps, log.start, log.end, 10.0)
    assert len(within) == 1
    segments = drift(result.trajectory.pose_series, log.truth.poses, 10.0, within=within)
    errors = result.trajectory.poses - log.truth.poses.poses
    position, velocities = np.hypot(*errors[:, :2].T), velocity_errors(result.trajectory, log.truth)
    nees = pose_nees(result.trajectory, log.truth.poses)
    expected = {
        "drift_percent_10s": segments.percent_mean,
        "final_position_error_m": position[-1],
        "position_rmse_m": np.sqrt((position**2).mean()),
        "rmse_w_rad_s": np.sqrt((velocities[:, 2] ** 2).mean()),
        "nees_pose_mean": nees.mean(),
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-12)
    assert found["final_yaw_error_rad"] == pytest.approx(abs(errors[-1, 2]), rel=1e-9)
    assert found["nees_pose_end"] == nees[-1]
    assert found["nis_gyro_mean"] == result.health.sensors["gyro"].nis_per_degree
    assert found["rejected_total"] == sum(result.health.rejections().values())
    assert found["yaw_drift_deg_per_m"] > 0.0
    assert np.isnan(found["drift_percent_60s"])
    assert 0.1 < found["nees_velocity_mean"] < 10.0


def test_parquet_has_a_row_for_each_cell_variant_and_statistic(runs):
    from pyarrow import parquet

    found = parquet.read_table(io.BytesIO(results_parquet(runs, cell_summaries(runs)))).to_pylist()
    names = names_of(STUDY)
    assert len(found) == 6 * 2 * len(names)
    keys = [(row["cell"], row["variant"], row["statistic"]) for row in found]
    assert len(set(keys)) == len(keys)
    row = found[keys.index((3, "inertia-online", "drift_percent_30s"))]
    assert row["axis:gyro.factor"] == 10.0
    assert row["axis:noise"] == "tactical"
    column = names.index("drift_percent_30s")
    values, baseline = runs.values[1, 3, :, column], runs.values[0, 3, :, column]
    assert row["n"] == 12
    assert row["true_motions"] == 6
    assert row["mean"] == pytest.approx(values.mean(), rel=1e-14)
    assert row["difference"] == pytest.approx((values - baseline).mean(), rel=1e-9)
    assert row["mean_low"] < row["mean"] < row["mean_high"]
    assert found[keys.index((0, "constant-online", "rejected_gyro"))]["mean"] is None


def test_parquet_has_a_row_for_each_run(runs):
    from pyarrow import parquet

    found = parquet.read_table(io.BytesIO(runs_parquet(runs))).to_pylist()
    assert len(found) == 6 * 2 * 12
    at = ("cell", "variant", "run")
    (row,) = (row for row in found if [row[one] for one in at] == [4, "inertia-online", 7])
    names = names_of(STUDY)
    assert row["true_motion"] == 1
    assert row["nees_pose_mean"] == runs.values[1, 4, 7, names.index("nees_pose_mean")]


def test_results_hold_every_cell_and_the_effect_of_every_axis(runs, results):
    told = json.loads(as_json(results))
    assert [cell["values"] for cell in told["cells"]] == [cell.values for cell in runs.plan.cells]
    factor, noise = told["effects"]
    assert [group["cells"] for group in factor["groups"]] == [[0, 1], [2, 3], [4, 5]]
    assert [group["cells"] for group in noise["groups"]] == [[0, 2, 4], [1, 3, 5]]
    names = names_of(STUDY)
    column = names.index("drift_percent_30s")
    mean = noise["groups"][1]["variants"]["inertia-online"]["drift_percent_30s"]["mean"]
    assert mean == pytest.approx(runs.values[1, [1, 3, 5], :, column].mean(), rel=1e-12)
    drifts = runs.values[1, :, :, column]
    ratio = noise["groups"][1]["to_first"]["inertia-online"]
    assert ratio["ratio"] == pytest.approx(drifts[[1, 3, 5]].mean() / drifts[[0, 2, 4]].mean())
    assert ratio["ratio_low"] < ratio["ratio"] < ratio["ratio_high"]
    assert noise["groups"][0]["to_first"]["inertia-online"]["ratio"] == 1.0
    assert told["baseline"] == "constant-online"
    assert told["cells"][0]["variants"]["constant-online"]["rejected_gyro"]["mean"] is None


def test_notes_compare_the_values_of_each_axis_with_its_first(results):
    changed = json.loads(as_json(results))
    _, noise = changed["effects"]
    first, second = (group["name"] for group in noise["groups"])
    for found in noise["groups"][1]["to_first"].values():
        found |= {"ratio": 0.5, "ratio_low": 0.4, "ratio_high": 0.6}
    expected = f"compared with {first}: 50 % less at {second} (95 %: 40 to 60 % less)."
    assert sum(expected in line for line in notes(changed)) == 1


def test_cells_of_a_latin_hypercube_are_grouped_with_their_neighbours():
    latin = LatinHypercube(points=12, ranges={"gyro.factor": [1.0, 100.0, "log"]})
    plan = expand(msgspec.structs.replace(STUDY, sweep=Sweep(latin=latin)))
    groups = groups_of(plan, plan.axes[0])
    assert [len(group["cells"]) for group in groups] == [3, 3, 2, 2, 2]
    assert sorted(cell for group in groups for cell in group["cells"]) == list(range(12))
    values = [
        [plan.cells[cell].values["gyro.factor"] for cell in group["cells"]] for group in groups
    ]
    tops = list(map(max, values))
    assert tops == sorted(tops)


@pytest.fixture(scope="module")
def figures(results):
    return study_figures(results)


def test_the_page_holds_all_it_needs(results, figures):
    page = study_page(results, figures)
    links = re.findall(r'\b(?:src|href)="([^"]*)"', page)
    assert len(links) == len(figures) == 9
    assert all(link.startswith("data:image/png;base64,") for link in links)
    assert not re.search(r"https?:|url\(|@import|<script|<link", page)
    text = html.unescape(re.sub(r"<[^>]*>", " ", page))
    assert "Two <cells> & more." in text
    assert headline(results) in text
    for table in summary_tables(results):
        for row in table.rows:
            assert all(cell in text for cell in row)
    assert '"duration": 40.0' in text


def test_the_headline_is_that_of_a_typical_cell(results):
    """Each cell has one voice, and where a variant wins and loses is named."""
    changed = copy.deepcopy(results)
    drift, baseline = changed["drift"], changed["baseline"]
    other = next(name for name in changed["variants"] if name != baseline)
    typical = changed["typical"][other]
    typical |= {"ratio": 0.9, "ratio_low": 0.7, "ratio_high": 1.1}
    told = f"{other} drifts 10 % less than {baseline} (95 %: 30 % less to 10 % more; not"
    assert told in headline(changed)
    typical |= {"ratio": 0.6, "ratio_low": 0.5, "ratio_high": 0.7}
    for cell, ratio in zip(changed["cells"], (0.13, 1.5), strict=False):
        found = cell["variants"][other][drift]
        found |= {"ratio": ratio, "ratio_low": ratio - 0.1, "ratio_high": ratio + 0.1}
    for cell in changed["cells"][2:]:
        cell["variants"][other][drift]["ratio"] = float("nan")
    typical |= {"end_ratio": 1.4, "end_ratio_low": 1.2, "end_ratio_high": 1.6}
    text = headline(changed)
    assert f"{other} drifts 40 % less than {baseline} (95 %: 30 to 50 % less)" in text
    assert "significantly less in 1 and more in 1 of 2 cells: 87 % less at" in text
    assert ", 50 % more at " in text
    assert "Its error at the end is 40 % more (95 %: 20 to 60 % more)." in text


def test_a_cell_of_large_drift_does_not_decide(runs):
    """A filter is better in all cells but one of 30 %, in which it is worse."""
    plan = runs.plan
    cells = len(plan.cells)
    values = np.full((2, cells, plan.study.runs, len(statistics(plan.study.horizons))), 1.0)
    values[1] = 0.5
    values[0, -1], values[1, -1] = 30.0, 36.0
    made = Runs(plan, values, np.full(values.shape[:3], "", dtype=object))
    typical = results_of(made)["typical"]
    expected = (0.5 ** (cells - 1) * 1.2) ** (1.0 / cells)
    label = plan.labels[1]
    assert typical[label]["ratio"] == pytest.approx(expected)
    assert typical[label]["end_ratio"] == pytest.approx(expected)
    assert typical[plan.labels[0]]["ratio"] == 1.0


@pytest.mark.parametrize(
    ("grid", "knows", "noise_is_named"),
    [
        ({"noise": ["consumer", "tactical"]}, False, True),
        ({"encoders.resolution": [0.001, 0.005]}, False, False),
        ({"noise": ["consumer", "tactical"]}, True, False),
    ],
)
def test_a_large_nees_is_explained_where_it_stands(results, grid, knows, noise_is_named):
    changed = copy.deepcopy(results)
    changed["configuration"] = {"sweep": {"grid": grid}, "filters_know_noise": knows}
    name = changed["variants"][0]
    changed["cells"][0]["variants"][name]["nees_pose_end"] |= {"mean": 125.0}
    table = summary_tables(changed)[0]
    assert any(cell.startswith("125") and cell.endswith(" *") for row in table.rows for cell in row)
    (note,) = [line for line in notes(changed) if line.startswith("*")]
    assert "Slopes" in note
    assert ("whatever noise is" in note) == ("filters_know_noise" in note) == noise_is_named


def test_a_grid_has_the_drift_of_each_cell(results, monkeypatch):
    drawn = {}
    monkeypatch.setattr(study_drawings, "png", lambda figure, *_: drawn.update(of=figure) or b"")
    study_drawings._draw_drift_grid(results)
    panels = {one.get_title(): one for one in drawn["of"].axes if one.get_title()}
    assert list(panels) == results["variants"]
    rows, columns = ([one["name"] for one in axis["groups"]] for axis in results["effects"])
    for label, panel in panels.items():
        found = {(one.get_position()[::-1]): one.get_text() for one in panel.texts}
        for cell in results["cells"]:
            factor, noise = (str(value) for value in cell["values"].values())
            place = [str(float(one)) for one in rows].index(factor), columns.index(noise)
            mean = cell["variants"][label][results["drift"]]["mean"]
            assert found[place] == f"{mean:#.3g}".rstrip(".")


@pytest.mark.parametrize(
    ("changes", "known"),
    [
        ({"sweep": None}, False),
        ({"sweep": None, "runs": 1}, True),
        ({"sweep": Sweep(latin=LatinHypercube(points=30, ranges={"fix_rate": [1.0, 2.0]}))}, True),
        ({"sweep": Sweep(grid={"fix_rate": [float(n) for n in range(1, 30)]})}, True),
    ],
    ids=["one cell", "one run", "latin", "many cells"],
)
def test_every_shape_of_study_has_tables_figures_and_a_page(changes, known, monkeypatch):
    if known:
        # Drawing is for those of which nothing is known.
        monkeypatch.setattr("matplotlib.figure.Figure.savefig", blank)
    runs = stubbed(msgspec.structs.replace(STUDY, **changes))
    if not known:
        runs.values[:] = np.nan
    results = results_of(runs)
    study_page(results, study_figures(results))
    assert results_parquet(runs, cell_summaries(runs))
    again = json.loads(as_json(results))
    assert headline(again) == headline(results)
    assert summary_tables(again) == summary_tables(results)


def test_the_page_has_the_robot_and_what_is_wrong_with_its_file(tmp_path) -> None:
    robot = tmp_path / "mine.toml"
    sizes = "mass = 123.0\ntrack_gauge = 0.6\nsprocket_radius = 0.1\n"
    robot.write_text(f'name = "mine"\n[vehicle]\n{sizes}', encoding="utf-8")
    cases = {"payload": {"no load": {}, "load": {"gyro.factor": 2.0}}}
    study = msgspec.structs.replace(STUDY, robot=str(robot), sweep=Sweep(cases=cases))
    results = results_of(stubbed(study))
    assert results["robot"]["vehicle"]["mass"] == 123.0
    assert any("set eta0 = " in remark for remark in results["remarks"])
    page = study_page(results, [])
    for text in (*results["remarks"], '"mass": 123.0', '"no load": {}'):
        assert text in html.unescape(page)


def test_variants_and_cells_of_the_same_results_are_named() -> None:
    runs = stubbed(STUDY)
    runs.values[1] = runs.values[0]
    runs.values[:, 3] = runs.values[:, 0]
    results = results_of(runs)
    variants, cells = [["constant-online", "inertia-online"]], [[0, 3]]
    assert results["alike"] == {"variants": variants, "cells": cells}
    first, second = same_results(results)
    assert first.startswith("constant-online and inertia-online gave the same results to rounding")
    assert second.startswith(
        "cell 0 (gyro.factor = 1, noise = nominal) and cell 3 (gyro.factor = 10, noise = tactical) gave"
    )
    page = study_page(results, [])
    assert page.index(first) < page.index(second) < page.index('class="headline"')
