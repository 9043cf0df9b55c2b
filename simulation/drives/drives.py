"""Trajectory generators: functions from options to commanded track speeds.

Their keyword arguments are the options of a trajectory (`icreckon.simulation.drives.trajectories`); the
types state the allowed values. Each fills a `duration` [s], takes max_track_speed, gauge and indices from
the `robot`, and draws random speeds and durations from `rng`. Speeds are shares of max_track_speed, so
that each trajectory fits any robot. Random trajectories are drawn event by event, so a longer one begins
like the shorter one of the same seed.
"""

from collections.abc import Callable
from itertools import cycle
from typing import Annotated

import msgspec
import numpy as np
from numpy.random import Generator

from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.drives.smooth_speeds import (
    ACCELERATION,
    SHORTEST_BLEND,
    STANDSTILL,
    STEEPEST,
    Blends,
    Slalom,
    blend_duration,
    blends,
)

# Time by which blended edges shorten half a square wave of turning, as a share of an edge's duration.
EDGE_LOSS = 0.3125

Share = Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]
Probability = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]


def straight(_duration: float, robot: Robot, _rng: Generator, *, speed: Share = 0.6) -> Blends:
    """Straight line at a share `speed` of max_track_speed; backward if negative."""
    top = robot.vehicle.max_track_speed
    return blends([(STANDSTILL, speed * top, speed * top)])


def spin(
    _duration: float,
    robot: Robot,
    _rng: Generator,
    *,
    speed: Share = 0.6,
    ratio: Positive | None = None,
) -> Blends:
    """Turn on the spot, V_l = -H V_r, equation (13); to the left if `speed` > 0.

    The faster track has the share `speed` of max_track_speed; `ratio` takes the place of the robot's H.
    """
    H = robot.indices.H if ratio is None else ratio
    right = speed * robot.vehicle.max_track_speed / max(1.0, H)
    return blends([(STANDSTILL, -H * right, right)])


def circle(
    _duration: float, robot: Robot, _rng: Generator, *, speed: Share = 0.5, turn: Share = 0.25
) -> Blends:
    """Circle of mean `speed` and half difference `turn` of the tracks.

    Both are shares of max_track_speed; a positive `turn` is to the left.
    """
    top = robot.vehicle.max_track_speed
    return blends([(STANDSTILL, (speed - turn) * top, (speed + turn) * top)])


def figure_eight(
    duration: float, robot: Robot, _rng: Generator, *, speed: Share = 0.5, turn: Share = 0.25
) -> Blends:
    """Full circles, left and right in turn, for the `eta0` of the robot file.

    Mean `speed` and half difference `turn` of the tracks are shares of max_track_speed. A negative `turn`
    begins to the right; it must not be zero.
    """
    top = robot.vehicle.max_track_speed
    mean, half = speed * top, turn * top
    edge_s = blend_duration(2.0 * half)
    effective_gauge = robot.vehicle.track_gauge * robot.indices.eta0
    circle_s = np.pi * effective_gauge / abs(half) + EDGE_LOSS * edge_s
    events = [(STANDSTILL, mean - half, mean + half)]
    start = STANDSTILL + max(circle_s, blend_duration(abs(mean) + abs(half)))
    while start <= duration:
        half = -half
        events.append((start, mean - half, mean + half))
        start += max(circle_s, edge_s)
    return blends(events)


def slalom(
    duration: float,
    robot: Robot,
    _rng: Generator,
    *,
    speed: Share = 0.5,
    turn: Share = 0.3,
    lowest: NotNegative = 0.05,
    highest: Positive = 0.25,
) -> Slalom:
    """Slalom, left and right in turn with rising frequency.

    Options:
        speed: mean speed as a share of max_track_speed.
        turn: half the difference of the tracks as a share of max_track_speed, right first if negative;
            reduced if the acceleration at the highest frequency exceeds its limit.
        lowest: frequency at the start [Hz].
        highest: frequency at the end [Hz].
    """
    top = robot.vehicle.max_track_speed
    # Half of the acceleration is for the swing, half for the first ramp, to mean and swing together.
    limit = 0.5 * ACCELERATION / (2.0 * np.pi * max(lowest, highest))
    swing = float(np.clip(turn * top, -limit, limit))
    mean = speed * top
    ramp = max(STEEPEST * (abs(mean) + abs(swing)) / (0.5 * ACCELERATION), SHORTEST_BLEND)
    return Slalom(mean, swing, ramp, lowest, highest, max(duration - STANDSTILL, 1.0))


