"""A study on a `dask.distributed` cluster: a worker is killed, and the result is the same."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor

import msgspec
import pytest

import study_stub
from icreckon.report.study.folder import run_study

distributed = pytest.importorskip("distributed", reason="needs the extra cluster")

STUDY = msgspec.structs.replace(
    study_stub.STUDY, runs=12, truths=4, horizons=(4.0,), engine="streaming"
)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_cluster_that_loses_a_worker_comes_to_the_same(tmp_path):
    with ThreadPoolExecutor(1) as executor:
        run_study(STUDY, tmp_path / "here", executor=executor, workers=1)
    killed = []
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        workers = [worker.pid for worker in cluster.workers.values()]

        def kill_one(progress):
            if progress.runs and not killed:
                os.kill(workers[0], signal.SIGKILL)
                killed.append(workers[0])

        run_study(STUDY, tmp_path / "there", cluster=cluster.scheduler_address, report=kill_one)
        assert killed
        assert len(set(workers)) == 2
    there, here = (study_stub.contents(tmp_path / name) for name in ("there", "here"))
    assert there == here
