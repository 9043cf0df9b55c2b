"""The filter's arithmetic: derivatives, process noise, updates, bounds."""

import copy

import numpy as np
import pytest
from scipy.integrate import quad

from icreckon.estimator.base import state as s
from icreckon.estimator.motion.bounds import BOUND_MARGIN, ROUNDING
from icreckon.estimator.motion.linear_model import LinearMotion
from icreckon.estimator.reference.ekf import IcrEkf, ProcessNoise
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import find_variant, initial_parameters, motion_model

ALPHA = load_robot("auriga-alpha")
INERTIA, LINEAR = find_variant("inertia-online"), find_variant("full-linear")
VEHICLE = motion_model(ALPHA, INERTIA).vehicle
NO_NOISE = ProcessNoise(np.zeros(3), (1.0, 1.0, 0.5), np.zeros(s.SIZE))
# Standard deviations that a filter may have in the states, in their own units.
SCALES = np.zeros(s.SIZE)
SCALES[s.MOVED] = 0.1, 0.1, 0.05, 0.1
SCALES[s.SLIP] = SCALES[s.FAST_SLIP] = 0.02, 0.02, 0.05
SCALES[s.PARAMETERS] = 0.0, 0.01, 5e-5, 0.02, 2e-4, 0.2, 4e-4, 2e-6, 0.2
SCALES[s.BIASES] = 0.01, 0.1, 0.1, 0.01, 0.01, 0.02, 0.01, 0.01
SCALES[s.GRAVITY] = 0.5
LINEAR_SCALES = SCALES.copy()
LINEAR_SCALES[s.PARAMETERS] = 0.02, 0.02, 0.05, 0.05, 0.2, 0.2, 0.0, 0.0, 0.0


def scales_of(ekf):
    return LINEAR_SCALES if isinstance(ekf.model, LinearMotion) else SCALES


def make(rng=None, variant=INERTIA):
    """A filter about the parameters that it starts from: at them, or at a random state near them."""
    ekf = IcrEkf(motion_model(ALPHA, variant))
    ekf.x[s.PARAMETERS] = initial_parameters(ALPHA, variant)
    if rng is not None:
        scales = scales_of(ekf)
        ekf.x += scales * rng.normal(size=s.SIZE)
        root = scales[:, None] * rng.normal(size=(s.SIZE, s.SIZE))
        ekf.P = root @ root.T / s.SIZE
    return ekf


def at(ekf, x):
    other = copy.deepcopy(ekf)
    other.x = x.copy()
    return other


def derivative(function, x, scales):
    """Central differences (m, SIZE) of a function of the state, each step in the state's own unit."""
    columns = []
    for index, scale in enumerate(scales):
        step = np.zeros(s.SIZE)
        step[index] = 1e-4 * scale if scale else 1e-4
        columns.append((function(x + step) - function(x - step)) / (2.0 * step[index]))
    return np.stack(columns, axis=-1)


def assert_jacobian(found, expected, scales):
    """Equal to 1e-6 of what a standard deviation of any state can do to that row."""
    size = np.where(scales > 0, scales, 1e-3)
    error = (found - expected) * size
    assert np.abs(error).max() < 1e-6 * np.abs(expected * size).max()


def noise(sigma=(0.03, 0.01, 0.1), times=(1.5, 1.2, 1.0), walk=None):
    return ProcessNoise(np.array(sigma), times, 0.1 * SCALES if walk is None else walk)


MODELS = pytest.mark.parametrize("variant", [INERTIA, LINEAR], ids=lambda variant: variant.name)


def moving(rng, variant):
    """A filter whose motion model has moved for a while."""
    ekf = make(rng, variant)
    for _ in range(3):
        ekf.begin_step(0.05, *rng.uniform(-1.0, 1.0, 2))
    return ekf


@MODELS
def test_jacobian_of_the_twist_is_its_derivative_by_the_state(variant):
    rng, shares = np.random.default_rng(1), (0.9, 0.8, 0.7)
    for _ in range(20):
        ekf = moving(rng, variant)
        left, right = rng.uniform(-1.0, 1.0, 2)
        model = ekf.twist_model(left, right, shares)

        def twist(x, ekf=ekf, left=left, right=right):
            return at(ekf, x).twist_model(left, right, shares).twist

        scales = scales_of(ekf)
        assert_jacobian(model.jacobian, derivative(twist, ekf.x, scales), scales)


@MODELS
def test_derivative_by_the_track_speeds(variant):
    rng = np.random.default_rng(2)
    for _ in range(20):
        ekf = moving(rng, variant)
        speeds = rng.uniform(-1.0, 1.0, 2)
        for track in (0, 1):
            step = np.zeros(2)
            step[track] = 1e-6
            change = (
                ekf.twist_model(*(speeds + step)).twist - ekf.twist_model(*(speeds - step)).twist
            )
            assert ekf.twist_model(*speeds).by_speeds[:, track] == pytest.approx(
                change / 2e-6, abs=1e-7
            )


