"""The friction index model: its equations, its derivatives, and the filter variants that use it."""

import msgspec
import numpy as np
import pytest

from complex_step import assert_derivatives
from estimator.contact import Soil
from estimator.errors import EstimatorError
from estimator.frames import arc_factors, compose, paper_to_rep103
from estimator.friction_map import friction_map
from estimator.kinematics import IndexValues, direct, signed_inertia
from estimator.log import ImuSeries, Log, TrackSpeedSeries
from estimator.measurements import ImuSample, TrackSpeeds
from estimator.pose_estimator import PoseEstimator
from estimator.robot import Indices, load_robot
from estimator.run import run
from estimator.steady import solve_steady
from estimator.variants import (
    DEFAULT_ADAPTATION,
    find_variant,
    initial_indices,
    motion_model,
    parameter_sigmas,
)
from simulation.scenario import Scenario, simulate

ALPHA = load_robot("auriga-alpha")
FIXED, ONLINE = find_variant("friction-fixed"), find_variant("friction-online")
MODEL = motion_model(ALPHA, FIXED)
START = initial_indices(ALPHA, FIXED).as_array()
NO_SLIP = (0.0, 0.0, 0.0)
CHANGED = START * (1.0, 0.9, 1.3, 1.1, 0.7, 0.95, 1.2, 1.0)
FLOOR = START.copy()
FLOOR[5] = 1.0


def cases(count):
    rng = np.random.default_rng(1)
    for V_l, V_r in rng.uniform(-1.1, 1.1, (count, 2)).tolist():
        for parameters in (START, CHANGED, FLOOR):
            yield V_l, V_r, parameters, tuple(rng.normal(scale=0.05, size=3).tolist())
    for V_l, V_r in ((0.5, 0.5), (0.0, 0.0), (0.0, 0.8), (-0.7, 0.7), (0.5, 0.5 + 1e-9)):
        yield V_l, V_r, CHANGED, (0.02, -0.03, 0.1)


def test_as_it_starts_it_is_the_friction_solution():
    V = np.random.default_rng(2).uniform(-1.0, 1.0, (2, 2000))
    motion, _ = MODEL.linearise(*V, START, NO_SLIP)
    expected = np.array(solve_steady(*V, ALPHA.contact).twist)
    error = np.sqrt(np.mean((np.array(motion.twist) - expected) ** 2, axis=1))
    assert (error < 1e-3 * np.sqrt(np.mean(expected**2, axis=1))).all()


def test_twist_follows_from_offsets_and_gains():
    for V_l, V_r, parameters, slip in cases(50):
        motion, _ = MODEL.linearise(V_l, V_r, parameters, slip)
        at, reference = MODEL.map.at(V_l, V_r).indices, MODEL.map.reference
        indices = IndexValues(
            parameters[1] + parameters[2] * (at.zeta - reference.zeta),
            parameters[3] + parameters[4] * (at.epsilon - reference.epsilon),
            max(1.0, parameters[5] + parameters[6] * (at.eta - reference.eta)),
        )
        assert motion.indices == pytest.approx(indices, abs=1e-14)
        kinematic = direct(V_l, V_r, indices, 0.42)
        wanted = [part + r for part, r in zip(kinematic, slip, strict=True)]
        assert motion.twist == pytest.approx(wanted, abs=1e-14)
        assert motion.u == pytest.approx(signed_inertia(motion.twist, 258.0, -0.015)[0])
        assert abs(motion.force) <= 258.0 * 9.81


def test_without_gains_it_is_the_constant_icr_model():
    constant = ALPHA.constant_indices
    V = np.random.default_rng(3).uniform(-1.0, 1.0, (2, 100))
    motion, _ = MODEL.linearise(*V, constant.as_array(), NO_SLIP)
    expected = direct(*V, IndexValues(constant.zeta0, constant.epsilon0, constant.eta0), 0.42)
    assert np.array(motion.twist) == pytest.approx(np.array(expected), abs=1e-15)


