"""Inputs of a cell: numbers that its true motion, sensors and filters in fact use.

Keys of scenario, robot file and settings are resolved to their effect in this cell. Numbers without
effect are left out: parameters of a disabled sensor, indices if friction is the truth, a mass that
cancels. So two cells of equal inputs have equal results, to rounding.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.filter.initial_state import assumptions
from icreckon.estimator.log.input_checks import ABSURD_SPEED
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.variants import find_variant
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.drives.trajectories import RECORDED, trajectory_options
from icreckon.simulation.scenario import Scenario, grid_rate
from icreckon.simulation.sensors.specs import (
    accelerometer_errors,
    encoder_errors,
    fix_errors,
    gyro_errors,
    noise_preset,
)
from icreckon.simulation.study.cells import Cell, Filter
from icreckon.simulation.truth.terrain import Terrain

# Numbers that agree to so many digits count as equal: sums in another order differ by more.
DIGITS = 12
# Trajectories whose shape depends on the effective gauge.
WITH_GAUGE = ("figure-eight", "arcs")
# Largest deviation of a track speed reading from the true speed, in standard deviations.
FARTHEST = 50.0

Inputs = dict[str, Any]


def digest_of(inputs: Any) -> str:
    """Digest of inputs; numbers count to `DIGITS` digits."""
    text = json.dumps(_rounded(inputs), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def cell_inputs(cell: Cell) -> Inputs:
    """Inputs of a cell: those of its true motion, its sensors, and each filter."""
    filters = {one.label: filter_inputs(cell, one) for one in cell.filters}
    sensors = _sensors(cell.scenario, cell.robot)
    if not any(found["gyro"][0] or found["gyro"][1] for found in filters.values()):
        # No filter reads the gyro, so its axes do not matter.
        sensors["gyro_axes"] = None
        up = cell.robot.imu_rotation[2].tolist()
        uneven = cell.scenario.patches or cell.scenario.terrain.is_curved
        if not (up[0] or up[1] or uneven):
            # On a plane a gyro square to it turns about z alone.
            del sensors["imu"][1][0]["misalignment_sigma"]
    return {
        "truth": _truth(cell.scenario, cell.robot),
        "sensors": sensors,
        "filters": filters,
    }


def filter_inputs(cell: Cell, one: Filter) -> Inputs:
    """Inputs of a filter in a cell."""
    robot, settings = one.robot, one.settings
    variant = find_variant(one.variant)
    assumed = assumptions(robot, variant, settings)
    sigmas, noise = assumed.sigmas.copy(), assumed.disturbances
    state, walk = assumed.state.copy(), noise.bias_walk.copy()
    # No motion model depends on H.
    state[s.PARAMETERS.start] = 0.0
    forward, left, up = robot.imu_rotation.tolist()
    imu = robot.imu
    only_z = imu.gyro_axes == "z"
    found: Inputs = {
        "gyro": [0.0, 0.0, 1.0 / (up[2] * imu.gyro_scale)]
        if only_z
        else [value / imu.gyro_scale for value in up],
        "gyro_noise": imu.gyro_noise_density,
        "track_noise": robot.tracks.speed_noise_density,
        "slip": msgspec.to_builtins(noise.slip),
        "parameter_walk": noise.parameter_walk.tolist(),
        "slope_walk": noise.slope_walk.tolist(),
        "gates": msgspec.to_builtins(settings.gates),
        "standstill": msgspec.to_builtins(settings.standstill),
        "considered": sorted(settings.considered),
        "accelerometer": None,
    }
    if settings.use_accelerometer and find_variant(one.variant).accelerometers:
        place = imu.position[:2]
        found["accelerometer"] = [forward, left, imu.accelerometer_noise_density, list(place)]
    else:
        biases = [s.ACCELEROMETER_BIAS_X, s.ACCELEROMETER_BIAS_Y]
        state[biases] = sigmas[biases] = walk[biases] = 0.0
    if _has_gaps(cell, one):
        found["gaps"] = [
            settings.hold,
            settings.gap_acceleration,
            settings.longest_gap,
            robot.vehicle.max_track_speed,
        ]
    found |= {"bias_walk": walk.tolist(), "sigmas": sigmas.tolist()}
    return found | _motion(one, state, sigmas)


def _motion(one: Filter, state: Any, sigmas: Any) -> Inputs:
    """Inputs of a filter's motion model, and the initial state."""
    robot = one.robot
    parameters, spread = state[s.PARAMETERS], sigmas[s.PARAMETERS]
    gauge = robot.vehicle.track_gauge
    gains = [2, 4, 6, 7, 8]
    is_linear = find_variant(one.variant).model == "linear"
    if not (is_linear or parameters[gains].any() or spread[gains].any()):
        eta = 5
        if not spread[eta]:
            # Constant ICRs act through the distance between them.
            gauge, parameters[eta] = gauge * parameters[eta], 1.0
        return {"model": "constant", "gauge": gauge, "state": state.tolist()}
    return {
        "model": [find_variant(one.variant).model, *robot.constants],
        "state": state.tolist(),
    }