@pytest.mark.parametrize("dt", [0.002, 0.02, 0.3])
@MODELS
def test_transition_is_the_derivative_of_the_prediction(dt, variant):
    """The slope counts as known, seen from above, and the angle by which gravity turns (next test)."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        ekf = moving(rng, variant)
        left, right = rng.uniform(-1.0, 1.0, 2)

        def predicted(x, ekf=ekf, left=left, right=right):
            other = at(ekf, x)
            other.predict_motion(dt, left, right, NO_NOISE, (0.2, -0.3))
            return other.x

        scales = scales_of(ekf)
        expected = derivative(predicted, ekf.x, scales)
        ekf.predict_motion(dt, left, right, NO_NOISE, (0.2, -0.3))
        expected[s.GRAVITY] = ekf.F[s.GRAVITY]
        for known in (s.GRAVITY, [s.GYRO_BIAS_Y]):
            expected[s.POSE, known] = ekf.F[s.POSE, known]
        assert_jacobian(ekf.F, expected, scales)


def test_transition_where_the_arc_becomes_a_line():
    # The slope of the arc's factors is a series below 1e-4 rad and a quotient above.
    for turn in (0.0, 0.9e-4, 1.1e-4, 1e-3):
        ekf = make()
        ekf.x[s.SLIP_W] = turn / 0.1
        noise_free = ProcessNoise(np.zeros(3), (1e9, 1e9, 1e9), np.zeros(s.SIZE))
        ekf.predict_motion(0.1, 0.5, 0.5, noise_free)
        # d(y) / d(w) of a chord of 0.05 m: half of it times dt, to 1e-6 of it.
        assert ekf.F[s.Y, s.SLIP_W] == pytest.approx(0.05 * 0.1 / 2, rel=1e-6)
        assert ekf.F[s.X, s.SLIP_W] == pytest.approx(-0.05 * 0.1 * turn / 3, abs=1e-9)


@pytest.mark.parametrize("variant", [INERTIA, LINEAR], ids=lambda variant: variant.name)
def test_dividing_a_step_changes_the_noise_to_second_order_only(variant):
    rng = np.random.default_rng(5)
    start = make(rng, variant)
    if variant is INERTIA:
        start.x[s.GRAVITY] = 0.0
        start.P[s.GRAVITY, :] = start.P[:, s.GRAVITY] = 0.0
    # The slip of w within a step is part of the fast slip, which the gyro shows.
    differences, without_w = [], noise(sigma=(0.03, 0.01, 0.0))
    for dt in (0.1, 0.05, 0.025):
        whole, parts = copy.deepcopy(start), copy.deepcopy(start)
        whole.predict_motion(dt, 0.2, 0.8, without_w)
        for _ in range(10):
            parts.predict_motion(dt / 10, 0.2, 0.8, without_w)
        unit = np.sqrt(np.diagonal(parts.P).clip(1e-30))
        differences.append(np.abs((whole.P - parts.P) / np.outer(unit, unit)).max())
        assert whole.x == pytest.approx(parts.x, abs=0.1 * dt**2)
    assert differences[0] < 1e-3
    # Halving the step divides the difference by four or more.
    assert differences[1] < 0.3 * differences[0]
    assert differences[2] < 0.3 * differences[1]


@pytest.mark.parametrize("steps", [1, 7, 300])
def test_slip_becomes_the_uncertainty_of_an_integrated_gauss_markov_process(steps):
    # From no slip at all, over T seconds along a straight line.
    T, tau, sigma = 3.0, 0.7, 0.05
    ekf = make()
    for _ in range(steps):
        ekf.predict_motion(
            T / steps, 0.5, 0.5, noise((sigma, 0, 0), (tau, 1.0, 1.0), np.zeros(s.SIZE))
        )
    density = 2.0 * sigma**2 / tau

    def response(t):
        return tau * -np.expm1(-t / tau)

    position = quad(lambda t: density * response(t) ** 2, 0.0, T)[0]
    mixed = quad(lambda t: density * response(t) * np.exp(-t / tau), 0.0, T)[0]
    velocity = quad(lambda t: density * np.exp(-2.0 * t / tau), 0.0, T)[0]
    assert ekf.P[s.X, s.X] == pytest.approx(position, rel=1e-9)
    assert ekf.P[s.X, s.SLIP_X] == pytest.approx(mixed, rel=1e-9)
    assert ekf.P[s.SLIP_X, s.SLIP_X] == pytest.approx(velocity, rel=1e-9)


@pytest.mark.parametrize("steps", [1, 200])
def test_random_walks_reach_the_pose_within_the_step(steps):
    # A gap of the track speeds is one long step: what the walk does to the pose must not wait.
    walk = np.zeros(s.SIZE)
    walk[s.FAST_SLIP] = 0.3, 0.0, 0.0
    ekf = make()
    for _ in range(steps):
        ekf.predict_motion(5.0 / steps, 0.5, 0.5, noise((0, 0, 0), (1.0, 1.0, 1.0), walk))
    fast = s.FAST_SLIP.start
    assert ekf.P[s.X, s.X] == pytest.approx(0.09 * 5.0**3 / 3)
    assert ekf.P[s.X, fast] == pytest.approx(0.09 * 5.0**2 / 2)
    assert ekf.P[fast, fast] == pytest.approx(0.09 * 5.0)


def test_stand_in_moves_the_prediction_as_far_as_if_no_state_were_fixed():
    fixed = (s.X, s.Y, s.YAW, *range(s.PARAMETERS.start, s.PARAMETERS.stop))
    others = np.delete(np.arange(s.SIZE), [*fixed, s.SLIP_W])
    for seed in range(10):
        rng = np.random.default_rng(seed)
        ekf = make(rng)
        free, without = copy.deepcopy(ekf), copy.deepcopy(ekf)
        row, variance = rng.normal(size=s.SIZE), 0.02
        before, P = ekf.x.copy(), ekf.P.copy()
        ekf.update_scalar(0.3, row, variance, fixed=fixed, stand_in=s.SLIP_W)
        free.update_scalar(0.3, row, variance)
        without.update_scalar(0.3, row, variance, fixed=fixed)
        assert row @ ekf.x == pytest.approx(row @ free.x, rel=1e-9)
        assert abs(row @ without.x - row @ free.x) > 1e-4
        assert (ekf.x[list(fixed)] == before[list(fixed)]).all()
        assert (ekf.x[others] == without.x[others]).all()
        # The covariance is that of the error for the gain that was used.
        K = (ekf.x - before) / 0.3
        A = np.eye(s.SIZE) - np.outer(K, row)
        of_error = A @ P @ A.T + variance * np.outer(K, K)
        assert pytest.approx(of_error, rel=1e-9, abs=1e-12) == ekf.P
        # The variance of the prediction is that of the free update, too: no gain has a smaller one.
        assert row @ ekf.P @ row == pytest.approx(row @ free.P @ row, rel=1e-9)


def inside(ekf):
    half = 0.5 * VEHICLE.gauge * ekf.x[s.ETA0]
    epsilon = ekf.x[s.EPSILON0]
    tolerance = 1e-9
    return (
        ekf.x[s.ETA0] >= 1.0 - tolerance
        and half + epsilon >= BOUND_MARGIN - tolerance
        and half - epsilon >= BOUND_MARGIN - tolerance
    )


def test_parameters_are_brought_back_inside_whatever_the_covariance():
    rng = np.random.default_rng(10)
    outside = 0
    for _ in range(1000):
        ekf = make(rng)
        root = rng.normal(size=(s.SIZE, s.SIZE))
        ekf.P = root @ root.T
        ekf.x[s.ETA0], ekf.x[s.EPSILON0] = rng.normal(1.0, 1.0), rng.normal(0.0, 0.3)
        outside += not inside(ekf)
        P = ekf.P.copy()
        ekf.keep_inside_bounds()
        assert inside(ekf)
        assert (ekf.P == P).all()
    assert outside > 300


def test_projection_moves_along_the_covariance_to_the_nearest_point():
    ekf = make()
    ekf.x[s.ETA0] = 0.8
    ekf.P[s.ETA0, s.ETA0] = 0.04
    ekf.P[s.ETA0, s.GYRO_BIAS] = ekf.P[s.GYRO_BIAS, s.ETA0] = 0.001
    ekf.P[s.GYRO_BIAS, s.GYRO_BIAS] = 0.0001
    ekf.keep_inside_bounds()
    assert ekf.x[s.ETA0] == pytest.approx(1.0)
    # What is known together moves together: 0.2 * 0.001 / 0.04.
    assert ekf.x[s.GYRO_BIAS] == pytest.approx(0.005)


@pytest.mark.parametrize("by_imu", [True, False])
def test_projection_moves_neither_the_pose_nor_what_the_measurement_does_not_show(by_imu):
    rng = np.random.default_rng(13)
    ekf = make(rng)
    root = rng.normal(size=(s.SIZE, s.SIZE))
    ekf.P = root @ root.T
    ekf.x[s.ETA0] = 0.5
    before = ekf.x.copy()
    ekf.keep_inside_bounds(by_imu=by_imu)
    assert ekf.x[s.ETA0] >= 1.0 - ROUNDING
    still = {s.X, s.Y, s.YAW, s.Z}
    if by_imu:
        # Of the parameters, the IMU shows eta0 alone, and its gyro neither slopes nor what is known
        # together with them.
        others = {*range(s.PARAMETERS.start, s.PARAMETERS.stop)} - {s.ETA0}
        slopes = {s.GRAVITY_X, s.GRAVITY_Y, s.ACCELEROMETER_BIAS_X, s.ACCELEROMETER_BIAS_Y}
        slopes |= {s.GYRO_BIAS_X, s.GYRO_BIAS_Y}
        still |= {s.TRACK_SCALE, s.GYRO_SCALE, *others, *slopes}
    # There is no derivative by H, and so nothing that lanes keep of it.
    moved = set(np.flatnonzero(ekf.x != before).tolist()) | {s.PARAMETERS.start}
    assert moved == set(range(s.SIZE)) - still | {s.PARAMETERS.start}
