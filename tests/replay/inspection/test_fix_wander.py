"""Wander of the fixes as `inspect` finds it: against odometry, or not at all."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

from icreckon import EncoderSpec, FixSpec, Log, Scenario, inspect, load_robot, simulate, write_log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import PoseSeries, Truth
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.replay.estimates.fix_wander import FixWanderEstimate, estimate_wander, fit_fixes
from icreckon.replay.estimates.imu_mounting import YawRates

ALPHA = load_robot("auriga-alpha")
GPS = FixSpec(sigma=0.3, wander_sigma=1.2, wander_time=60.0)


@cache
def driven(fixes: FixSpec, seed: int = 1, seconds: float = 600.0) -> Log:
    scenario = Scenario(duration=seconds, seed=seed, fix_rate=1.0, fixes=fixes, truth="kinematic")
    return simulate(scenario, ALPHA)


def yaw_rates(log: Log) -> YawRates:
    return YawRates(log.imu.stamps, SensorModels(ALPHA).yaw_rates(log.imu.angular_velocity))


def found_in(log: Log) -> FixWanderEstimate | str:
    return estimate_wander(log, yaw_rates(log))


def test_wander_is_found() -> None:
    found = found_in(driven(GPS, 1))
    assert not found.reason
    # Ten minutes are some ten times the correlation time.
    assert 0.5 * 1.2 < found.sigma < 2.0 * 1.2
    assert found.times[0] <= 60.0
    assert 0.15 < found.white < 0.45


def test_an_antenna_off_the_centre_is_found_and_is_no_wander(tmp_path: Path) -> None:
    """Its place turns with the robot."""
    log = driven(FixSpec(sigma=0.02), seconds=250.0)
    at = log.fixes.stamps
    arm = (-1.0 + 0.5j) * np.exp(1j * interpolate_poses(log.truth.poses, at)[:, 2])
    moved = log.fixes.poses + np.column_stack([arm.real, arm.imag, np.zeros(len(at))])
    log = replace(log, fixes=replace(log.fixes, poses=moved))
    found = found_in(log)
    assert found.reason
    assert found.sigma < 0.5
    text = inspect(write_log(log, tmp_path / "bag", "mcap", ALPHA)).proposed_robot_file
    place = re.search(r"^position = \[(\S+), (\S+)\]", text, re.MULTILINE).groups()
    # The robot turns about a point 0.1 m behind its middle.
    assert [*map(float, place)] == pytest.approx([-1.0, 0.5], abs=0.12)


@pytest.mark.parametrize("sigma", [0.05, 0.3])
def test_white_noise_and_the_errors_of_odometry_are_no_wander(sigma: float) -> None:
    found = found_in(driven(FixSpec(sigma=sigma), 1))
    assert found.reason
    assert "no wander is proposed" in found.text


def test_what_fixes_do_not_state_is_neither_evidence_nor_kept(tmp_path: Path) -> None:
    log = driven(FixSpec(sigma=0.01, wander_sigma=0.3, wander_time=20.0))
    coarse = np.full_like(log.fixes.variances, 0.09)
    stating = replace(log, fixes=replace(log.fixes, variances=coarse))
    assert not found_in(stating).reason
    assert estimate_wander(stating, yaw_rates(log), states_sigma=False).reason
    # Poses without covariances, of which all noise is white.
    log = driven(FixSpec(sigma=0.2), seconds=250.0)
    slam = PoseSeries(log.fixes.stamps, np.nan_to_num(log.fixes.poses))
    robot = msgspec.structs.replace(ALPHA, log=ALPHA.log | {"truth": {"topic": "/slam/pose"}})
    bag = write_log(replace(log, truth=Truth(slam), fixes=None), tmp_path / "bag", "mcap", robot)
    (line,) = re.findall("^position_sigma = .*", inspect(bag).proposed_robot_file, re.MULTILINE)
    assert float(line.split()[2]) == pytest.approx(0.2, rel=0.15)


@pytest.mark.thorough
def test_inspect_proposes_what_a_replay_accepts(tmp_path: Path) -> None:
    found = inspect(write_log(driven(GPS), tmp_path / "gps", "mcap", ALPHA))
    assert any("fixes: their error wanders" in finding for finding in found.findings)
    text = found.proposed_robot_file
    assert text.count("position_sigma") == 1
    path = tmp_path / "robot.toml"
    filled = text.replace("mass = nan", "mass = 200.0").replace("gauge = nan", "gauge = 0.6")
    path.write_text(filled.replace("radius = nan", "radius = 0.1"), encoding="utf-8")
    proposed = load_robot(path).log["fixes"]
    assert 0.6 < proposed["wander_sigma"] < 2.4
    assert proposed["wander_time"] > 0.0


@pytest.mark.parametrize(("stated", "proposed"), [(1.0, True), (0.05, False), (10.0, True)])
def test_fixes_that_state_more_than_they_scatter_wander(stated: float, proposed: bool) -> None:
    """Here odometry may be off by as much; only what a receiver states tells the two apart."""
    log = driven(FixSpec(sigma=0.02, wander_sigma=0.8, wander_time=60.0), seed=3)
    variances = log.fixes.variances.copy()
    variances[:, 0] = stated**2
    faster = replace(log, fixes=replace(log.fixes, variances=variances))
    found = found_in(faster)
    assert (not found.reason) == proposed
    assert ("that they state" in found.text) == proposed


def test_fixes_that_come_late_are_found_with_their_antenna_and_the_scale() -> None:
    log = simulate(
        Scenario(duration=240.0, seed=3, trajectory="stop-and-go", fix_rate=5.0, truth="kinematic",
                 fixes=FixSpec(sigma=0.02), encoders=EncoderSpec(scale_sigma=0.0)),
        ALPHA,
    )  # fmt: skip
    in_time = fit_fixes(log, yaw_rates(log))
    assert not in_time.is_late
    late = replace(log, fixes=replace(log.fixes, stamps=log.fixes.stamps + 300_000_000))
    found = fit_fixes(late, yaw_rates(log))
    assert found.is_late
    assert found.lag == pytest.approx(0.3, abs=0.03)
    assert found.place == pytest.approx(in_time.place, abs=0.03)
    assert found.scale == pytest.approx(1.0, abs=0.02)