def test_derivatives_are_the_complex_step_ones():
    for V_l, V_r, parameters, slip in cases(60):
        if V_l != V_r:
            assert_derivatives(MODEL, V_l, V_r, parameters, slip)


@pytest.mark.parametrize("V", [0.0, 0.5])
def test_straight_ahead_the_speeds_move_the_mean(V):
    # There the indices jump, and only what does not see them has a derivative.
    motion, by = MODEL.linearise(V, V, CHANGED, (0.02, -0.03, 0.1))
    assert motion.twist == pytest.approx((0.02, V - 0.03, 0.1), abs=1e-15)
    assert np.array(by.by_speeds).sum(axis=1) == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert (np.array(by.by_parameters) == 0.0).all()
    assert (np.array(by.by_slip) == np.eye(3)).all()


def test_eta_never_falls_below_one():
    V = np.random.default_rng(4).uniform(-1.0, 1.0, (2, 500))
    motion, by = MODEL.linearise(*V, FLOOR, NO_SLIP)
    assert motion.indices.eta.min() == 1.0
    at_floor = motion.indices.eta == 1.0
    assert 50 < at_floor.sum() < 450
    by_eta = np.array([row[5] for row in by.by_parameters])
    assert (by_eta[:, at_floor] == 0.0).all()


@pytest.mark.parametrize("V", [-1.0, 0.0, 0.4])
def test_equal_tracks_drive_straight_whatever_the_parameters(V):
    for parameters in (START, CHANGED, FLOOR):
        twist = MODEL.linearise(V, V, parameters, NO_SLIP)[0].twist
        assert twist == (0.0, V, 0.0)


# --- the variants -----------------------------------------------------------------------------------


def test_with_known_soil_it_starts_from_the_friction_solution():
    reference = friction_map(ALPHA.contact, 1.0).reference
    assert START.tolist() == [0.67134, *_with_gains_of_one(reference), 0.0]


def test_without_known_soil_it_starts_from_the_constant_icrs():
    robot = msgspec.structs.replace(ALPHA, soil=None)
    known = robot.constant_indices
    found = initial_indices(robot, ONLINE)
    wanted = _with_gains_of_one((known.zeta0, known.epsilon0, known.eta0))
    assert found.as_array().tolist() == [0.67134, *wanted, 0.0]
    # The variation is that of firm ground without rolling resistance.
    assert motion_model(robot, ONLINE).map is friction_map(robot.contact, 1.0)
    assert robot.contact.soil == Soil()
    assert load_robot("husky").soil is None
    PoseEstimator(load_robot("husky"), "friction-online")


def _with_gains_of_one(offsets):
    return [part for offset in offsets for part in (offset, 1.0)]


def test_gains_are_shares_and_what_is_not_used_is_not_estimated():
    adaptation = DEFAULT_ADAPTATION["friction"]
    sigmas = parameter_sigmas(ALPHA, ONLINE, adaptation)
    assert sigmas[[2, 4, 6]].tolist() == [adaptation.zeta1, adaptation.epsilon1, adaptation.eta1]
    assert sigmas[[0, 7]].tolist() == [0.0, 0.0]
    assert not parameter_sigmas(ALPHA, FIXED, adaptation).any()


def test_centre_of_mass_beside_the_contact_is_a_clear_error():
    vehicle = msgspec.structs.replace(ALPHA.vehicle, centre_of_mass=(0.5, 0.0, 0.3))
    robot = msgspec.structs.replace(ALPHA, vehicle=vehicle)
    with pytest.raises(EstimatorError, match=r"auriga-alpha: .* outside the contact.*\[vehicle\]"):
        PoseEstimator(robot, "friction-fixed")
    PoseEstimator(robot, "inertia-online")


