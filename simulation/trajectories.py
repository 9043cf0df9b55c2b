"""Commanded track speeds over time, by name.

Every trajectory stands still for `STANDSTILL` seconds [s], then drives with no jump in speed or
acceleration: each track stays within `max_track_speed` and, in acceleration, within `ACCELERATION`
[m/s²]. A trajectory is a function of time, so it does not depend on how it is sampled; a random one
is drawn when it is made, event by event, so a longer one from the same seed begins as the shorter.

Speeds are given as shares of the robot's `max_track_speed`, so that each name fits any robot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from estimator.errors import nearest_hint
from estimator.robot import Robot
from simulation.errors import SimulationError

Floats = NDArray[np.float64]

STANDSTILL = 3.0
ACCELERATION = 1.0
# Highest slope of the quintic blend 6 x^5 - 15 x^4 + 10 x^3.
STEEPEST = 1.875
# What half a square wave loses to its blended edges, as a share of the length of an edge.
EDGE_LOSS = 0.3125
SHORTEST_BLEND = 0.2


class Command(Protocol):
    """Commanded track speeds as a function of time."""

    def __call__(self, times: Floats) -> Floats:
        """Track speeds (n, 2) left, right [m/s] at times (n,) [s] since the start."""


Maker = Callable[[float, Robot, Generator], Command]


@dataclass(frozen=True)
class Blends:
    """Speeds held constant, with a quintic blend (continuous acceleration) from each to the next.

    Attributes:
        starts: (k,) when each blend starts [s], ascending.
        lengths: (k,) how long it takes [s]; it ends before the next one starts.
        targets: (k, 2) left and right speed that it leads to [m/s]; before the first one, zero.
    """

    starts: Floats
    lengths: Floats
    targets: Floats

    def __call__(self, times: Floats) -> Floats:
        """Track speeds (n, 2) [m/s] at times (n,) [s]."""
        at = np.searchsorted(self.starts, times, side="right") - 1
        begun = at >= 0
        at = np.maximum(at, 0)
        held = np.vstack([np.zeros((1, 2)), self.targets])
        blend = _smooth_step((times - self.starts[at]) / self.lengths[at])[:, None]
        speeds = held[at] + blend * (held[at + 1] - held[at])
        return np.where(begun[:, None], speeds, 0.0)


@dataclass(frozen=True)
class Slalom:
    """Both tracks at a mean speed plus a cosine in opposition, its frequency rising linearly.

    Attributes:
        mean: mean speed of the tracks [m/s].
        swing: amplitude of half their difference [m/s].
        ramp: seconds that mean and swing take to grow from zero.
        lowest: frequency at the start [Hz].
        highest: frequency after `rise` [Hz].
        rise: seconds from the lowest to the highest frequency.
    """

    mean: float
    swing: float
    ramp: float
    lowest: float
    highest: float
    rise: float

    def __call__(self, times: Floats) -> Floats:
        """Track speeds (n, 2) [m/s] at times (n,) [s]."""
        since = np.maximum(times - STANDSTILL, 0.0)
        rising = np.minimum(since, self.rise)
        turns = (
            self.lowest * rising
            + 0.5 * (self.highest - self.lowest) * rising**2 / self.rise
            + self.highest * (since - rising)
        )
        envelope = _smooth_step(since / self.ramp)
        half_difference = self.swing * np.cos(2.0 * np.pi * turns)
        return np.stack(
            [envelope * (self.mean - half_difference), envelope * (self.mean + half_difference)],
            axis=-1,
        )


def straight(_duration: float, robot: Robot, _rng: Generator, *, speed: float = 0.6) -> Command:
    """Straight ahead at a constant share `speed` of max_track_speed."""
    top = robot.vehicle.max_track_speed
    return _blends([(STANDSTILL, speed * top, speed * top)])


def spin(
    _duration: float,
    robot: Robot,
    _rng: Generator,
    *,
    speed: float = 0.6,
    ratio: float | None = None,
) -> Command:
    """Turning on the spot to the left: V_l = -H V_r, equation (13).

    Args:
        robot: gives max_track_speed and H.
        speed: share of max_track_speed of the faster track.
        ratio: on-spot ratio instead of the robot's H.
    """
    H = robot.indices.H if ratio is None else ratio
    right = speed * robot.vehicle.max_track_speed / max(1.0, H)
    return _blends([(STANDSTILL, -H * right, right)])


def circle(
    _duration: float, robot: Robot, _rng: Generator, *, speed: float = 0.5, turn: float = 0.25
) -> Command:
    """A circle to the left: mean `speed`, half difference `turn`, shares of max_track_speed."""
    top = robot.vehicle.max_track_speed
    return _blends([(STANDSTILL, (speed - turn) * top, (speed + turn) * top)])


def figure_eight(
    duration: float, robot: Robot, _rng: Generator, *, speed: float = 0.5, turn: float = 0.25
) -> Command:
    """Full circles, left and right in turn, as long as `eta0` of the robot file makes them full.

    Args:
        duration: seconds to fill.
        robot: gives max_track_speed, the gauge and eta0.
        speed: mean speed as a share of max_track_speed.
        turn: half the difference of the tracks as a share of max_track_speed.
    """
    top = robot.vehicle.max_track_speed
    mean, half = speed * top, turn * top
    lobe = np.pi * robot.vehicle.track_gauge * robot.indices.eta0 / half
    edge = _blend_length(2.0 * half)
    lobe += EDGE_LOSS * edge
    events, start, side = [], STANDSTILL, 1.0
    while True:
        events.append((start, mean - side * half, mean + side * half))
        ramp = _blend_length(mean + half) if start == STANDSTILL else edge
        start, side = start + max(lobe, ramp), -side
        if start > duration:
            return _blends(events)


def slalom(
    duration: float,
    robot: Robot,
    _rng: Generator,
    *,
    speed: float = 0.5,
    turn: float = 0.3,
    lowest: float = 0.05,
    highest: float = 0.25,
) -> Command:
    """Left and right with rising frequency.

    Args:
        duration: the frequency reaches its highest value at the end [s].
        robot: gives max_track_speed.
        speed: mean speed as a share of max_track_speed.
        turn: half the difference of the tracks as a share of max_track_speed; less where the
            acceleration at the highest frequency asks for it.
        lowest: frequency at the start [Hz].
        highest: frequency at the end [Hz].
    """
    top = robot.vehicle.max_track_speed
    # Half of the acceleration is for the swing, half for the ramp of mean and swing together.
    swing = min(turn * top, 0.5 * ACCELERATION / (2.0 * np.pi * highest))
    mean = speed * top
    ramp = STEEPEST * (mean + swing) / (0.5 * ACCELERATION)
    return Slalom(mean, swing, ramp, lowest, highest, max(duration - STANDSTILL, 1.0))


def random_driving(
    duration: float,
    robot: Robot,
    rng: Generator,
    *,
    hold: float = 2.0,
    reverse: float = 0.08,
    stop: float = 0.08,
) -> Command:
    """Everyday driving: forward mostly, bends and straights, now and then a stop or some reversing.

    Args:
        duration: seconds to fill.
        robot: gives max_track_speed.
        rng: draws the speeds and how long they are held.
        hold: mean of the exponential time that speeds are held [s].
        reverse: share of reversing among the manoeuvres.
        stop: share of stops.
    """
    top = robot.vehicle.max_track_speed

    def draw() -> tuple[float, float]:
        kind, mean, bend = rng.random(), rng.random(), rng.uniform(-1.0, 1.0)
        if kind < stop:
            return 0.0, 0.0
        speed = -(0.1 + 0.3 * mean) if kind < stop + reverse else 0.15 + 0.7 * mean
        half = bend * min(0.4, 1.0 - abs(speed))
        return (speed - half) * top, (speed + half) * top

    return _random_blends(duration, rng, draw, hold)


def aggressive(duration: float, robot: Robot, rng: Generator, *, hold: float = 0.7) -> Command:
    """Both tracks anywhere in their speed range, reverse included, uniformly and independently.

    Args:
        duration: seconds to fill.
        robot: gives max_track_speed.
        rng: draws the speeds and how long they are held.
        hold: mean of the exponential time that speeds are held [s].
    """
    top = robot.vehicle.max_track_speed

    def draw() -> tuple[float, float]:
        left, right = rng.uniform(-top, top, 2)
        return float(left), float(right)

    return _random_blends(duration, rng, draw, hold)


def stop_and_go(
    duration: float,
    robot: Robot,
    _rng: Generator,
    *,
    speed: float = 0.6,
    turn: float = 0.15,
    drive: float = 6.0,
    rest: float = 3.0,
) -> Command:
    """Drives and rests in turn: straight, bending left, bending right, and so on.

    Args:
        duration: seconds to fill.
        robot: gives max_track_speed.
        speed: mean speed as a share of max_track_speed.
        turn: half the difference of the tracks in bends as a share of max_track_speed.
        drive: seconds of constant speed between two ramps.
        rest: seconds of standstill between two drives.
    """
    top = robot.vehicle.max_track_speed
    ramp = _blend_length((speed + turn) * top)
    events, start, drives = [], STANDSTILL, 0
    while start <= duration:
        half = (0.0, turn, -turn)[drives % 3]
        events.append((start, (speed - half) * top, (speed + half) * top))
        events.append((start + ramp + drive, 0.0, 0.0))
        start, drives = start + 2.0 * ramp + drive + rest, drives + 1
    return _blends(events or [(STANDSTILL, 0.0, 0.0)])


TRAJECTORIES: dict[str, Maker] = {
    "straight": straight,
    "spin": spin,
    "circle": circle,
    "figure-eight": figure_eight,
    "slalom": slalom,
    "random": random_driving,
    "aggressive": aggressive,
    "stop-and-go": stop_and_go,
}


def check_trajectory(name: str) -> None:
    """Refuse the name of a trajectory that does not exist.

    Raises:
        SimulationError: no trajectory has that name; says which is nearest.
    """
    if name not in TRAJECTORIES:
        hint = nearest_hint(name, list(TRAJECTORIES))
        raise SimulationError(f"no trajectory named {name!r}{hint}")


def make_trajectory(name: str, duration: float, robot: Robot, rng: Generator) -> Command:
    """The commanded track speeds of a trajectory.

    Args:
        name: one of `TRAJECTORIES`.
        duration: seconds to fill.
        robot: gives the speed range and, for some, the gauge and indices.
        rng: draws what is random.

    Raises:
        SimulationError: no trajectory has that name; says which is nearest.
    """
    check_trajectory(name)
    return TRAJECTORIES[name](duration, robot, rng)


def _random_blends(
    duration: float, rng: Generator, draw: Callable[[], tuple[float, float]], hold: float
) -> Blends:
    events, start, before = [], STANDSTILL, (0.0, 0.0)
    while True:
        target = draw()
        events.append((start, *target))
        change = max(abs(target[0] - before[0]), abs(target[1] - before[1]))
        start, before = start + _blend_length(change) + rng.exponential(hold), target
        if start > duration:
            return _blends(events)


def _blends(events: list[tuple[float, float, float]]) -> Blends:
    """Blends from (start [s], left, right [m/s]), each as long as the acceleration limit asks."""
    table = np.array(events, dtype=float)
    targets = table[:, 1:]
    changes = np.abs(np.diff(targets, axis=0, prepend=np.zeros((1, 2)))).max(axis=1)
    return Blends(table[:, 0], np.array([_blend_length(change) for change in changes]), targets)


def _blend_length(change: float) -> float:
    """Seconds that a blend takes to change a speed by so much [m/s]."""
    return max(STEEPEST * change / ACCELERATION, SHORTEST_BLEND)


def _smooth_step(x: Floats) -> Floats:
    """0 below 0, 1 above 1, and between them a quintic with no jump in its second derivative."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 + x * (6.0 * x - 15.0)))
