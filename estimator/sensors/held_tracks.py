"""Held track speeds: newest values, age, acceleration, and error density if stale."""

from __future__ import annotations

import math

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.sensors.stuck_tracks import Repeating

# Time over which the change of the track speeds is averaged [s].
ACCELERATION_AVERAGING = 0.05
# Time constant of the smoothed speeds [s].
SMOOTHING = 0.2
# Time constant with which stale speeds decay [s].
DYING_AWAY = 2.0


class TrackMemory(msgspec.Struct, frozen=True):
    """Checkpoint of `HeldTrackSpeeds`, with its attributes."""

    stamp: int | None = None
    left: float = 0.0
    right: float = 0.0
    interval: float = 0.02
    acceleration: tuple[float, float] = (0.0, 0.0)
    smooth: tuple[float, float] = (0.0, 0.0)
    repeating: tuple[Repeating, Repeating] | None = None


def smoothing_share(interval: float, time_constant: float) -> float:
    """Weight of a new value in an exponential average; `interval` since the last [s]."""
    return -math.expm1(-interval / time_constant)


def acceleration_after(
    acceleration: float, interval: float, speed: float, speed_before: float
) -> float:
    """Averaged acceleration of a track after one more sample [m/s²].

    Args:
        acceleration: average before it [m/s²].
        interval: time since the previous sample [s].
        speed: speed of the sample [m/s].
        speed_before: speed of the previous sample [m/s].
    """
    weight = min(1.0, interval / ACCELERATION_AVERAGING) / interval
    return acceleration + weight * (speed - speed_before - acceleration * interval)


def left_of_speed(too_old: float) -> float:
    """Decay factor of a held speed that has been stale for `too_old` seconds."""
    return math.exp(-too_old / DYING_AWAY)


def mean_left_of_speed(dt: float, from_age: float, to_age: float) -> float:
    """Mean decay factor of a held speed over a step.

    Args:
        dt: length of the step [s].
        from_age: time that the speed has been stale at the start of the step [s].
        to_age: time that it has been stale at the end, more than zero [s].
    """
    fresh = dt - (to_age - from_age)
    dying = math.exp(-from_age / DYING_AWAY) - math.exp(-to_age / DYING_AWAY)
    return (fresh + DYING_AWAY * dying) / dt


def walked_density(
    dt: float, from_age: float, to_age: float, gap_acceleration: float, fastest: float
) -> float:
    """Error density of an unknown speed over a step [m²/s].

    A random walk g b(t) of the speeds has an integral of variance g² T³ / 3, and so has a white
    noise of density g² t². The walk is bounded by the highest track speed.

    Args:
        dt: length of the step, more than zero [s].
        from_age: time that the speed has been unknown at the start of the step [s].
        to_age: time that it has been unknown at the end [s].
        gap_acceleration: random walk of the speed [m/s/√s].
        fastest: highest speed of a track [m/s].
    """
    age = (to_age * to_age - from_age * from_age) / (2.0 * dt)
    square = (to_age * to_age * to_age - from_age * from_age * from_age) / (3.0 * dt)
    return min(gap_acceleration * gap_acceleration * square, 4.0 * fastest * fastest * age)