def friction_log(seconds=60.0):
    """Track speeds of a lively drive, its exact gyro, and where friction takes the robot: a pose (3,)."""
    stamps = np.arange(0, round(seconds * 50)) * 20_000_000
    time = stamps * 1e-9
    forward = 0.5 * np.sin(2 * np.pi * time / 17.0) + 0.2
    half = 0.25 * np.sin(2 * np.pi * time / 5.3) * (time < seconds - 3.0)
    V_l, V_r = forward - half, forward + half
    v_x, v_y, w = solve_steady(V_l, V_r, ALPHA.contact).twist
    forward, left = paper_to_rep103(v_x, v_y)
    pose = np.zeros(3)
    for x, y, turn in (0.02 * np.stack([forward, left, w], axis=-1))[:-1]:
        a, b = arc_factors(turn)
        pose = compose(pose, [a * x - b * y, b * x + a * y, turn])
    rates = np.stack([0.0 * w, 0.0 * w, w], axis=-1)
    log = Log("friction", TrackSpeedSeries(stamps, np.stack([V_l, V_r], axis=-1)))
    with_imu = Log("friction", log.tracks, ImuSeries(stamps, rates))
    return log, with_imu, pose, 0.02 * float(np.hypot(forward, left).sum())


def test_driven_by_friction_it_hardly_drifts_and_the_others_do():
    log, _, pose, distance = friction_log()
    ends = {
        name: run(log, ALPHA, name).trajectory.poses[-1]
        for name in ("friction-fixed", "inertia-fixed", "constant-fixed")
    }
    drift = {name: np.hypot(*(end - pose)[:2]) / distance for name, end in ends.items()}
    # Track speeds are held for 20 ms, and old by that much when they come.
    assert drift["friction-fixed"] < 5e-4
    assert abs(ends["friction-fixed"][2] - pose[2]) < 1e-3
    assert drift["friction-fixed"] < 0.05 * min(drift["inertia-fixed"], drift["constant-fixed"])


def test_online_it_keeps_what_is_right_and_finds_what_is_wrong():
    _, with_imu, _, _ = friction_log(40.0)
    kept = run(with_imu, ALPHA, "friction-online")
    sigmas = parameter_sigmas(ALPHA, ONLINE, DEFAULT_ADAPTATION["friction"])
    moved = kept.states[-1, 6:14] - START
    assert (np.abs(moved) <= 0.5 * sigmas).all()
    assert moved[0] == moved[7] == 0.0
    # A tread that steers worse than the file says: the gyro shows eta.
    wrong = PoseEstimator(ALPHA, "friction-online")
    wrong._reckoning.ekf.x[11] += 0.3
    for measurement in with_imu.measurements():
        wrong.feed(measurement)
    assert abs(wrong.parameters["eta0"] - START[5]) < 0.15


@pytest.mark.parametrize("variant", ["friction-fixed", "friction-online"])
def test_simulated_logs_run_to_their_end(variant):
    log = simulate(Scenario(duration=30.0, trajectory="aggressive", seed=2), ALPHA)
    found = run(log, ALPHA, variant)
    assert np.isfinite(found.states).all()
    assert (found.states[:, 6] == ALPHA.indices.H).all()
    assert (found.indices[:, 2] >= 1.0).all()
    assert found.health.sensor("gyro").used > 2900


@pytest.mark.parametrize("variant", ["friction-fixed", "friction-online"])
def test_a_robot_at_rest_has_no_twist(variant):
    estimator = PoseEstimator(ALPHA, variant)
    for k in range(200):
        estimator.feed(TrackSpeeds(k * 10_000_000, 0.0, 0.0))
        estimator.feed(ImuSample(k * 10_000_000, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
    assert estimator.stands
    assert estimator.twist.tolist() == [0.0, 0.0, 0.0]
    assert estimator.pose.tolist() == [0.0, 0.0, 0.0]
    assert estimator.parameters == pytest.approx(
        dict(zip(Indices.__struct_fields__, START, strict=True))
    )
