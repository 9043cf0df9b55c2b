"""The newest track speeds: how fast, how old, how quickly changing, and how far to be trusted."""

from __future__ import annotations

import math

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.sensors.stuck_tracks import Repeating

# Time over which the change of the track speeds is averaged [s].
ACCELERATION_AVERAGING = 0.05
# Time constant of the smoothed speeds [s].
SMOOTHING = 0.2
# Speeds that are not renewed are taken to die away with this time constant, once they are too old [s].
DYING_AWAY = 2.0


class TrackMemory(msgspec.Struct, frozen=True):
    """All that `HeldTrackSpeeds` goes by; attributes as there."""

    stamp: int | None = None
    left: float = 0.0
    right: float = 0.0
    interval: float = 0.02
    acceleration: tuple[float, float] = (0.0, 0.0)
    smooth: tuple[float, float] = (0.0, 0.0)
    repeating: tuple[Repeating, Repeating] | None = None


def smoothing_share(interval: float, time_constant: float) -> float:
    """Share of a new value in a smoothed one, at this time since the one before [s]."""
    return -math.expm1(-interval / time_constant)


def acceleration_after(
    acceleration: float, interval: float, speed: float, speed_before: float
) -> float:
    """The averaged acceleration of a track after one more sample [m/s²].

    Args:
        acceleration: before it [m/s²].
        interval: since the sample before [s].
        speed: that was sampled [m/s].
        speed_before: of the sample before [m/s].
    """
    weight = min(1.0, interval / ACCELERATION_AVERAGING) / interval
    return acceleration + weight * (speed - speed_before - acceleration * interval)


def left_of_speed(too_old: float) -> float:
    """What is left of a speed that has been too old to be trusted for so long [s], as a share."""
    return math.exp(-too_old / DYING_AWAY)


def mean_left_of_speed(dt: float, from_age: float, to_age: float) -> float:
    """The same in the mean of a step.

    Args:
        dt: of the step [s].
        from_age: for how long the speed has been too old at the start of the step [s].
        to_age: the same at its end, more than zero [s].
    """
    fresh = dt - (to_age - from_age)
    dying = math.exp(-from_age / DYING_AWAY) - math.exp(-to_age / DYING_AWAY)
    return (fresh + DYING_AWAY * dying) / dt


def walked_density(
    dt: float, from_age: float, to_age: float, gap_acceleration: float, fastest: float
) -> float:
    """Density of the error over a step of a speed that is not known any more [m²/s].

    A random walk g b(t) of the speeds has an integral of variance g² T³ / 3, and so has a white
    noise of density g² t². The walk is bounded by the fastest that the tracks can go.

    Args:
        dt: of the step, more than zero [s].
        from_age: for how long the speed has not been known at the start of the step [s].
        to_age: the same at its end [s].
        gap_acceleration: random walk of the speed [m/s/√s].
        fastest: no track is faster [m/s].
    """
    age = (to_age * to_age - from_age * from_age) / (2.0 * dt)
    square = (to_age * to_age * to_age - from_age * from_age * from_age) / (3.0 * dt)
    return min(gap_acceleration * gap_acceleration * square, 4.0 * fastest * fastest * age)


class HeldTrackSpeeds:
    """Track speeds are held from one sample to the next; each is the average since the one before.

    Args:
        hold: speeds older than this are no longer trusted [s].
        gap_acceleration: random walk that they are then taken to follow [m/s/√s].
        fastest: no track is faster [m/s].

    Attributes:
        stamp: of the newest sample [ns], or None.
        left: [m/s].
        right: [m/s].
        interval: time between the newest two samples [s].
        acceleration: of the left and the right track, averaged [m/s²].
        smooth: speeds of the left and the right track, smoothed [m/s].
        repeating: how long each of them has read the same; None before the first sample.
    """

    def __init__(self, hold: float, gap_acceleration: float, fastest: float) -> None:
        self._hold = float(hold)
        self._hold_ns = int(hold / NANOSECOND)
        self._gap_acceleration = gap_acceleration
        self._fastest = fastest
        self.recall(TrackMemory())

    def memory(self) -> TrackMemory:
        """What it goes by now."""
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
        """Go by what it went by then."""
        self.stamp: int | None = memory.stamp
        self.left, self.right = memory.left, memory.right
        self.interval = memory.interval
        self.acceleration = memory.acceleration
        self.smooth = memory.smooth
        self.repeating = memory.repeating

    def take(self, stamp: int, left: float, right: float) -> None:
        """Take a new sample, later than the one before."""
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
        """Whether both tracks read exactly zero; then the encoders have no noise."""
        return self.left == 0.0 and self.right == 0.0

    @property
    def acceleration_window(self) -> float:
        """Time that `acceleration` is an average of [s]."""
        return max(ACCELERATION_AVERAGING, self.interval)

    def age(self, now: int) -> float:
        """Age at a stamp [ns] of what the speeds are an average of: the middle of their interval [s]."""
        if self.stamp is None:
            return 0.0
        return min((now - self.stamp) * NANOSECOND + 0.5 * self.interval, self._hold)

    def speeds_at(self, now: int | None) -> tuple[float, float]:
        """Speeds of the left and the right track at a stamp [ns], which die away when too old [m/s]."""
        if self.stamp is None or now is None or now - self.stamp <= self._hold_ns:
            return self.left, self.right
        share = left_of_speed(self._too_old(now))
        return share * self.left, share * self.right

    def mean_speeds(self, start: int, end: int) -> tuple[float, float]:
        """Their means between two stamps [ns]."""
        if self.stamp is None or end - self.stamp <= self._hold_ns:
            return self.left, self.right
        dt = (end - start) * NANOSECOND
        share = mean_left_of_speed(dt, self._too_old(start), self._too_old(end))
        return share * self.left, share * self.right

    def _too_old(self, now: int) -> float:
        """For how long the speeds have been too old to be trusted, at a stamp [ns] [s]."""
        if self.stamp is None:
            return 0.0
        return max(0, now - self.stamp - self._hold_ns) * NANOSECOND

    def is_hole(self, stamp: int) -> bool:
        """Whether a new sample at a stamp [ns] would come later than the newest can be held."""
        return self.stamp is not None and (stamp - self.stamp) * NANOSECOND > self._hold

    def gap_density(self, start: int, end: int) -> float:
        """Density of the error of the speeds over a step, from being too old to be trusted [m²/s].

        Args:
            start: stamp of the step's start [ns].
            end: of its end, later [ns].
        """
        if self.stamp is None or end - self.stamp <= self._hold_ns:
            return 0.0
        return self._walked(start, end, self.stamp + self._hold_ns)

    def stuck_densities(self, start: int, end: int) -> tuple[float, float]:
        """The same of the left and of the right track alone, where its sensor is stuck [m²/s]."""
        if self.repeating is None:
            return 0.0, 0.0
        left, right = self.repeating
        return self._stuck_density(left, start, end), self._stuck_density(right, start, end)

    def _stuck_density(self, track: Repeating, start: int, end: int) -> float:
        since = track.stuck_from(self._hold) if track.repeats else None
        return 0.0 if since is None else self._walked(start, end, since)

    def _walked(self, start: int, end: int, since: int) -> float:
        """Density of the error over a step of speeds that are not known since a stamp [m²/s]."""
        from_age, to_age = max(0, start - since) * NANOSECOND, max(0, end - since) * NANOSECOND
        dt = (end - start) * NANOSECOND
        if dt <= 0.0:
            return 0.0
        return walked_density(dt, from_age, to_age, self._gap_acceleration, self._fastest)