class HeldTrackSpeeds:
    """Track speeds held from sample to sample; each is the average since the previous.

    Args:
        hold: age from which speeds are stale [s].
        gap_acceleration: random walk of stale speeds [m/s/√s].
        fastest: highest speed of a track [m/s].

    Attributes:
        stamp: stamp of the newest sample [ns], or None.
        left: newest speed of the left track [m/s].
        right: newest speed of the right track [m/s].
        interval: time between the newest two samples [s].
        acceleration: averaged acceleration of the left and the right track [m/s²].
        smooth: smoothed speeds of the left and the right track [m/s].
        repeating: repetition record of each track; None before the first sample.
    """

    def __init__(self, hold: float, gap_acceleration: float, fastest: float) -> None:
        self._hold = float(hold)
        self._hold_ns = int(hold / NANOSECOND)
        self._gap_acceleration = gap_acceleration
        self._fastest = fastest
        self.recall(TrackMemory())

    def memory(self) -> TrackMemory:
        """Checkpoint of the present state."""
        return TrackMemory(
            self.stamp,
            self.left,
            self.right,
            self.interval,
            self.acceleration,
            self.smooth,
            self.repeating,
        )

    def recall(self, memory: TrackMemory) -> None:
        """Restore a checkpoint."""
        self.stamp: int | None = memory.stamp
        self.left, self.right = memory.left, memory.right
        self.interval = memory.interval
        self.acceleration = memory.acceleration
        self.smooth = memory.smooth
        self.repeating = memory.repeating

    def take(self, stamp: int, left: float, right: float) -> None:
        """Add a new sample, later than the previous one."""
        share = 1.0
        if self.stamp is not None:
            interval = (stamp - self.stamp) * NANOSECOND
            if interval <= self._hold:
                self.interval = interval
                share = smoothing_share(interval, SMOOTHING)
                a_l, a_r = self.acceleration
                self.acceleration = (
                    acceleration_after(a_l, interval, left, self.left),
                    acceleration_after(a_r, interval, right, self.right),
                )
            else:
                self.acceleration = (0.0, 0.0)
        smooth_left, smooth_right = self.smooth
        self.smooth = (
            smooth_left + share * (left - smooth_left),
            smooth_right + share * (right - smooth_right),
        )
        if self.repeating is None:
            self.repeating = (
                Repeating(left, stamp, stamp, (right,)),
                Repeating(right, stamp, stamp, (left,)),
            )
        else:
            of_left, of_right = self.repeating
            self.repeating = (
                of_left.after(stamp, left, right, self._hold),
                of_right.after(stamp, right, left, self._hold),
            )
        self.left, self.right, self.stamp = left, right, stamp

    @property
    def stopped(self) -> bool:
        """True if both tracks read exactly zero; then the encoders have no noise."""
        return self.left == 0.0 and self.right == 0.0

    @property
    def acceleration_window(self) -> float:
        """Averaging time of `acceleration` [s]."""
        return max(ACCELERATION_AVERAGING, self.interval)

    def age(self, now: int) -> float:
        """Age of the speeds at a stamp [ns], from the middle of their interval [s]."""
        if self.stamp is None:
            return 0.0
        return min((now - self.stamp) * NANOSECOND + 0.5 * self.interval, self._hold)

    def speeds_at(self, now: int | None) -> tuple[float, float]:
        """Speeds of the left and the right track at a stamp [ns]; stale ones decay [m/s]."""
        if self.stamp is None or now is None or now - self.stamp <= self._hold_ns:
            return self.left, self.right
        share = left_of_speed(self._too_old(now))
        return share * self.left, share * self.right

    def mean_speeds(self, start: int, end: int) -> tuple[float, float]:
        """Mean speeds of the left and the right track between two stamps [ns] [m/s]."""
        if self.stamp is None or end - self.stamp <= self._hold_ns:
            return self.left, self.right
        dt = (end - start) * NANOSECOND
        share = mean_left_of_speed(dt, self._too_old(start), self._too_old(end))
        return share * self.left, share * self.right

    def _too_old(self, now: int) -> float:
        """Time [s] that the speeds have been stale at a stamp [ns]."""
        if self.stamp is None:
            return 0.0
        return max(0, now - self.stamp - self._hold_ns) * NANOSECOND

    def is_hole(self, stamp: int) -> bool:
        """Return True if a sample at a stamp [ns] follows a gap longer than `hold`."""
        return self.stamp is not None and (stamp - self.stamp) * NANOSECOND > self._hold

    def gap_density(self, start: int, end: int) -> float:
        """Error density of stale speeds over a step [m²/s].

        Args:
            start: stamp of the step's start [ns].
            end: stamp of its end, later [ns].
        """
        if self.stamp is None or end - self.stamp <= self._hold_ns:
            return 0.0
        return self._walked(start, end, self.stamp + self._hold_ns)

    def stuck_densities(self, start: int, end: int) -> tuple[float, float]:
        """Error densities over a step of the left and the right track if stuck [m²/s]."""
        if self.repeating is None:
            return 0.0, 0.0
        left, right = self.repeating
        return self._stuck_density(left, start, end), self._stuck_density(right, start, end)

    def _stuck_density(self, track: Repeating, start: int, end: int) -> float:
        since = track.stuck_from(self._hold) if track.repeats else None
        return 0.0 if since is None else self._walked(start, end, since)

    def _walked(self, start: int, end: int, since: int) -> float:
        """Error density over a step of speeds that are unknown since a stamp [m²/s]."""
        from_age, to_age = max(0, start - since) * NANOSECOND, max(0, end - since) * NANOSECOND
        dt = (end - start) * NANOSECOND
        if dt <= 0.0:
            return 0.0
        return walked_density(dt, from_age, to_age, self._gap_acceleration, self._fastest)
