"""Cells of a study: one scenario, one true robot, and each filter's robot model."""

import itertools
import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base.checks import is_finite
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.base.plain_data import flatten
from icreckon.estimator.filter.initial_state import assumptions
from icreckon.estimator.robot.robot_file import Robot, changed_robot, load_robot
from icreckon.estimator.robot.settings import FixWander, Settings
from icreckon.estimator.robot.variants import find_variant
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.scenario import Scenario, change_scenario, errors_of
from icreckon.simulation.sensors.imu import InertialErrors
from icreckon.simulation.study.plan import MOST_CELLS, LatinHypercube, Study, nest
from icreckon.simulation.truth.terrain import NEEDS, Terrain, refuse_idle_keys

# Roots of dotted keys outside the scenario.
ROBOT, TRUE_ROBOT, FILTER = "robot", "true_robot", "filter"
ROBOTS = (ROBOT, TRUE_ROBOT, FILTER)
OUTAGE = "outage"
LEAST_NOISE = 1e-9  # A filter takes no noise of exactly zero
LOG_SPAN = 20.0  # least ratio of a grid's largest value to its smallest for a logarithmic axis

Scale = Literal["linear", "log", "names"]
Value = str | float | bool


@dataclass(frozen=True)
class Axis:
    """Axis of a sweep."""

    name: str  # the dotted key, or the name of the cases
    scale: Scale  # scale of its values in figures
    values: tuple[Value, ...]  # all values, as in the study; ascending for a Latin hypercube
    sampled: bool = False  # True for an axis of a Latin hypercube, where each value occurs once


@dataclass(frozen=True)
class Filter:
    """Filter in a cell: its label, variant, settings, and robot model."""

    label: str
    variant: str
    robot: Robot
    settings: Settings


@dataclass(frozen=True)
class Cell:
    """Point of a sweep."""

    index: int  # index of the cell, from 0
    values: dict[str, Value]  # axis -> value, one for each axis
    scenario: Scenario  # scenario of the runs, with the study's seed
    robot: Robot  # the true robot
    filters: tuple[Filter, ...]  # filters of the study, in its order
    truths: int  # number of distinct true motions; run r drives true motion r modulo this
    horizons: tuple[float, ...]  # lengths of the segments over which drift is scored [s]


