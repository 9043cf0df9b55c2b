"""Calibration with a truth of positions alone: what it shows of the gyro, and what it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conftest import thorough
from icreckon.estimator.calibration import calibrate
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import run_scenario

ROBOT = load_robot("auriga-alpha")
SCALE, BIAS = 1.02, 0.012


@pytest.mark.parametrize("drive", ["aggressive", thorough("random")])
def test_the_gyro_is_not_compared_with_headings_that_it_made(drive: str) -> None:
    """Its scale came out as 1.000 ± 0.004 where it was 1.02, since the headings were its own."""
    scenario = Scenario(duration=90.0, trajectory=drive, seed=3, fix_rate=0.0, truth="kinematic")
    made = run_scenario(scenario, ROBOT)
    imu, truth = made.log.imu, made.log.truth
    assert imu is not None
    assert truth is not None
    rates = SCALE * imu.angular_velocity + np.array([0.0, 0.0, BIAS])
    read = replace(imu, angular_velocity=rates)
    log = replace(made.log, imu=read, truth=truth.positions_alone())
    found = calibrate([log], ROBOT, models=("constant",))
    scale, bias = found.parameter("imu.gyro_scale"), found.parameter("imu.gyro_bias")
    assert scale.sigma is not None
    assert scale.value == pytest.approx(SCALE, abs=2.5 * scale.sigma)
    true = BIAS / SCALE + float(np.mean(made.gyro_bias[:, 2]))
    assert bias.value == pytest.approx(true, abs=1e-3)
    assert scale.sigma > 0.004
    assert any("Of the gyro such headings show nothing" in note for note in found.notes)
