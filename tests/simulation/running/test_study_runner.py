"""A study comes to the same, bit by bit, however it is worked out and whatever interrupts it."""

import json
import shutil
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor

import msgspec
import numpy as np
import pytest

import study_stub
from icreckon import SimulationError, run_study
from icreckon.simulation.running import engines
from icreckon.simulation.running.store import jobs_of
from icreckon.simulation.study.cells import expand
from study_stub import STUDY, contents, install

REAL = msgspec.structs.replace(STUDY, runs=4, truths=2)


@pytest.fixture(autouse=True)
def _stub(monkeypatch):
    install(monkeypatch)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """The folder of a study that nothing has interrupted."""
    folder = tmp_path_factory.mktemp("kept") / "undisturbed"
    with pytest.MonkeyPatch.context() as patch:
        install(patch)
        run_study(STUDY, folder, workers=1)
    return folder


@pytest.fixture
def undisturbed(tmp_path, kept):
    """What is in such a folder, of which a copy is in tmp_path / "undisturbed"."""
    shutil.copytree(kept, tmp_path / "undisturbed")
    return contents(kept)


class Failing(ThreadPoolExecutor):
    """Some blocks are worked out, and then something happens."""

    def __init__(self, good, problem):
        super().__init__(1)
        self._good, self._problem = good, problem

    def submit(self, *work):
        if self._good == 0:
            raise self._problem
        self._good -= 1
        return super().submit(*work)


def test_blocks_cover_all_runs_once_whoever_works():
    plan = expand(STUDY)
    jobs = jobs_of(plan, 4)
    assert [job.count for job in jobs] == [4, 4, 4, 4, 2, 2]
    covered = sorted(
        (job.cell, run) for job in jobs for run in range(job.first_run, job.first_run + job.count)
    )
    assert covered == [(cell, run) for cell in range(2) for run in range(10)]


def test_it_leaves_what_it_promises(undisturbed):
    assert set(undisturbed) == {
        "manifest.json",
        "results.json",
        "results.parquet",
        "runs.parquet",
        "page.html",
        "consistency.png",
        "drift-gyro-factor.png",
        "final-error-gyro-factor.png",
        "ratio-gyro-factor.png",
        "final-error-distribution.png",
    }
    manifest = json.loads(undisturbed["manifest.json"])
    assert manifest["configuration"]["scenario"]["duration"] == 10.0
    assert manifest["seeds"]["study"] == 1
    assert {"icreckon", "numpy", "scipy", "numba", "pyarrow"} <= set(manifest["versions"])
    assert manifest["cells"] == [{"gyro.factor": 1.0}, {"gyro.factor": 10.0}]


@pytest.mark.parametrize("workers", [2, 7])
def test_any_number_of_threads_comes_to_the_same(tmp_path, undisturbed, workers):
    run_study(STUDY, tmp_path / "b", workers=workers)
    assert contents(tmp_path / "b") == undisturbed


@pytest.mark.thorough
def test_the_filter_comes_to_the_same_in_one_or_two_threads_and_in_processes(tmp_path, monkeypatch):
    monkeypatch.setattr(engines, "ENGINES", [engines.STREAMING])
    for workers in (1, 2):
        with ThreadPoolExecutor(workers) as threads:
            run_study(REAL, tmp_path / f"{workers}", executor=threads, workers=workers)
    run_study(REAL, tmp_path / "processes", workers=2)
    expected = contents(tmp_path / "1")
    assert contents(tmp_path / "2") == expected
    assert contents(tmp_path / "processes") == expected
    results = json.loads(expected["results.json"])
    assert results["drift"] == "drift_percent_5s"
    assert results["overall"]["inertia-online"]["drift_percent_5s"]["n"] == 4


@pytest.mark.parametrize("good", [0, 4])
def test_after_an_interruption_it_goes_on_where_it_stopped(tmp_path, undisturbed, good):
    with pytest.raises(KeyboardInterrupt), Failing(good, KeyboardInterrupt()) as executor:
        run_study(STUDY, tmp_path / "a", executor=executor, workers=1)
    assert "results.json" not in contents(tmp_path / "a")
    told = []
    run_study(STUDY, tmp_path / "a", workers=2, report=told.append)
    assert contents(tmp_path / "a") == undisturbed
    # What was handed out but not yet taken back may be lost.
    assert max(0, good - 2) <= told[0].found_blocks <= good
    assert told[-1].blocks == told[-1].all_blocks == 6
    assert told[0].runs_left == told[-1].runs
    assert told[-1].runs_left == 0


def test_a_finished_study_is_not_worked_out_again(tmp_path, undisturbed):
    folder = tmp_path / "undisturbed"
    told = []
    run_study(STUDY, folder, executor=Failing(0, AssertionError()), report=told.append)
    assert told[0].found_blocks == told[0].all_blocks
    assert contents(folder) == undisturbed


