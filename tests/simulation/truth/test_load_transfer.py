"""What the height of the centre of mass does to a turn on a slope, and what filters expect of it."""

import msgspec
import numpy as np
import pytest

from icreckon import Scenario, Terrain, load_robot
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import Indices
from icreckon.estimator.robot.soil import Soil
from icreckon.estimator.robot.variants import (
    VARIANTS,
    coulomb_gains,
    initial_parameters,
    motion_model,
)
from icreckon.simulation.contact.of_robot import contact_of, slow_turns
from icreckon.simulation.simulate import run_scenario


@pytest.mark.parametrize("name", ["husky", "marmotte", "warthog"])
def test_uphill_the_load_moves_the_icrs_back_by_zeta_F(name: str) -> None:
    """In a bend on a plane; y_ICR is regressed on the slope along and across the robot."""
    robot = load_robot(name)
    eta0 = float(np.mean(slow_turns(contact_of(robot)).eta))
    indices = msgspec.structs.replace(robot.indices, eta0=eta0)
    robot = msgspec.structs.replace(robot, indices=indices, constant_icr=None)
    top, stamps = robot.vehicle.max_track_speed, np.array([0, 2, 100]) * 1_000_000_000
    speeds = np.array([[0.0, 0.0], [0.2 * top, 0.4 * top], [0.2 * top, 0.4 * top]])
    scenario = Scenario(
        duration=102.0,
        terrain=Terrain(slope_deg=3.0),
        trajectory="recorded",
        noise="perfect",
        truth_spread=0.0,
    )
    motion = run_scenario(scenario, robot, recording=TrackSpeedSeries(stamps, speeds)).motion
    moving = slice(round(10.0 * motion.rate), None)
    (_, v_y, w), (forward, left, _) = motion.twists[moving].T, motion.gravity[moving].T / GRAVITY
    forces = np.column_stack([np.ones_like(w), -forward, -left])
    (_, back, _), *_ = np.linalg.lstsq(forces, v_y / w, rcond=None)
    assert back == pytest.approx(coulomb_gains(robot).zeta_F, rel=0.1)


def test_the_load_moves_the_icrs_of_the_inertia_based_model_alone() -> None:
    robot = load_robot("warthog")
    assert coulomb_gains(robot).zeta_F > 0.5
    for variant in VARIANTS.values():
        zeta_F = motion_model(robot, variant).vehicle.zeta_F
        assert zeta_F == (coulomb_gains(robot).zeta_F if variant.model == "inertia" else 0.0)


def test_a_robot_without_indices_has_the_gains_of_friction() -> None:
    """It slips in turns, too: its effective track is learnt, and its gains begin with these."""
    robot = msgspec.structs.replace(load_robot("warthog"), indices=Indices(), constant_icr=None)
    slips = msgspec.structs.replace(robot, indices=Indices(eta0=1.001))
    assert coulomb_gains(robot) == coulomb_gains(slips)
    parameters = initial_parameters(robot, VARIANTS["inertia-online"])
    assert parameters[[2, 8]].tolist() == [*coulomb_gains(robot)[:2]]
    assert (parameters[[2, 8]] > 0.0).all()


def test_filters_assume_the_ground_that_moves_the_simulated_robot() -> None:
    """A file without [soil], or with a part of it: simulated without resistance, bends drifted twice."""
    bare = load_robot("husky")
    assert contact_of(bare).soil.rolling_resistance == bare.constants.rolling_resistance > 0.0
    icy = msgspec.structs.replace(bare, soil=msgspec.convert({"friction": 0.2}, Soil))
    assert icy.constants.rolling_resistance == bare.constants.rolling_resistance
