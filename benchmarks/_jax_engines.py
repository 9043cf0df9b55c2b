"""The step of the filter by JAX and dynamax."""

from __future__ import annotations

import os
import time
from typing import Any

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

import jax
import jax.numpy as jnp
import numpy as np
from _graph import step_function
from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_filter
from jax import lax

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.step import StepKind, step_kernel

jax.config.update("jax_enable_x64", True)
RUNS, STEPS, REPEAT = 256, 50, 3


def measure(
    filters: BatchFilter, begun: Floats, inputs: Floats, constants: Floats
) -> list[tuple[str, float]]:
    """Name -> CPU seconds of a step of one filter.

    Args:
        filters: of our own.
        begun: (rows, width) their workspace.
        inputs: (n, rows, width) what the next steps are told.
        constants: what all share.
    """
    return [
        *(
            (f"JAX, dense, vmap and scan over {runs} runs, the algebra alone", dense(runs))
            for runs in (RUNS, 8 * RUNS)
        ),
        (
            f"JAX, scan over {RUNS} runs, the same graph",
            graph(filters, begun, inputs, constants),
        ),
        (f"dynamax, vmap over {RUNS} runs, the algebra alone", dynamax(RUNS)),
    ]


def timed(function: Any, *args: Any) -> float:
    """Shortest CPU time of a call that is compiled already [s]."""
    jax.block_until_ready(function(*args))
    best = np.inf
    for _ in range(REPEAT):
        begin = time.process_time()
        jax.block_until_ready(function(*args))
        best = min(best, time.process_time() - begin)
    return float(best)


def dense(runs: int) -> float:
    """A prediction and two scalar updates with dense matrices."""
    size = s.SIZE
    F = jnp.eye(size).at[:3].add(0.01)
    Q, row = 1e-6 * jnp.eye(size), jnp.zeros(size).at[:9].set(1.0)

    def step(carried: Any, z: Any) -> Any:
        x, P = carried
        x, P = F @ x, F @ P @ F.T + Q
        for k in range(2):
            cross = P @ row
            expected = row @ cross + 1e-4
            gain = cross / expected
            x = x + gain * (z[k] - row @ x)
            P = P - jnp.outer(gain, cross)
        return (x, P), None

    def run(x: Any, P: Any, z: Any) -> Any:
        return lax.scan(step, (x, P), z)[0]

    many = jax.jit(jax.vmap(run))
    x, P = jnp.zeros((runs, size)), jnp.tile(jnp.eye(size), (runs, 1, 1))
    return timed(many, x, P, jnp.ones((runs, STEPS, 2))) / runs / STEPS


def graph(filters: BatchFilter, begun: Floats, inputs: Floats, constants: Floats) -> float:
    """Our own graph, which XLA fuses and compiles as it likes."""

    def while_loop(needed: Any, carried: Any, a_round: Any, most: int) -> Any:
        like = [jnp.broadcast_to(jnp.asarray(value, dtype=float), (RUNS,)) for value in carried]
        needed = jnp.broadcast_to(jnp.asarray(needed), (RUNS,))

        def go_on(state: Any) -> Any:
            return jnp.any(state[1]) & (state[2] < most)

        def body(state: Any) -> Any:
            values, again = a_round(state[0])
            values = [jnp.broadcast_to(value, (RUNS,)) for value in values]
            return values, jnp.broadcast_to(jnp.asarray(again), (RUNS,)), state[2] + 1

        values, again, _ = lax.while_loop(go_on, body, (like, needed, 0))
        return [*values, again]

    function = step_function(step_kernel("step", filters.shape, StepKind()), jnp, while_loop)

    def step(lanes: Any, told: Any) -> Any:
        new = function(list(lanes), list(told), constants)
        rows = [jnp.broadcast_to(new.get(row, lanes[row]), (RUNS,)) for row in range(len(begun))]
        return jnp.stack(rows), None

    copies = RUNS // begun.shape[1]
    lanes = jnp.asarray(np.tile(begun, (1, copies)))
    told = jnp.asarray(np.tile(inputs[:STEPS], (1, 1, copies)))
    many = jax.jit(lambda a, b: lax.scan(step, a, b)[0])
    return timed(many, lanes, told) / RUNS / STEPS


def dynamax(runs: int) -> float:
    """Its EKF with two readings at once, on a model that costs nothing to differentiate by hand."""
    size = s.SIZE
    rows = jnp.zeros((2, size)).at[:, :9].set(1.0)
    F = jnp.eye(size).at[:3].add(0.01)

    def run(covariance: Any, z: Any) -> Any:
        params = ParamsNLGSSM(
            initial_mean=jnp.zeros(size),
            initial_covariance=covariance,
            dynamics_function=lambda x: F @ x,
            dynamics_covariance=1e-6 * jnp.eye(size),
            emission_function=lambda x: rows @ x,
            emission_covariance=1e-4 * jnp.eye(2),
        )
        return extended_kalman_filter(params, z).filtered_means[-1]

    # Each run has a covariance of its own, as it has where filters differ; else it is worked out once.
    covariances = jnp.tile(jnp.eye(size), (runs, 1, 1))
    return timed(jax.jit(jax.vmap(run)), covariances, jnp.ones((runs, STEPS, 2))) / runs / STEPS
