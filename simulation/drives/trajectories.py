"""Commanded track speeds over time, by name.

Every trajectory stands still for `icreckon.simulation.drives.smooth_speeds.STANDSTILL` seconds, then
drives with continuous speed and acceleration. Each track stays within `max_track_speed` and, unless it is
recorded, within the acceleration `icreckon.simulation.drives.smooth_speeds.ACCELERATION`. A trajectory is
a function of time, so it does not depend on how it is sampled. `icreckon.simulation.drives.drives`
describes each trajectory and its options.
"""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

import msgspec
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.checks import Bound
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.drives.drives import TRAJECTORIES
from icreckon.simulation.drives.recorded import Recorded, recorded
from icreckon.simulation.drives.smooth_speeds import Blends, Slalom

RECORDED = "recorded"
ROUNDING = 1e-9  # rounding error by which a speed may exceed max_track_speed, relative to it


# Track speeds (n, 2) left, right [m/s] at times (n,) [s] since the start.
Command = Callable[[Floats], Floats]
# Pairs of options of which the first must not exceed the second.
ORDERED = {"arcs": ("tightest", "widest"), "slalom": ("lowest", "highest")}


def trajectory_names() -> list[str]:
    """Names of all trajectories: the generated ones and "recorded"."""
    return [*TRAJECTORIES, RECORDED]


def trajectory_options(name: str) -> dict[str, float | None]:
    """Options of a trajectory with defaults; None stands for the robot file's value."""
    parameters = inspect.signature(_generator(name)).parameters.values()
    options = [option for option in parameters if option.kind is option.KEYWORD_ONLY]
    return {option.name: option.default for option in options}


def check_trajectory(
    name: str, options: Mapping[str, float], recording: object | None = None
) -> None:
    """Reject a name, options or a recording (or its file) that give no trajectory.

    Raises:
        SimulationError: an unknown trajectory or option (the message names the nearest); a value that
            is not allowed, alone or in combination; a recording for a trajectory that uses none.
    """
    if name not in trajectory_names():
        hint = nearest_hint(name, trajectory_names())
        raise SimulationError(f"no trajectory named {name!r}{hint}")
    if recording is not None and name != RECORDED:
        raise SimulationError(
            f"a recording was given, but trajectory = {name!r}; set trajectory = {RECORDED!r}"
        )
    defaults = trajectory_options(name)
    types = get_type_hints(_generator(name), include_extras=True)
    for option, value in options.items():
        if option not in defaults:
            hint = nearest_hint(option, list(defaults))
            raise SimulationError(f"trajectory {name!r} has no option {option!r}{hint}")
        try:
            msgspec.convert(value, types[option])
        except msgspec.ValidationError as problem:
            raise SimulationError(
                f"option {option!r} of trajectory {name!r} cannot be {value!r}: {problem}"
            ) from None
        Bound("finite").require(f"option {option!r} of trajectory {name!r}", value, SimulationError)
    _check_together(name, {**defaults, **options})


def _check_together(name: str, options: dict[str, Any]) -> None:
    """Reject options of a trajectory, each of them valid, that contradict each other."""
    if name in ORDERED:
        low, high = ORDERED[name]
        if options[low] > options[high]:
            raise SimulationError(
                f"trajectory {name!r}: {low} = {options[low]!r} is more than {high} = "
                f"{options[high]!r}; give both, the smaller one as {low}"
            )
    if name == "random" and options["reverse"] + options["stop"] > 1.0:
        raise SimulationError(
            "trajectory 'random': reverse and stop are shares of all manoeuvres, together at most 1, "
            f"found {options['reverse']!r} and {options['stop']!r}"
        )
    if name == "figure-eight" and options["turn"] == 0.0:
        raise SimulationError(
            "option 'turn' of trajectory 'figure-eight' cannot be 0.0: no circle would close"
        )


def make_trajectory(
    name: str,
    duration: float,
    robot: Robot,
    rng: Generator,
    options: Mapping[str, float] | None = None,
    recording: TrackSpeedSeries | None = None,
) -> Command:
    """Make the commanded track speeds of a trajectory for a `duration` [s].

    Options are those of `trajectory_options`; a recording is for "recorded" alone. `rng` draws the random
    parts of the others.

    Raises:
        SimulationError: as in `check_trajectory`; a missing or invalid recording; or speeds beyond the
            robot's max_track_speed.
    """
    options = options or {}
    check_trajectory(name, options, recording)
    if name != RECORDED:
        command = _generator(name)(duration, robot, rng, **options)
    elif recording is not None:
        command = recorded(recording, **options)
    else:
        raise SimulationError(
            f"trajectory {RECORDED!r} needs trajectory_file, a CSV file with columns t, left, right"
        )
    top = robot.vehicle.max_track_speed
    if command.top_speed > top * (1.0 + ROUNDING):
        speeds = [key for key in trajectory_options(name) if key in ("speed", "turn", "factor")]
        raise SimulationError(
            f"trajectory {name!r} reaches {command.top_speed:.3g} m/s, more than max_track_speed = "
            f"{top!r} m/s of {robot.name!r}; raise that, or lower {' or '.join(speeds)}"
        )
    return command


def _generator(name: str) -> Callable[..., Recorded | Blends | Slalom]:
    """Function of a known trajectory; its keyword-only arguments are the options."""
    return recorded if name == RECORDED else TRAJECTORIES[name]
