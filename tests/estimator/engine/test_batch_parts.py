"""The parts of filters side by side, each against the plain thing that it stands for."""

import numpy as np

from icreckon.estimator.engine.constants import aligned
from icreckon.estimator.engine.schedule import why_not_steps
from icreckon.estimator.engine.work import run_kernel
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.elementary import exponential, sine_and_cosine
from icreckon.estimator.tracing.emit import lanes_of_machine
from icreckon.estimator.tracing.jit_kernel import entry
from icreckon.estimator.tracing.kernel import Kernel, Store
from icreckon.estimator.tracing.machine_code import compiled_library

WIDTH = lanes_of_machine(64)
call = entry(run_kernel)


def in_lanes(function, *columns):
    """A function of traced numbers, compiled and run on columns of numbers, one in each lane."""
    trace.start()
    values = function(*(trace.lane_input("lanes", row) for row in range(len(columns))))
    values = values if isinstance(values, tuple | list) else (values,)
    stores = [
        Store("lanes", len(columns) + row, trace.lift(value)) for row, value in enumerate(values)
    ]
    rows = len(columns) + len(values)
    tested = Kernel("tested", (rows, 0, 0), stores)
    lanes = aligned((len(columns) + len(values)) * WIDTH).reshape(-1, WIDTH)
    lanes[: len(columns)] = columns
    library = compiled_library(tested, f"tested.{id(tested)}", WIDTH)
    address = library.get_pointer_to_function(library.name)
    call(address, lanes, lanes, np.zeros(0))
    return lanes[len(columns) :]


def test_sine_and_cosine_are_right_to_the_last_digits() -> None:
    rng = np.random.default_rng(1)
    near = np.array([0.0, -0.0, 1e-9, -1e-5, 0.5 * np.pi, np.pi, -np.pi, 0.25 * np.pi])
    for angles in (near, rng.uniform(-4.0, 4.0, 8), rng.uniform(-1e4, 1e4, 8)):
        angles = np.resize(angles, WIDTH)
        sine, cosine = in_lanes(sine_and_cosine, angles)
        assert np.abs(sine - np.sin(angles)).max() < 4e-16
        assert np.abs(cosine - np.cos(angles)).max() < 4e-16


def test_exponentials_are_right_to_the_last_digits() -> None:
    rng = np.random.default_rng(1)
    near = np.array([0.0, -0.0, -1e-300, -1e-9, -0.5 * np.log(2.0), -1.0, -700.0, -708.0])
    for exponents in (near, rng.uniform(-1.0, 0.0, 8), rng.uniform(-700.0, 0.0, 8)):
        exponents = np.resize(exponents, WIDTH)
        found = in_lanes(exponential, exponents)[0]
        np.testing.assert_allclose(found, np.exp(exponents), rtol=5e-16, atol=0.0)
    assert in_lanes(exponential, np.full(WIDTH, -1e6))[0].max() < 1e-300


def test_stamps_that_do_not_fit_are_named() -> None:
    imu = np.arange(0, 10**9, 10**7)
    none = np.zeros(0, dtype=np.int64)
    assert why_not_steps(imu[::2], imu, imu[::50], imu[::10]) is None
    assert "fixes" in str(why_not_steps(imu[::2], imu, np.array([-5]), none))
    assert "fixes" in str(why_not_steps(imu[::20], imu[::10], np.array([5 * 10**7]), none))
    assert why_not_steps(imu[::2], imu, np.array([5 * 10**6, 10**7 + 5]), none) is None
    assert "truth" in str(why_not_steps(imu[::2], imu, none, np.array([5])))
    assert "no track speeds" in str(why_not_steps(none, imu, none, none))
