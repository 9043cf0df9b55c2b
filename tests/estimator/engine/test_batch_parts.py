"""The parts of filters side by side, each against the plain thing that it stands for."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.state import PARAMETERS
from icreckon.estimator.batch.front_end import FIX_VALUES, FrontEnd, Measured
from icreckon.estimator.engine.constants import aligned
from icreckon.estimator.engine.covariance import Covariance
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.schedule import (
    MOVE_AND_UPDATE,
    UPDATE,
    steps_of,
    why_not_steps,
)
from icreckon.estimator.engine.step import StepKind, step_kernel
from icreckon.estimator.engine.work import run_kernel
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import (
    DEFAULT_ADAPTATION,
    VARIANTS,
    parameter_walks,
)
from icreckon.estimator.sensors.held_tracks import (
    ACCELERATION_AVERAGING,
    TrackRecord,
    age_at,
    gap_density,
    mean_speeds,
    speeds_at,
    take_motion,
    take_tracks,
)
from icreckon.estimator.sensors.imu_noise import (
    NoiseRecord,
    imu_noise,
    measure_noise,
    measured_noise,
)
from icreckon.estimator.sensors.input_settings import InputSettings, input_settings
from icreckon.estimator.sensors.standstill import (
    QuietReadings,
    StandstillRecord,
    stopped_after,
    tracks_rest,
)
from icreckon.estimator.sensors.step_inputs import step_inputs
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.elementary import exponential, sine_and_cosine
from icreckon.estimator.tracing.emit import lanes_of_machine
from icreckon.estimator.tracing.jit_kernel import entry
from icreckon.estimator.tracing.kernel import Kernel, Store
from icreckon.estimator.tracing.machine_code import compiled_library

WIDTH = lanes_of_machine(64)
ROBOT = load_robot("auriga-alpha")
call = entry(run_kernel)


def in_lanes(function, *columns, constants=()):
    """A function of traced numbers, compiled and run on columns of numbers, one in each lane."""
    trace.start()
    values = function(*(trace.lane_input("lanes", row) for row in range(len(columns))))
    values = values if isinstance(values, tuple | list) else (values,)
    stores = [
        Store("lanes", len(columns) + row, trace.lift(value)) for row, value in enumerate(values)
    ]
    rows = len(columns) + len(values)
    tested = Kernel("tested", (rows, 0, len(constants)), stores)
    lanes = aligned((len(columns) + len(values)) * WIDTH).reshape(-1, WIDTH)
    lanes[: len(columns)] = columns
    library = compiled_library(tested, f"tested.{id(tested)}", WIDTH)
    address = library.get_pointer_to_function(library.name)
    call(address, lanes, lanes, np.array(constants, dtype=float))
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


def test_rounds_go_on_until_the_last_lane_is_done_and_no_longer() -> None:
    def halve(value):
        return trace.repeat(
            value > 1.0, [value, 0.0], lambda v, n: ([0.5 * v, n + 1.0], 0.5 * v > 1.0), 50
        )[:2]

    values = np.resize([0.5, 3.0, 100.0, 1e6], WIDTH)
    left, rounds = in_lanes(halve, values)
    most = math.ceil(math.log2(1e6))
    assert np.array_equal(rounds, np.full(WIDTH, most))
    assert np.allclose(left, values * 0.5**most, rtol=1e-15)
    left, rounds = in_lanes(halve, np.full(WIDTH, 0.5))
    assert np.array_equal(left, np.full(WIDTH, 0.5))
    assert not rounds.any()


def test_rounds_have_an_end() -> None:
    def endless(value):
        again = trace.lift_truth(True)
        return trace.repeat(again, [value], lambda v: ([v + 1.0], again), 7)[0]

    assert np.array_equal(in_lanes(endless, np.zeros(WIDTH))[0], np.full(WIDTH, 7.0))


@settings(max_examples=15)
@given(st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=3), st.integers(0, 5))
def test_expressions_are_worked_out_as_python_does(values, seed) -> None:
    def function(a, b, c):
        total, rng = a, np.random.default_rng(seed)
        for _ in range(12):
            other = (a, b, c, total)[rng.integers(4)]
            match rng.integers(6):
                case 0:
                    total = total + 0.5 * other
                case 1:
                    total = other - total
                case 2:
                    total = 0.25 * total * other
                case 3:
                    total = total / (1.0 + other * other)
                case 4:
                    total = trace.select(total > other, abs(total), -other)
                case 5:
                    total = trace.minimum(trace.maximum(total, other), 5.0) * 0.0 + 1.0 * total
        return total

    (found,) = in_lanes(function, *(np.full(WIDTH, value) for value in values))
    assert found[0] == pytest.approx(function(*values), rel=1e-12, abs=1e-12)


def test_what_is_zero_costs_nothing() -> None:
    trace.start()
    a = trace.lane_input("lanes", 0)
    assert (a * 0.0).constant == 0.0
    assert a + 0.0 is a
    assert a * 1.0 is a
    assert (0.0 * a + a * 2.0) is (2.0 * a)
    negative = -a
    assert -negative is a
    assert a + 1.0 is 1.0 + a


def test_a_branch_on_a_lane_is_refused() -> None:
    trace.start()
    with pytest.raises(TypeError, match="select"):
        bool(trace.lane_input("lanes", 0) > 0.0)


def test_updates_that_are_put_off_come_to_the_same() -> None:
    rng = np.random.default_rng(3)
    root = rng.standard_normal((5, 5))
    P = root @ root.T + np.eye(5)
    lazy = Covariance({(i, j): P[i, j] for i in range(5) for j in range(i, 5)})
    kept = (0, 1)
    for _ in range(3):
        row = {i: float(rng.standard_normal()) for i in (1, 2, 4)}
        h = np.array([row.get(i, 0.0) for i in range(5)])
        cross = lazy.times(row)
        expected = sum(cross[i] * h[i] for i in range(5)) + 0.3
        lazy.update(cross, 1.0 / expected, kept)
        c = P @ h
        k = c / (h @ c + 0.3)
        k[list(kept)] = 0.0
        P = P - np.outer(k, c) - np.outer(c, k) + (h @ c + 0.3) * np.outer(k, k)
        found = np.array([[lazy.entry(i, j) for j in range(5)] for i in range(5)])
        assert np.abs(found - P).max() < 1e-12
        assert np.allclose([lazy.times({0: 1.0, 3: 2.0})[i] for i in range(5)], P[0] + 2.0 * P[3])


def all_inputs(tracks, present, rates, track_rate, imu_rate, settings):
    """Steps of a run, and their inputs."""
    count = len(rates)
    imu = np.rint(np.arange(count) / imu_rate * 1e9).astype(np.int64)
    stamps = np.rint(np.arange(len(tracks)) / track_rate * 1e9).astype(np.int64)
    stamps = stamps[stamps <= imu[-1]]
    speeds = np.where(present[: len(stamps), None], tracks[: len(stamps)], np.nan)
    none, no_fixes = np.zeros(0, dtype=np.int64), np.zeros((1, 0, FIX_VALUES))
    no_wheels = [np.zeros((1, len(stamps), 0))] * 2
    measured = Measured(
        stamps, speeds[None], *no_wheels, imu, rates[None], np.zeros((1, count, 2)), none, no_fixes
    )
    steps = steps_of(stamps, imu, none, none, heading=False)
    inputs = np.zeros((len(steps.kinds), len(INPUTS), 1))
    front = FrontEnd(measured, steps, settings)
    half = len(inputs) // 2
    front.fill(0, half, inputs[:half])
    front.fill(half, len(inputs), inputs[half:])
    return steps, measured, inputs[:, :, 0]


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.sampled_from([(50.0, 100.0), (20.0, 100.0), (50.0, 50.0)]))
def test_inputs_of_steps_are_those_of_the_streaming_filter(seed, rates) -> None:
    rng = np.random.default_rng(seed)
    track_rate, imu_rate = rates
    count = 400
    tracks = np.cumsum(0.02 * rng.standard_normal((count, 2)), axis=0)
    tracks[100:140] = 0.0
    tracks[200:230, 0] = tracks[200, 0]
    present = rng.random(count) < 0.95
    present[150:180] = False
    present[0] = True
    gyro = 1e-3 * rng.standard_normal(count)
    chosen = input_settings(ROBOT, Settings())
    steps, measured, inputs = all_inputs(tracks, present, gyro, track_rate, imu_rate, chosen)

    held = TrackRecord()
    taken = 0
    for k, (start, end) in enumerate(zip(steps.starts.tolist(), steps.ends.tolist(), strict=True)):
        while taken < steps.tracks[k]:
            left, right = measured.tracks[0, taken].tolist()
            if not math.isnan(left):
                take_tracks(held, int(measured.track_stamps[taken]), left, right, chosen)
            taken += 1
        if steps.kinds[k] in (MOVE_AND_UPDATE, UPDATE):
            take_motion(held, end, float(gyro[steps.samples[k]]), math.nan, math.nan, chosen)
        plain = step_inputs(held, StandstillRecord(), start, end, chosen)
        expected = {
            "left": speeds_at(held, start, chosen.hold_ns)[0],
            "right": speeds_at(held, start, chosen.hold_ns)[1],
            "now_right": speeds_at(held, end, chosen.hold_ns)[1],
            "smooth_left": held.smooth_left,
            "acceleration_right": plain.acceleration_right,
            "window": max(ACCELERATION_AVERAGING, held.interval),
            "age": age_at(held, start, chosen.hold),
            "speed_variance": plain.speed_variance,
        }
        if end > start:
            expected["mean_left"] = mean_speeds(held, start, end, chosen.hold_ns)[0]
            expected["gap_density"] = gap_density(held, start, end, chosen)
            expected["left_density"] = plain.left_density
        for name, value in expected.items():
            assert inputs[k, INPUTS[name]] == pytest.approx(value, rel=1e-12, abs=1e-15), name


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.floats(1e-4, 0.03))
def test_standstill_is_found_as_by_the_streaming_filter(seed, size) -> None:
    rng = np.random.default_rng(seed)
    count = 400
    tracks = np.where(rng.random((count, 1)) < 0.98, 0.0, 0.2) * np.ones(2)
    gyro = size * rng.standard_normal(count) + 0.01
    chosen = input_settings(ROBOT, Settings())
    steps, measured, inputs = all_inputs(
        tracks, np.ones(count, dtype=bool), gyro, 50.0, 100.0, chosen
    )
    still, readings, noise = StandstillRecord(), QuietReadings(), NoiseRecord()
    taken = 0
    for k, end in enumerate(steps.ends.tolist()):
        while taken < steps.tracks[k]:
            stamp, speeds = int(measured.track_stamps[taken]), measured.tracks[0, taken].tolist()
            stopped_after(still, stamp, *speeds, chosen.track_speed)
            taken += 1
        measure_noise(noise, end, float(gyro[k]), 0.0, 0.0, chosen.hold)
        spread = measured_noise(noise.gyro)
        mean = readings.mean(still, end, float(gyro[k]), spread, chosen)
        assert inputs[k, INPUTS["gyro_density"]] == pytest.approx(
            imu_noise(noise, tracks_rest(still), chosen).gyro, rel=1e-12
        )
        assert inputs[k, INPUTS["quiet_mean"]] == pytest.approx(mean, rel=1e-12, nan_ok=True)


def test_stamps_that_do_not_fit_are_named() -> None:
    imu = np.arange(0, 10**9, 10**7)
    none = np.zeros(0, dtype=np.int64)
    assert why_not_steps(imu[::2], imu, imu[::50], imu[::10]) is None
    assert "fixes" in str(why_not_steps(imu[::2], imu, np.array([-5]), none))
    assert "fixes" in str(why_not_steps(imu[::20], imu[::10], np.array([5 * 10**7]), none))
    assert why_not_steps(imu[::2], imu, np.array([5 * 10**6, 10**7 + 5]), none) is None
    assert "truth" in str(why_not_steps(imu[::2], imu, none, np.array([5])))
    assert "no track speeds" in str(why_not_steps(none, imu, none, none))


def test_the_inner_loops_use_the_widest_registers_there_are() -> None:
    """Nearly all multiplications of a step are of whole vectors."""
    filters = BatchFilter(ROBOT, VARIANTS["constant-online"], Settings())
    usual = step_kernel("usual", filters.shape, StepKind())
    code = compiled_library(usual, "usual", WIDTH).get_asm_str()
    register = {8: "%zmm", 4: "%ymm", 2: "%xmm"}[WIDTH]
    multiplications = re.findall(r"^\s+v?(?:mul|fn?m(?:add|sub)\d+)[sp]d\s.*$", code, re.M)
    wide = [line for line in multiplications if register in line]
    assert len(multiplications) > 1000
    assert len(wide) > 0.95 * len(multiplications)


def test_parameter_walks_are_known_to_the_filters() -> None:
    """A state is left out only where it neither is uncertain nor becomes so."""
    for name, variant in VARIANTS.items():
        filters = BatchFilter(ROBOT, variant, Settings())
        walks = parameter_walks(ROBOT, variant, DEFAULT_ADAPTATION[variant.model])
        for number, walk in enumerate(walks):
            assert walk == 0.0 or PARAMETERS.start + number in filters.shape.states, name


def test_time_is_counted_in_nanoseconds_that_doubles_hold() -> None:
    """Stamps since the start stay exact for a hundred days."""
    assert 2**53 * NANOSECOND / 86400.0 > 100.0


def test_settings_of_the_front_end_are_the_filters_own() -> None:
    found = input_settings(ROBOT, Settings(hold=0.4))
    assert isinstance(found, InputSettings)
    assert found.hold == 0.4
    assert found.fastest == ROBOT.vehicle.max_track_speed
