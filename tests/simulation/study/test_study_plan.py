"""What a study file may say, what it comes to, and what is refused."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from icreckon import FixSpec, FixWander, IcreckonError, Study, Sweep, Terrain, load_robot, simulate
from icreckon.report.study.folder import PAGE
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.running.engines import choose_engine
from icreckon.simulation.running.run_study import RESULTS_PARQUET, RUNS_PARQUET
from icreckon.simulation.running.store import MANIFEST, RESULTS
from icreckon.simulation.running.streaming_engine import block, study_log
from icreckon.simulation.scenario import Scenario, change_scenario
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import FilterSpec, LatinHypercube, load_study, study_names
from icreckon.simulation.study.statistics import statistics
from icreckon.simulation.study.summary import COLUMNS
from readme import ROOT, code_blocks

SHORT = Scenario(duration=10.0)
NOISE = {"noise": ["nominal"]}
MILLION = {"fix_rate": list(range(1000)), "duration": [1.0 + 1e-3 * n for n in range(1000)]}


def expanded(**more):
    return expand(Study(**{"name": "a", "scenario": SHORT, "variants": ("differential",)} | more))


def swept(*, filters_know_noise=False, **grid):
    return expanded(sweep=Sweep(grid=grid), filters_know_noise=filters_know_noise)


def test_a_grid_has_a_cell_for_each_combination_the_last_key_changing_fastest():
    plan = swept(fix_rate=[0.0, 1.0], gyro={"factor": [1.0, 2.0, 40.0]})
    assert [axis.name for axis in plan.axes] == ["fix_rate", "gyro.factor"]
    assert [axis.scale for axis in plan.axes] == ["linear", "log"]
    values = [tuple(cell.values.values()) for cell in plan.cells]
    assert values == [(a, b) for a in (0.0, 1.0) for b in (1.0, 2.0, 40.0)]
    assert [cell.scenario.gyro.factor for cell in plan.cells] == [1.0, 2.0, 40.0] * 2
    assert {cell.scenario.seed for cell in plan.cells} == {1}


def test_cases_change_several_keys_at_once():
    plan = expanded(
        sweep=Sweep(
            cases={
                "way": {
                    "easy": {"trajectory": "arcs", "trajectory_options": {"speed": 0.3}},
                    "hard": {"trajectory": "aggressive", "filter.vehicle.mass": 200.0},
                }
            }
        )
    )
    easy, hard = plan.cells
    assert plan.axes[0].scale == "names"
    assert easy.scenario.trajectory_options == {"speed": 0.3}
    assert hard.scenario.trajectory == "aggressive"
    assert hard.filters[0].robot.vehicle.mass == 200.0
    assert hard.robot.vehicle.mass == 258.0


def test_who_knows_of_a_changed_robot():
    plan = swept(**{"robot.vehicle.mass": [300.0]})
    assert plan.cells[0].robot.vehicle.mass == plan.cells[0].filters[0].robot.vehicle.mass == 300.0
    plan = swept(**{"true_robot.vehicle.mass": [300.0]})
    assert plan.cells[0].robot.vehicle.mass == 300.0
    assert plan.cells[0].filters[0].robot == load_robot("auriga-alpha")
    plan = expanded(
        robot_changes={"vehicle": {"mass": 270.0}},
        variants=(
            "differential",
            FilterSpec(variant="differential", label="b", robot={"vehicle.mass": 1.0}),
        ),
    )
    told = [one.robot.vehicle.mass for one in plan.cells[0].filters]
    assert (plan.cells[0].robot.vehicle.mass, told) == (270.0, [270.0, 1.0])


def test_an_outage_is_at_the_end():
    plan = swept(outage=[0.0, 4.0])
    assert [cell.scenario.outages for cell in plan.cells] == [(), ((6.0, 10.0),)]


def test_a_latin_hypercube_has_one_point_in_each_layer_of_each_range():
    latin = LatinHypercube(
        points=16, ranges={"gyro": {"noise_density": [1e-5, 1e-3, "log"]}, "fix_rate": [0.5, 2.5]}
    )
    plan = expanded(sweep=Sweep(latin=latin), seed=3)
    again = expanded(sweep=Sweep(latin=latin), seed=3)
    other = expanded(sweep=Sweep(latin=latin), seed=4)
    assert [cell.values for cell in plan.cells] == [cell.values for cell in again.cells]
    assert [cell.values for cell in plan.cells] != [cell.values for cell in other.cells]
    densities = np.array([cell.scenario.gyro.noise_density for cell in plan.cells])
    rates = np.array([cell.scenario.fix_rate for cell in plan.cells])
    layers = np.floor(16.0 * np.log(densities / 1e-5) / np.log(100.0))
    assert sorted(layers) == list(range(16))
    assert sorted(np.floor(16.0 * (rates - 0.5) / 2.0)) == list(range(16))
    assert [axis.scale for axis in plan.axes] == ["log", "linear"]
    assert all(axis.sampled for axis in plan.axes)


def test_there_are_twenty_true_motions_unless_told():
    assert expanded(runs=5).cells[0].truths == 20
    assert expanded(runs=500).cells[0].truths == 20
    assert expanded(runs=500, truths=50).cells[0].truths == 50


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"runs": 0}, "runs must be a whole number from 1 to 10,000,000 .*, found 0"),
        ({"name": "../a"}, "name of a study must be of letters"),
        ({"variants": ()}, "needs variants"),
        ({"variants": ("inrtia-online",)}, "did you mean 'inertia-online'"),
        ({"baseline": "differental"}, "did you mean 'differential'"),
        ({"horizons": (10.0, 10.0)}, "each once"),
        ({"scenario": Scenario(seed=4)}, "no seed of its own"),
        ({"scenario": Scenario(include_truth=False)}, "leave out include_truth"),
        ({"robot_changes": {"vehicle": {"mas": 1.0}}}, "did you mean 'mass'"),
        ({"sweep": {}}, "nothing is swept"),
        ({"sweep": {"grid": {"fix_rate": []}}}, "needs a list of values"),
        ({"sweep": {"grid": {"fix_rate": [1.0, 1.0]}}}, "a value twice"),
        ({"sweep": {"grid": {"fix_rat": [1.0]}}}, "did you mean 'fix_rate'"),
        ({"sweep": {"grid": {"filter.vehicle.mas": [1.0]}}}, "did you mean 'mass'"),
        ({"sweep": {"grid": {"outage": [11.0]}}}, "from 0 to the duration"),
        ({"sweep": {"grid": NOISE, "cases": {"a": {"x": {"noise": "nominal"}}}}}, "twice"),
        ({"sweep": {"latin": {"points": 3, "ranges": {"fix_rate": [2.0, 1.0]}}}}, "is larger"),
        ({"sweep": {"latin": {"points": 3, "ranges": {"fix_rate": [1, 2, "lag"]}}}}, "'log'"),
        ({"sweep": {"grid": MILLION}}, "more than 100000"),
        ({"sweep": {"grid": {"outage": [5.0], "outages": [[[0.0, 4.0]]]}}}, "exclude each other"),
    ],
)
def test_what_a_study_may_not_say(wrong, told):
    with pytest.raises(IcreckonError, match=told):
        expanded(**wrong)


def test_a_file_is_read_with_paths_beside_it(tmp_path):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\n[vehicle]\nmass = 80.0\ntrack_gauge = 0.6\nsprocket_radius = 0.1\n'
        "[indices]\neta0 = 1.5\n",
        encoding="utf-8",
    )
    (tmp_path / "drive.csv").write_text("t,left,right\n0,0,0\n1,0.2,0.2\n9,0.2,0.3\n", "utf-8")
    file = tmp_path / "first.toml"
    file.write_text(
        'robot = "mine.toml"\nvariants = ["differential"]\n[scenario]\nduration = 12.0\n'
        'trajectory = "recorded"\ntrajectory_file = "drive.csv"\n[sweep.grid]\ngyro.factor = [1, 2]\n',
        encoding="utf-8",
    )
    study = load_study(file)
    assert study.name == "first"
    plan = expand(study)
    assert plan.cells[1].robot.vehicle.mass == 80.0
    assert len(study_log(plan.cells[0], 0).tracks.stamps) == 601


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("run = 3", "unknown key 'run'; did you mean 'runs'"),
        ("[scenario]\ndurration = 3", r"in \[scenario\]; did you mean 'duration'"),
        ('[[variants]]\nvariant = "differential"\nsettings = {hld = 1.0}', "did you mean 'hold'"),
    ],
)
def test_a_file_that_is_wrong_is_refused_in_one_line(tmp_path, text, told):
    file = tmp_path / "wrong.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(SimulationError, match=told):
        load_study(file)


def test_a_study_that_is_not_there_is_refused_with_the_nearest():
    with pytest.raises(SimulationError, match="did you mean 'imu-grades'"):
        load_study("imu-grade")
    with pytest.raises(SimulationError, match="no such file"):
        load_study("nowhere.toml")


def test_the_first_runs_are_those_of_simulate_and_later_ones_share_their_motion():
    study = Study(name="a", scenario=SHORT, seed=5, runs=6, truths=2, variants=("differential",))
    cell = expand(study).cells[0]

    def values(log):
        one, other = log.tracks, log.truth
        yield from (one.stamps, one.speeds, other.twists.stamps, other.poses.poses)
        yield from (log.imu.angular_velocity, log.imu.linear_acceleration, log.fixes.poses)

    for run in (0, 1):
        made, log = simulate(cell.scenario, cell.robot, run_index=run), study_log(cell, run)
        assert made.name == log.name
        for a, b in zip(values(made), values(log), strict=True):
            assert np.array_equal(a, b, equal_nan=True)
    first, third = study_log(cell, 0), study_log(cell, 2)
    assert np.array_equal(first.truth.poses.poses, third.truth.poses.poses)
    assert not np.array_equal(first.tracks.speeds[200:], third.tracks.speeds[200:])


@pytest.mark.parametrize("name", study_names())
def test_shipped_studies_load_and_their_first_block_runs(name):
    study = load_study(name)
    assert study.name == name
    assert len(study.description) > 40
    plan = expand(study)
    cell = plan.cells[0]
    short = change_scenario(cell.scenario, {"duration": 12.0, "outages": [[5.0, 12.0]]}, "test")
    found = block(replace(cell, scenario=short, horizons=(5.0,)), cell.filters, 0, 1)
    names = [one.name for one in statistics((5.0,))]
    assert found.values.shape == (len(plan.labels), 1, len(names))
    for values, reasons in zip(*found, strict=True):
        assert reasons.tolist() == [""]
        known = dict(zip(names, np.isfinite(values[0]).tolist(), strict=True))
        assert [key for key, is_known in known.items() if not is_known] == ["yaw_drift_deg_per_m"]


def test_the_study_file_in_the_docs_loads_and_shows_every_key(tmp_path):
    (text,) = code_blocks("toml", "docs/reference/study-file.md")
    file = tmp_path / "study.toml"
    file.write_text(text, encoding="utf-8")
    plan = expand(load_study(file))
    assert len(plan.cells) == 72
    assert plan.labels == ("constant-online", "inertia-online", "heavy")
    for field in msgspec.structs.fields(Study):
        assert re.search(rf"^(\[)?{field.name}( = |\]|\.)", text, re.MULTILINE), field.name


def test_the_docs_tell_every_file_column_statistic_and_study():
    page = (ROOT / "docs" / "reference" / "study-file.md").read_text(encoding="utf-8")
    names = [one.name for one in statistics((10.0,))]
    for name in (*names, *study_names(), RESULTS_PARQUET, RUNS_PARQUET, PAGE, RESULTS, MANIFEST):
        assert f"`{name}`" in page, name
    for column in COLUMNS:
        stem = column.removesuffix("_low").removesuffix("_high")
        assert f"`{stem}`" in page, column


def test_filters_are_given_the_wander_of_the_fixes_unless_they_name_another():
    gps = Scenario(duration=10.0, fix_rate=1.0, fixes=FixSpec(wander_sigma=1.2, wander_time=60.0))
    white = FilterSpec(variant="gyro", label="white", settings={"wander": {}})
    plan = expanded(scenario=gps, variants=("gyro", white))
    aware, unaware = plan.cells[0].filters
    assert aware.settings.wander == FixWander(1.2, 60.0)
    assert unaware.settings.wander == FixWander()
    assert choose_engine(plan).name == "batch"
    # That of a robot file is about its logs.
    of_file = {"fixes": {"topic": "/fix", "wander_sigma": 3.0, "wander_time": 9.0}}
    robot = {"log": of_file}
    plan = expanded(variants=(FilterSpec(variant="gyro", robot=robot), "differential"))
    assert plan.cells[0].filters[0].settings.wander == FixWander()
    assert plan.cells[0].filters[1].settings.wander is None
    found = block(expanded(scenario=gps, variants=("gyro",)).cells[0], [aware], 0, 1)
    assert found.reasons.tolist() == [[""]]


def test_terrain_without_what_it_belongs_to_is_refused_unless_that_is_swept() -> None:
    waves = Scenario(terrain=Terrain(wavelength=5.0))
    with pytest.raises(SimulationError, match=r"scenario: \[terrain\] wavelength has no effect"):
        expand(Study(name="a", scenario=waves))
    rolling = Sweep(grid={"terrain.rolling_deg": [1.0, 3.0]})
    assert len(expand(Study(name="a", scenario=waves, sweep=rolling)).cells) == 2


def test_a_switch_gives_filters_the_noise_that_is_swept() -> None:
    """Without it they have that of the robot file; keys of `filter` win in either case."""
    grid = {"noise": ["consumer", "tactical"], "encoders.scale_difference_sigma": [0.03]}
    of_file = load_robot("auriga-alpha")
    for knows in (False, True):
        cells = swept(filters_know_noise=knows, **grid).cells
        sigmas = [cell.filters[0].robot.imu.gyro_bias_sigma for cell in cells]
        assert sigmas == ([1.7e-2, 5e-5] if knows else [of_file.imu.gyro_bias_sigma] * 2)
        tracks = cells[0].filters[0].robot.tracks
        assert tracks.difference_sigma == (0.03 if knows else of_file.tracks.difference_sigma)
    grid = {"noise": ["consumer"], "filter.imu.gyro_bias_sigma": [0.1]}
    imu = swept(filters_know_noise=True, **grid).cells[0].filters[0].robot.imu
    assert (imu.gyro_bias_sigma, imu.gyro_noise_density) == (0.1, 1.7e-4)
