"""Transient dynamics: known motions, an independent integrator, and the stationary solver as limit."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from forces_of_tracks import steady_inertia, track_forces, vertical_loads
from icreckon import Patch, Payload, SimulationError, Soil, load_robot
from icreckon.estimator.motion.icr import GRAVITY, PaperTwist
from icreckon.estimator.robot.robot_file import LOAD_LAG
from icreckon.simulation.contact.contact import Body, Contact, equally_spaced
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.contact.steady_state import solve_steady
from icreckon.simulation.drives.trajectories import make_trajectory
from icreckon.simulation.truth.friction import (
    FrictionTruth,
    draw_contact,
    drive,
    follow,
    mass_matrix,
)

GEOMETRY = equally_spaced(0.42, 0.4, 5)
BODY = Body(258.0, -0.015, 0.04, 0.3)
INERTIA = 20.0
CONTACT = Contact(Soil(0.9, rolling_resistance=0.05), GEOMETRY, BODY)
CENTRED = Contact(Soil(0.8, rolling_resistance=0.0), GEOMETRY, Body(258.0, z_CM=0.3))
STEP = 0.01


def constant(left: float, right: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    speeds = np.tile([left, right], (round(seconds / STEP) + 1, 1)).astype(float)
    return speeds, np.zeros_like(speeds)


def wavy(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Track speeds and their derivatives that turn both ways, reverse, and cross zero slip."""
    left = 0.5 * np.sin(1.1 * times) + 0.1 * np.sin(3.0 * times)
    right = 0.6 * np.sin(0.7 * times) - 0.1 * np.sin(2.0 * times)
    left_rate = 0.55 * np.cos(1.1 * times) + 0.3 * np.cos(3.0 * times)
    right_rate = 0.42 * np.cos(0.7 * times) - 0.2 * np.cos(2.0 * times)
    return np.stack([left, right], -1), np.stack([left_rate, right_rate], -1)


@pytest.mark.parametrize(
    "contact",
    [
        CONTACT,
        CENTRED,
        Contact(Soil(0.5, 0.9, 0.1), GEOMETRY, BODY),
        Contact(Soil(0.7, rolling_resistance=0.05, shear_modulus=0.01), GEOMETRY, BODY),
        Contact(Soil(0.9, 0.6, 0.05, 0.02, resistance_opposes="track"), GEOMETRY, BODY),
    ],
)
def test_at_constant_track_speeds_the_motion_ends_where_the_stationary_solver_says(contact):
    for left, right in [(0.3, 0.6), (0.6, 0.3), (-0.2, 0.5), (0.5, 0.5), (-0.7, -0.4), (0.0, 0.8)]:
        driven = drive(contact, INERTIA, *constant(left, right, 20.0), STEP)
        expected = solve_steady(left, right, contact).twist
        np.testing.assert_allclose(driven.twists[-1], expected, atol=1e-6)
        transfer = steady_inertia(expected, contact.body)[:2]
        np.testing.assert_allclose(driven.transfer[-1], transfer, atol=1e-3)


def test_an_independent_integrator_gives_the_same_motion():
    times = np.arange(0.0, 4.0 + 0.5 * STEP, STEP)
    contact = replace(CONTACT, soil=msgspec.structs.replace(CONTACT.soil, regularising_speed=0.01))
    inverse = np.linalg.inv(mass_matrix(BODY, INERTIA))
    gravity = -GRAVITY * np.sin(np.radians(8.0))

    def rates(time: float, state: np.ndarray) -> np.ndarray:
        twist = PaperTwist(*(np.array([part]) for part in state[:3]))
        (left, right), _ = wavy(np.array(time))
        down = np.array([gravity * np.sin(state[5]), gravity * np.cos(state[5])])
        weight = BODY.mass * np.sqrt(GRAVITY**2 - gravity**2)
        light = msgspec.structs.replace(contact.body, mass=weight / GRAVITY)
        loads = vertical_loads(replace(contact, body=light), state[3], state[4])
        force = track_forces(twist, left, right, contact, loads)[0].values[:, 0]
        pull = BODY.mass * down
        moment = BODY.x_CM * pull[1] - BODY.y_CM * pull[0]
        total = force + steady_inertia(twist, BODY)[:, 0] + np.append(pull, moment)
        return np.concatenate([inverse @ total, (-force[:2] - state[3:5]) / LOAD_LAG, [state[2]]])

    start = (0.0, 0.0, 0.0, 0.0, 0.0, 0.3)
    how = {"method": "Radau", "rtol": 1e-8, "atol": 1e-9}
    reference = solve_ivp(rates, (0.0, 4.0), start, t_eval=times, **how)
    driven = drive(
        contact,
        INERTIA,
        *wavy(times),
        STEP,
        patches=(Patch(slope_deg=8.0),),
        tolerance=1e-8,
        start=start,
    )
    # The track speeds between grid points are a cubic here, and exact there.
    np.testing.assert_allclose(driven.twists, reference.y[:3].T, atol=2e-6)
    np.testing.assert_allclose(driven.transfer, reference.y[3:5].T, atol=2e-2)


def test_a_steep_slippery_slope_lets_the_vehicle_slide():
    angle = np.radians(30.0)
    driven = drive(
        CENTRED,
        INERTIA,
        *constant(0.0, 0.0, 1.0),
        STEP,
        patches=(Patch(slope_deg=30.0, uphill_deg=180.0, friction=0.2),),
    )
    expected = GRAVITY * (np.sin(angle) - 0.2 * np.cos(angle))
    assert driven.twists[-1, 1] == pytest.approx(expected * 1.0, rel=1e-3)


