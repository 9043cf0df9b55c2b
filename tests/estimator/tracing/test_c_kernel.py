"""Kernels in C against the same kernels in plain numbers, on random workspaces."""

import ctypes
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_filters import compiled
from icreckon.estimator.embedded.c_filter import AHEAD, BEGIN, PART
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.fixes import position_kernel
from icreckon.estimator.engine.lane import plain_kernel
from icreckon.estimator.engine.layout import INPUTS, covariance_name
from icreckon.estimator.engine.step import step_kernel
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.tracing.c_kernel import kernel_in_c, literal
from same_runs import ROBOT

HEAD = """#include <math.h>
#include <stdbool.h>
#include <stdint.h>
typedef double real;
"""
KERNELS = {
    "begin": partial(step_kernel, kind=BEGIN),
    "stand": partial(step_kernel, kind=PART._replace(imu=False, stands=True)),
    "update": partial(step_kernel, kind=PART._replace(may_lack_force=True)),
    "propagate": partial(step_kernel, kind=PART._replace(imu=False, moves=True)),
    "position": partial(position_kernel, kind=AHEAD),
}


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("variant", ["gyro", "inertia-online", "full-linear"])
def test_kernel_is_that_of_plain_numbers(name: str, variant: str, tmp_path: Path) -> None:
    filter_ = BatchFilter(ROBOT, VARIANTS[variant], Settings(), width=1)
    text = kernel_in_c(KERNELS[name](name, filter_.shape), 64)
    call = f"uint32_t call(real *l, const real *i, const real *c) {{ return {name}(l, i, c); }}\n"
    of_c = compiled(HEAD + text + call, tmp_path).call
    of_c.restype = ctypes.c_uint32

    def make(numbers: Any) -> Any:
        return KERNELS[name](name, filter_.shape, numbers=numbers)

    plain = plain_kernel(make)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        lanes, inputs, constants = random_arrays(filter_, rng)
        found = lanes.copy()
        flags = of_c(*(one.ctypes.data_as(ctypes.c_void_p) for one in (found, inputs, constants)))
        assert flags == plain(lanes, inputs, constants)
        np.testing.assert_allclose(found, lanes, rtol=1e-9, atol=1e-12)


def random_arrays(filter_: BatchFilter, rng: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Workspace with a random covariance, inputs and constants of a step."""
    begun = filter_.begin(np.zeros((1, 2)), np.zeros(3), np.full(3, 0.1))
    lanes, rows, states = begun.workspace.copy(), filter_.rows, filter_.shape.states
    sigmas = np.array([np.sqrt(lanes[rows[covariance_name(i, i)], 0]) for i in states])
    root = rng.normal(size=(len(states), len(states))) * 0.3 + np.eye(len(states))
    P = root @ root.T * np.outer(sigmas, sigmas)
    for n, i in enumerate(states):
        lanes[rows[f"x{i}"]] += rng.normal() * 0.1 * sigmas[n]
        for m, j in enumerate(states[n:], n):
            lanes[rows[covariance_name(i, j)]] = P[n, m]
    inputs = rng.uniform(0.01, 0.3, (len(INPUTS), 1))
    inputs[INPUTS["fix_mode"]] = rng.integers(0, 3)
    inputs[INPUTS["unknown"]] = inputs[INPUTS["slow"]] = rng.integers(0, 2)
    constants, places = begun.constants.copy(), filter_.layout.constants
    for name, value in (("dt", 0.01), ("smoothing", 0.2), ("interval", 0.01)):
        constants[places[name]] = value
    return lanes, inputs, constants


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.5, "0.5"),
        (1e300, "1e+300"),
        (np.inf, "INFINITY"),
        (-np.inf, "-INFINITY"),
        (np.nan, "NAN"),
    ],
)
def test_numbers_in_c(value: float, text: str) -> None:
    assert literal(value, 64) == text
    assert literal(0.5, 32) == "0.5f"