def _has_gaps(cell: Cell, one: Filter) -> bool:
    """Return True if track speeds can become stale, or be rejected as implausible."""
    scenario, settings = cell.scenario, one.settings
    errors = encoder_errors(cell.robot, scenario.encoders, noise_preset(scenario.noise))
    slowest = 1.0 / min(scenario.track_rate, scenario.imu_rate)
    scales = 1.0 + FARTHEST * (errors.scale_sigma + errors.scale_difference_sigma)
    fastest = cell.robot.vehicle.max_track_speed * scales + errors.resolution * scenario.track_rate
    fastest += FARTHEST * errors.speed_noise_density * np.sqrt(scenario.track_rate)
    return bool(
        errors.dropouts_per_hour > 0.0
        or slowest > 0.5 * min(settings.hold, settings.longest_gap)
        or fastest > ABSURD_SPEED * one.robot.vehicle.max_track_speed
    )


def _truth(scenario: Scenario, robot: Robot) -> Inputs:
    name, vehicle = scenario.trajectory, robot.vehicle
    options = trajectory_options(name) | scenario.trajectory_options
    gauge = vehicle.track_gauge * robot.indices.eta0
    found: Inputs = {
        "trajectory": name,
        "options": options,
        "duration": scenario.duration,
        "grid": grid_rate(scenario.imu_rate),
    }
    if name == RECORDED:
        found["file"] = str(Path(scenario.trajectory_file or ""))
    else:
        found["top_speed"] = vehicle.max_track_speed
    if name in WITH_GAUGE:
        found["effective_gauge"] = gauge
    if name == "spin" and options["ratio"] is None:
        found["H"] = robot.indices.H
    truth: Any = scenario.make_truth()
    found |= {"truth": truth.name, "spread": truth.spread, "slip_noise": truth.slip_noise}
    if truth.name == "kinematic":
        indices = robot.indices.as_array().tolist()[1:]
        # Draws with several motions are drawn again.
        range_of_draws = vehicle.max_track_speed if truth.spread else 0.0
        return found | {"indices": indices, "vehicle": [*robot.constants], "range": range_of_draws}
    mass = vehicle.mass
    found |= {
        "contact": _contact(contact_of(robot)),
        "yaw_inertia_per_mass": robot.yaw_inertia / mass,
        "load_lag": vehicle.load_lag,
        "track_lag": truth.track_lag,
        "terrain": None if truth.terrain is None else _terrain(truth.terrain),
        "patches": msgspec.to_builtins(truth.patches),
        # Forces of friction and inertia both grow with the mass, which cancels unless it changes.
        "payloads": [mass, msgspec.to_builtins(truth.payloads)] if truth.payloads else None,
    }
    if truth.terrain is not None and truth.terrain.kerb_height:
        found["contact_length"] = vehicle.half_contact_length
    if truth.slip_noise:
        found["effective_gauge"] = gauge
    return found


def _terrain(terrain: Terrain) -> Inputs:
    """Inputs of ground that is not level."""
    found: Inputs = {"uphill": terrain.uphill_deg, "slope": terrain.slope_deg}
    if terrain.rolling_deg:
        found["rolling"] = [terrain.rolling_deg, terrain.wavelength]
    if terrain.kerb_height:
        found["kerbs"] = [terrain.kerb_height, terrain.kerb_every]
    return found


def _contact(contact: Any) -> Inputs:
    """Inputs of a contact, except the mass."""
    soil, body = msgspec.to_builtins(contact.soil), contact.body
    soil["longitudinal_friction"] = list(contact.soil.coefficients)
    geometry = msgspec.to_builtins(contact.geometry)
    return {"soil": soil, "geometry": geometry, "centre": [body.x_CM, body.y_CM, body.z_CM]}


def _sensors(scenario: Scenario, robot: Robot) -> Inputs:
    preset, imu = noise_preset(scenario.noise), robot.imu
    encoders = msgspec.to_builtins(encoder_errors(robot, scenario.encoders, preset))
    if not encoders["dropouts_per_hour"]:
        del encoders["dropout_duration"], encoders["dropout_reads"]
    inertial = []
    for errors in (
        gyro_errors(robot, scenario.gyro, preset),
        accelerometer_errors(robot, scenario.accelerometer, preset),
    ):
        figures = msgspec.to_builtins(errors)
        if not errors.bias_instability:
            del figures["bias_instability_time"]
        inertial.append(figures)
    fixes = None
    if scenario.fix_rate:
        figures = msgspec.to_builtins(fix_errors(scenario.fixes, preset))
        if not figures["outlier_share"]:
            del figures["outlier_sigma"]
        if not figures["wander_sigma"]:
            del figures["wander_sigma"], figures["wander_time"]
        fixes = [scenario.fix_rate, scenario.outages, figures]
    return {
        "encoders": [scenario.track_rate, encoders],
        "imu": [scenario.imu_rate, inertial, imu.gyro_scale],
        "gyro_axes": imu.gyro_axes,
        "mounting": [robot.imu_rotation.tolist(), list(imu.position)],
        "fixes": fixes,
        "scored": scenario.truth_rate,
    }


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return value
    # Minus zero is zero.
    return float(f"{float(value):.{DIGITS}g}") + 0.0