def test_locked_tracks_turn_the_vehicle_toward_the_side_that_grips():
    start = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    for sign, side in ((-1.0, (0.0, 9.0)), (1.0, (-9.0, 0.0))):
        ice = Patch(y=side, edge=0.01, friction=0.05)
        still = constant(0.0, 0.0, 0.1)
        driven = drive(CENTRED, INERTIA, *still, STEP, patches=(ice,), start=start)
        moment = 0.5 * 258.0 * GRAVITY * (0.8 - 0.05) * 0.21
        assert driven.twists[3, 2] == pytest.approx(sign * moment / INERTIA * 0.03, rel=0.1)


def test_a_patch_in_time_is_there_in_its_time_only():
    rougher = Patch(time=(5.0, 10.0), onset=0.5, rolling_resistance=0.3)
    driven = drive(CONTACT, INERTIA, *constant(0.3, 0.6, 20.0), STEP, patches=(rougher,)).twists
    without = drive(CONTACT, INERTIA, *constant(0.3, 0.6, 20.0), STEP).twists
    np.testing.assert_array_equal(driven[:470], without[:470])
    np.testing.assert_allclose(driven[-1], without[-1], atol=1e-6)
    soil = msgspec.structs.replace(CONTACT.soil, rolling_resistance=0.3)
    there = solve_steady(0.3, 0.6, replace(CONTACT, soil=soil)).twist
    assert np.abs(driven[950] - without[950]).max() > 5e-3
    np.testing.assert_allclose(driven[950], there, atol=1e-4)


def test_a_payload_moves_the_centre_of_mass_while_it_is_there():
    driven = loaded(mass=100.0, position=(-0.2, 0.05, 0.5))
    with_load = Body(
        358.0,
        (258.0 * -0.015 - 100.0 * 0.05) / 358.0,
        (258.0 * 0.04 - 100.0 * 0.2) / 358.0,
        (258.0 * 0.3 + 100.0 * 0.5) / 358.0,
    )
    there = solve_steady(0.3, 0.6, replace(CONTACT, body=with_load)).twist
    bare = solve_steady(0.3, 0.6, CONTACT).twist
    np.testing.assert_allclose(driven[1499], there, atol=1e-5)
    np.testing.assert_allclose(driven[[499, -1]], [bare, bare], atol=1e-5)


def test_tracks_follow_their_commands_with_a_lag():
    times = STEP * np.arange(501)
    ramp = np.stack([times, np.sin(times)], axis=-1)
    speeds, rates = follow(ramp, STEP, 0.2)
    np.testing.assert_allclose(speeds[:, 0], times - 0.2 * -np.expm1(-times / 0.2), atol=1e-12)
    behind = (np.sin(times) - 0.2 * np.cos(times) + 0.2 * np.exp(-times / 0.2)) / (1.0 + 0.04)
    np.testing.assert_allclose(speeds[:, 1], behind, atol=1e-5)
    np.testing.assert_allclose(np.gradient(speeds, STEP, axis=0)[5:-5], rates[5:-5], atol=1e-3)
    at_once, _ = follow(ramp, STEP, 0.0)
    np.testing.assert_array_equal(at_once, ramp)


def run(truth: FrictionTruth, name: str = "random", seed: int = 3, duration: float = 40.0):
    robot = load_robot("auriga-alpha")
    command = make_trajectory(name, duration, robot, np.random.default_rng(seed))
    return truth.run(command, duration, robot, np.random.default_rng(seed), rate=200.0)


def test_the_truth_stands_still_at_first_and_then_drives():
    motion = run(FrictionTruth())
    assert motion.source == "friction"
    assert motion.gravity is None
    assert motion.parameters is None
    assert not motion.twists[: 3 * 200].any()
    assert np.hypot(*motion.poses[-1, :2]) > 2.0
    # The body moves forward and slides sideways; it follows the mean of the tracks.
    ahead = motion.twists[:, 0] - motion.track_speeds.mean(axis=1)
    assert np.abs(ahead).max() < 0.3


def test_a_drawn_contact_differs_from_the_file_by_its_spread():
    robot = load_robot("auriga-alpha")
    assert draw_contact(robot, 0.0, np.random.default_rng(1)) == contact_of(robot)
    friction = [
        draw_contact(robot, 0.15, np.random.default_rng(seed)).soil.friction for seed in range(200)
    ]
    spread = np.std(np.log(np.array(friction) / contact_of(robot).soil.friction))
    assert spread == pytest.approx(0.15, rel=0.15)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Patch(x=(1.0, 0.0)), "x of a patch must rise"),
        (lambda: Patch(slope_deg=70.0), "slope_deg of a patch must be between 0 and 60"),
        (lambda: Patch(x=(1.0, 3.0)), "a patch changes nothing; give it friction, rolling"),
        (lambda: Payload(time=(1.0, 0.0), mass=1.0), "time of a payload must rise"),
        (lambda: Payload(time=(0.0, 1.0), mass=1.0, position=(0, 0, -1.0)), "below the ground"),
        (lambda: loaded(mass=1000.0, position=(0.0, 1.0, 0.5)), "cannot stand with its payload"),
    ],
)
def test_nonsense_is_refused(make, message):
    with pytest.raises(SimulationError, match=message):
        make()


def loaded(**payload: object) -> np.ndarray:
    """Twists of a bend with a payload from 5 to 15 s."""
    there = Payload(time=(5.0, 15.0), **payload)
    return drive(CONTACT, INERTIA, *constant(0.3, 0.6, 25.0), STEP, payloads=(there,)).twists
