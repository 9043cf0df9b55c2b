"""Variants side by side: here, in processes, or on any executor, with the same result."""

from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from estimator.errors import EstimatorError
from estimator.robot import Robot
from replay.comparison import Comparison, compare
from simulation.scenario import Scenario, simulate

VARIANTS = ["constant-fixed", "inertia-online"]


class PicklingExecutor(Executor):
    """Sends each task and its result through pickle, as an executor on other machines does."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:  # type: ignore[override]
        import pickle

        future: Future[Any] = Future()
        task, arguments = pickle.loads(pickle.dumps((fn, args)))  # noqa: S301
        future.set_result(pickle.loads(pickle.dumps(task(*arguments, **kwargs))))  # noqa: S301
        return future


def same(a: Comparison, b: Comparison) -> None:
    assert list(a.runs) == list(b.runs)
    for name, run in a.runs.items():
        np.testing.assert_array_equal(run.states, b.runs[name].states)
        np.testing.assert_array_equal(run.stamps, b.runs[name].stamps)


def test_where_the_variants_run_does_not_matter(robot: Robot) -> None:
    log = simulate(Scenario(duration=15.0, seed=4), robot)
    here = compare(log, robot, VARIANTS)
    assert list(here.runs) == VARIANTS
    same(here, compare(log, robot, VARIANTS, workers=2))
    with ThreadPoolExecutor(2) as threads:
        same(here, compare(log, robot, VARIANTS, executor=threads))
    told: list[float] = []
    same(here, compare(log, robot, VARIANTS, executor=PicklingExecutor(), progress=told.append))
    assert told == [0.5, 1.0]


def test_an_unknown_variant_is_refused_before_anything_runs(robot: Robot) -> None:
    log = simulate(Scenario(duration=5.0), robot)
    with pytest.raises(EstimatorError, match="did you mean 'inertia-online'"):
        compare(log, robot, ["inertia-onlin"])