@pytest.mark.parametrize("damage", ["cut", "turned", "other", "shape", "flat"])
def test_a_damaged_block_is_worked_out_again(tmp_path, undisturbed, damage):
    folder = tmp_path / "undisturbed"
    block = sorted((folder / "blocks").iterdir())[1]
    whole = block.read_bytes()
    if damage == "cut":
        block.write_bytes(whole[: len(whole) // 2])
    elif damage == "turned":
        middle = len(whole) // 3
        block.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    else:
        with np.load(block) as data:
            changed = {
                "other": {"digest": np.array("sha256:other")},
                "shape": {"values": data["values"][:, :1]},
                "flat": {"values": data["values"].ravel()},
            }[damage]
            np.savez(block, **{**data, **changed})
    told = []
    run_study(STUDY, folder, workers=1, report=told.append)
    assert told[0].found_blocks == 5
    assert contents(folder) == undisturbed


@pytest.mark.usefixtures("undisturbed")
def test_more_runs_are_added_to_those_that_are_there(tmp_path):
    more = msgspec.structs.replace(STUDY, runs=16)
    told = []
    run_study(more, tmp_path / "undisturbed", workers=1, report=told.append)
    run_study(more, tmp_path / "fresh", workers=1)
    # The blocks that were not full are worked out anew.
    assert told[0].found_blocks == 4
    assert contents(tmp_path / "undisturbed") == contents(tmp_path / "fresh")


@pytest.mark.usefixtures("undisturbed")
def test_fewer_runs_are_the_first_of_those_that_are_there(tmp_path, undisturbed):
    fewer = msgspec.structs.replace(STUDY, runs=3)
    run_study(fewer, tmp_path / "undisturbed", executor=Failing(0, AssertionError()))
    run_study(fewer, tmp_path / "fresh", workers=1)
    assert (
        contents(tmp_path / "undisturbed")["runs.parquet"]
        == contents(tmp_path / "fresh")["runs.parquet"]
    )
    # All runs are still there.
    run_study(STUDY, tmp_path / "undisturbed", executor=Failing(0, AssertionError()))
    assert contents(tmp_path / "undisturbed") == undisturbed


def test_a_pilot_with_few_runs_can_be_extended(tmp_path):
    pilot = msgspec.structs.replace(STUDY, runs=2, truths=20)
    run_study(pilot, tmp_path / "a", workers=1)
    run_study(msgspec.structs.replace(pilot, runs=6), tmp_path / "a", workers=1)


@pytest.mark.usefixtures("undisturbed")
def test_a_damaged_manifest_is_named(tmp_path):
    (tmp_path / "undisturbed" / "manifest.json").write_text("{", encoding="utf-8")
    with pytest.raises(SimulationError, match="holds a damaged manifest"):
        run_study(STUDY, tmp_path / "undisturbed")


def test_another_study_in_the_folder_is_refused_unless_it_may_be_thrown_away(tmp_path, undisturbed):
    folder = tmp_path / "undisturbed"
    other = msgspec.structs.replace(STUDY, seed=2)
    with pytest.raises(SimulationError, match=r"configuration\.seed: there 1, here 2.*--overwrite"):
        run_study(other, folder)
    assert contents(folder) == undisturbed
    own, elsewhere = folder / "photo.png", tmp_path / "elsewhere.json"
    for path in (own, elsewhere):
        path.write_text("of the user", encoding="utf-8")
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    manifest["files"] += ["../elsewhere.json", 3]
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    told = []
    run_study(other, folder, workers=1, overwrite=True, report=told.append)
    assert told[0].found_blocks == 0
    assert own.exists()
    assert elsewhere.exists()
    # The same command again, with the same options, goes on.
    run_study(other, folder, executor=Failing(0, AssertionError()), overwrite=True)


def test_a_changed_robot_file_makes_another_study(tmp_path):
    robot = tmp_path / "mine.toml"
    text = 'name = "mine"\n[vehicle]\nmass = 80.0\ntrack_gauge = 0.6\nsprocket_radius = 0.1\n'
    robot.write_text(text, encoding="utf-8")
    study = msgspec.structs.replace(STUDY, robot=str(robot), variants=("differential",))
    run_study(study, tmp_path / "a", workers=1)
    robot.write_text(text.replace("80.0", "81.0"), encoding="utf-8")
    with pytest.raises(SimulationError, match=r"robot\.vehicle\.mass: there 80\.0, here 81\.0"):
        run_study(study, tmp_path / "a", workers=1)


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_is_no_study_is_left_alone(tmp_path, overwrite):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "thesis.txt").write_text("all of it", encoding="utf-8")
    with pytest.raises(SimulationError, match="holds no study"):
        run_study(STUDY, tmp_path / "a", overwrite=overwrite)
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["thesis.txt"]
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(SimulationError, match=r"file"):
        run_study(STUDY, tmp_path / "file", overwrite=overwrite)


def test_after_a_worker_has_died_the_same_command_goes_on(tmp_path, undisturbed, monkeypatch):
    deadly = tmp_path / "deadly"
    deadly.touch()
    monkeypatch.setenv(study_stub.DEADLY, str(deadly))
    install(monkeypatch, threads=False)
    with pytest.raises(SimulationError, match="a worker died"):
        run_study(STUDY, tmp_path / "a", workers=2)
    assert not deadly.exists()
    run_study(STUDY, tmp_path / "a", workers=2)
    name = "results.parquet"
    assert contents(tmp_path / "a")[name] == undisturbed[name]


@pytest.mark.parametrize("error", [BrokenExecutor("gone"), CancelledError("gone")])
def test_an_executor_whose_workers_die_ends_the_study(tmp_path, error):
    class Dying(ThreadPoolExecutor):
        def submit(self, *_work):
            future = Future()
            future.set_exception(error)
            return future

    with pytest.raises(SimulationError, match=r"a worker died .*gone; finished blocks are kept"):
        run_study(STUDY, tmp_path / "a", executor=Dying(1), workers=1)