def random_driving(
    duration: float,
    robot: Robot,
    rng: Generator,
    *,
    hold: NotNegative = 2.0,
    reverse: Probability = 0.08,
    stop: Probability = 0.08,
) -> Blends:
    """Random everyday driving: bends and straights, occasional stops and reversing.

    Options:
        hold: mean of the exponentially distributed time that speeds are held [s].
        reverse: share of reversing among the manoeuvres.
        stop: share of stops.
    """
    top = robot.vehicle.max_track_speed

    def draw() -> tuple[float, float]:
        # All three are drawn each time, so that one option does not change the others' numbers.
        manoeuvre, quickness, bend = rng.random(), rng.random(), rng.uniform(-1.0, 1.0)
        if manoeuvre < stop:
            return 0.0, 0.0
        is_reverse = manoeuvre < stop + reverse
        # Mean of the tracks and half of their difference, as shares of max_track_speed.
        mean = -(0.1 + 0.3 * quickness) if is_reverse else 0.15 + 0.7 * quickness
        half = bend * min(0.4, 1.0 - abs(mean))
        return (mean - half) * top, (mean + half) * top

    return _random_blends(duration, rng, draw, hold)


def aggressive(duration: float, robot: Robot, rng: Generator, *, hold: NotNegative = 0.7) -> Blends:
    """Random track speeds, uniform over the full range, reverse included.

    Each pair is held for an exponentially distributed time of mean `hold` [s].
    """
    top = robot.vehicle.max_track_speed

    def draw() -> tuple[float, float]:
        left, right = rng.uniform(-top, top, 2)
        return float(left), float(right)

    return _random_blends(duration, rng, draw, hold)


def arcs(
    duration: float,
    robot: Robot,
    rng: Generator,
    *,
    speed: Share = 0.6,
    tightest: Positive = 1.0,
    widest: Positive = 10.0,
    hold: NotNegative = 4.0,
) -> Blends:
    """Arcs of random radius to the left and right, for the `eta0` of the robot file.

    Options:
        speed: mean of the tracks as a share of max_track_speed; reduced if the outer track would
            exceed it.
        tightest: smallest radius [m].
        widest: largest radius [m].
        hold: mean of the exponentially distributed time that an arc is held [s].
    """
    top = robot.vehicle.max_track_speed
    effective_gauge = robot.vehicle.track_gauge * robot.indices.eta0

    def draw() -> tuple[float, float]:
        radius = tightest * (widest / tightest) ** rng.random()  # log-uniform
        bend = 0.5 * effective_gauge / radius * (1.0 if rng.random() < 0.5 else -1.0)
        mean = speed * top / max(1.0, abs(speed) * (1.0 + abs(bend)))
        return mean * (1.0 - bend), mean * (1.0 + bend)

    return _random_blends(duration, rng, draw, hold)


def stop_and_go(
    duration: float,
    robot: Robot,
    _rng: Generator,
    *,
    speed: Share = 0.6,
    turn: Share = 0.15,
    drive: NotNegative = 6.0,
    rest: NotNegative = 3.0,
) -> Blends:
    """Alternate drives and rests: straight, bending left, bending right, and so on.

    Options:
        speed: mean speed as a share of max_track_speed.
        turn: half the difference of the tracks in bends as a share of max_track_speed.
        drive: seconds of constant speed between two ramps.
        rest: seconds of standstill between two drives.
    """
    top = robot.vehicle.max_track_speed
    ramp = blend_duration((abs(speed) + abs(turn)) * top)
    # A run may end before the first drive.
    events, start = [(0.0, 0.0, 0.0)], STANDSTILL
    bends = cycle((0.0, turn, -turn))
    while start <= duration:
        half = next(bends)
        events.append((start, (speed - half) * top, (speed + half) * top))
        events.append((start + ramp + drive, 0.0, 0.0))
        start = start + 2.0 * ramp + drive + rest
    return blends(events)


def _random_blends(
    duration: float, rng: Generator, draw: Callable[[], tuple[float, float]], hold: float
) -> Blends:
    """Blends to drawn speeds, each held for an exponential time of mean `hold` [s]."""
    events: list[tuple[float, float, float]] = []
    start, before = STANDSTILL, (0.0, 0.0)
    while not events or start <= duration:
        left, right = draw()
        events.append((start, left, right))
        change = max(abs(left - before[0]), abs(right - before[1]))
        # A hold of -0.0 is allowed here, but not by numpy: hence abs.
        start = start + blend_duration(change) + rng.exponential(abs(hold))
        before = left, right
    return blends(events)


# Generators by the name of their trajectory.
TRAJECTORIES: dict[str, Callable[..., Blends | Slalom]] = {
    "straight": straight,
    "spin": spin,
    "circle": circle,
    "arcs": arcs,
    "figure-eight": figure_eight,
    "slalom": slalom,
    "random": random_driving,
    "aggressive": aggressive,
    "stop-and-go": stop_and_go,
}