@dataclass(frozen=True)
class Plan:
    """Study with its axes and cells."""

    study: Study
    axes: tuple[Axis, ...]
    cells: tuple[Cell, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the filters."""
        return tuple(spec.label for spec in self.study.filters())


class _Point(NamedTuple):
    """Point of an axis or a Latin hypercube."""

    values: dict[str, Value]  # axis -> value
    changes: dict[str, Any]  # dotted key -> value


def expand(study: Study) -> Plan:
    """Expand a study to its plan.

    Raises:
        SimulationError: an unknown dotted key (the message names the nearest), an invalid cell, or a key
            of the scenario's terrain that acts in no cell.
        EstimatorError: no such robot.
    """
    robot = changed_robot(load_robot(study.robot), flatten(study.robot_changes), "robot_changes")
    axes, dimensions = _dimensions(study)
    count = math.prod(len(points) for points in dimensions)
    if count > MOST_CELLS:
        raise SimulationError(
            f"the sweep has {count} cells, more than {MOST_CELLS}; give fewer values, or latin"
        )
    cells = []
    for index, points in enumerate(itertools.product(*dimensions)):
        values: dict[str, Value] = {}
        changes: dict[str, Any] = {}
        for point in points:
            values |= point.values
            changes |= point.changes
        cells.append(_cell(study, robot, index, values, changes))
    terrain, default = study.scenario.terrain, Terrain()
    set_keys = [key for key in NEEDS if getattr(terrain, key) != getattr(default, key)]
    refuse_idle_keys([cell.scenario.terrain for cell in cells], set_keys, "scenario")
    return Plan(study, axes, tuple(cells))


def _dimensions(study: Study) -> tuple[tuple[Axis, ...], list[list[_Point]]]:
    """Axes, and the points of each dimension: grid, cases, a Latin hypercube."""
    sweep = study.sweep
    axes: list[Axis] = []
    dimensions: list[list[_Point]] = []
    if sweep is None:
        return (), []
    for key, raw_values in sweep.grid.items():
        # Lists become text for tables and figures.
        values = tuple(
            value if isinstance(value, str | int | float | bool) else str(value)
            for value in raw_values
        )
        axes.append(Axis(key, _scale_of(values), values))
        pairs = zip(values, raw_values, strict=True)
        dimensions.append([_Point({key: value}, {key: raw}) for value, raw in pairs])
    for axis, changes_by_case in sweep.cases.items():
        axes.append(Axis(axis, "names", tuple(changes_by_case)))
        cases = changes_by_case.items()
        dimensions.append([_Point({axis: case}, changes) for case, changes in cases])
    if sweep.latin is not None:
        points = latin_points(sweep.latin, study.seed)
        for key, (_, _, *scale) in sweep.latin.ranges.items():
            rising = tuple(sorted(point[key] for point in points))
            axes.append(Axis(key, "log" if scale == ["log"] else "linear", rising, sampled=True))
        dimensions.append([_Point(dict(point), dict(point)) for point in points])
    return tuple(axes), dimensions


def latin_points(latin: LatinHypercube, seed: int) -> list[dict[str, float]]:
    """Points of a Latin hypercube by a seed: dotted key -> value, of six digits."""
    from scipy.stats import qmc

    ranges = latin.ranges
    sampler = qmc.LatinHypercube(len(ranges), seed=np.random.default_rng([seed, len(ranges)]))
    shares = sampler.random(latin.points)  # (points, keys) from 0 to 1
    points: list[dict[str, float]] = [{} for _ in shares]
    for (key, (lowest, highest, *scale)), share in zip(ranges.items(), shares.T, strict=True):
        low, high = float(lowest), float(highest)
        column = low * (high / low) ** share if scale == ["log"] else low + (high - low) * share
        for point, value in zip(points, column.tolist(), strict=True):
            point[key] = float(f"{value:.6g}")
    return points


def _with_wander(settings: Settings, robot: Robot, scenario: Scenario) -> Settings:
    """Settings with the wander of the scenario's fixes, unless they have one."""
    errors = errors_of(scenario, robot).fixes
    if settings.wander is not None:
        return settings
    if errors.wander_sigma > 0.0:
        wander = FixWander(errors.wander_sigma, errors.wander_time)
        return msgspec.structs.replace(settings, wander=wander)
    # The wander of a robot file is that of the fixes of its logs, not of simulated ones.
    file_has_wander = FixWander.of(robot).sigma > 0.0
    return msgspec.structs.replace(settings, wander=FixWander()) if file_has_wander else settings


def _cell(
    study: Study, robot: Robot, index: int, values: dict[str, Value], changes: dict[str, Any]
) -> Cell:
    """Cell of a study from its changes (dotted key -> value) of scenario and robots."""
    robot_changes: dict[str, dict[str, Any]] = {root: {} for root in ROBOTS}
    scenario_changes = {}
    for key, value in changes.items():
        root = _root(key)
        if root in ROBOTS:
            robot_changes[root][key.removeprefix(f"{root}.")] = value
        else:
            scenario_changes[key] = value
    scenario = _changed_scenario(study, scenario_changes)
    robot = changed_robot(robot, robot_changes[ROBOT], ROBOT)
    true_robot = changed_robot(robot, robot_changes[TRUE_ROBOT], TRUE_ROBOT)
    modelled = _with_noise_of(robot, true_robot, scenario) if study.filters_know_noise else robot
    modelled = changed_robot(modelled, robot_changes[FILTER], FILTER)
    filters = []
    for spec in study.filters():
        own_robot = changed_robot(modelled, flatten(spec.robot), f"robot of {spec.label}")
        settings = _with_wander(spec.made_settings(), own_robot, scenario)
        assumptions(own_robot, find_variant(spec.variant), settings)  # raises if they do not fit
        filters.append(Filter(spec.label, spec.variant, own_robot, settings))
    truths, horizons = study.truths, study.horizons
    return Cell(index, values, scenario, true_robot, tuple(filters), truths, horizons)


def _with_noise_of(robot: Robot, true_robot: Robot, scenario: Scenario) -> Robot:
    """Robot file with the noise of the simulated IMU and encoders."""
    encoders, gyro, force, _ = errors_of(scenario, true_robot)
    # The file's noise includes vibration and slopes.
    accelerometer_noise = max(force.noise_density, robot.imu.accelerometer_noise_density)
    changes = {
        "imu.gyro_noise_density": max(gyro.noise_density, LEAST_NOISE),
        "imu.gyro_bias_sigma": gyro.bias_sigma,
        "imu.gyro_bias_walk": _total_walk(gyro),
        "imu.gyro_scale_sigma": gyro.scale_sigma,
        "imu.accelerometer_noise_density": accelerometer_noise,
        "imu.accelerometer_bias_sigma": force.bias_sigma,
        "imu.accelerometer_bias_walk": _total_walk(force),
        "tracks.speed_noise_density": encoders.speed_noise_density,
        "tracks.scale_sigma": encoders.scale_sigma,
        "tracks.difference_sigma": encoders.scale_difference_sigma,
    }
    return changed_robot(robot, changes)


def _total_walk(errors: InertialErrors) -> float:
    """Density of a random walk as large as a bias' walk and its instability together."""
    # The instability is a Gauss-Markov process: over short times it grows like a walk.
    instability = errors.bias_instability * math.sqrt(2.0 / errors.bias_instability_time)
    return math.hypot(errors.bias_walk, instability)


def _root(key: str) -> str:
    """Root of a dotted key; a SimulationError if there is nothing to change by it."""
    root, _, rest = key.partition(".")
    allowed = [*(name for name in Scenario.__struct_fields__ if name != "seed"), OUTAGE, *ROBOTS]
    if root not in allowed:
        hint = nearest_hint(root, allowed)
        raise SimulationError(f"sweep: nothing to change by {key!r}: no {root!r}{hint}")
    if root in ROBOTS and not rest:
        raise SimulationError(
            f"sweep: {key!r} is a table; give a key in it, as {root}.vehicle.mass"
        )
    return root


def _changed_scenario(study: Study, changes: dict[str, Any]) -> Scenario:
    """Scenario of a study with changes (dotted key -> value) and the study's seed.

    `OUTAGE` is the length [s] of one outage, at the end of the run; 0 for none.
    """
    outage = changes.pop(OUTAGE, None)
    if outage is not None and "outages" in changes:
        raise SimulationError("sweep: outage and outages exclude each other; leave one out")
    nested = nest(changes) | {"seed": study.seed}
    scenario = change_scenario(study.scenario, nested, f"sweep of {study.name}")
    if outage is None:
        return scenario
    end = scenario.duration
    if not (is_finite(outage) and 0.0 <= outage <= end):
        raise SimulationError(
            f"outage must be from 0 to the duration of the run, {end:g} s, found {outage!r}"
        )
    outages = ((end - float(outage), end),) if outage else ()
    return msgspec.structs.replace(scenario, outages=outages)


def _scale_of(values: tuple[Value, ...]) -> Scale:
    """Scale of an axis of the grid: "names" unless all values are numbers."""
    numbers = [float(value) for value in values if is_finite(value)]
    if len(numbers) < len(values):
        return "names"
    low, high = min(numbers), max(numbers)
    return "log" if low > 0.0 and high / low >= LOG_SPAN else "linear"
