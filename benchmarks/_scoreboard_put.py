"""Faults of the scoreboard: what each does to a log between two stamps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.frames import rpy_to_matrix
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import FixSeries, ImuSeries, TrackSpeedSeries

SECOND = 1_000_000_000
Put = Callable[[Log, int, int, Generator], Log]
BEFORE, UNDER, RTK, NEVER = "before", "under", "RTK", "never"
"""Fixes: until the fault begins; always, 5 cm at 1 Hz; 2 cm at 5 Hz; none."""
MOVING, RESTING, POWER_UP = "moving", "resting", "power-up"
"""When the fault begins: on the move; within a rest of 10 s; before the first drive."""
COUNT = 0.01
"""Travel of a track per count of a coarse encoder [m]."""


class Fault(NamedTuple):
    """A fault.

    Attributes:
        put: function of a log, of the stamps of its begin and end [ns], and of random numbers.
        lasts: duration; errors are those at its end and 30 s later [s].
        fixes: fixes that there are.
        when: when it begins.
        real: whether it is put into the real logs, too.
        goes_on: whether it lasts to the end of the run.
    """

    put: Put
    lasts: float
    fixes: str = BEFORE
    when: str = MOVING
    real: bool = False
    goes_on: bool = False


def hit(stamps: Stamps, begin: int, end: int) -> Stamps:
    """Mask of the stamps within a fault."""
    return np.asarray((stamps >= begin) & (stamps < end))


def imu_of(log: Log) -> ImuSeries:
    """IMU of a log."""
    if log.imu is None:
        raise ValueError(f"{log.name} has no IMU")
    return log.imu


def fixes_of(log: Log) -> FixSeries:
    """Fixes of a log."""
    if log.fixes is None:
        raise ValueError(f"{log.name} has no fixes")
    return log.fixes


def rates(change: Callable[[Floats, Generator], Floats]) -> Put:
    """Change of the yaw rates (n,), in the axis of the gyro that is the vertical."""

    def put(log: Log, begin: int, end: int, rng: Generator) -> Log:
        imu = imu_of(log)
        found, at = imu.angular_velocity.copy(), hit(imu.stamps, begin, end)
        axis = int(np.argmax(np.ptp(found, axis=0)))
        found[at, axis] = change(found[at, axis], rng)
        return replace(log, imu=replace(imu, angular_velocity=found))

    return put


def tracks(change: Callable[[Floats], Floats]) -> Put:
    """Change of the track speeds (n, 2)."""

    def put(log: Log, begin: int, end: int, _: Generator) -> Log:
        found, at = log.tracks.speeds.copy(), hit(log.tracks.stamps, begin, end)
        found[at] = change(found[at])
        return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, found))

    return put


def places(change: Callable[[Floats, Floats, Generator], Floats]) -> Put:
    """Change of the positions (n, 2) of fixes, at times (n,) since the begin [s]."""

    def put(log: Log, begin: int, end: int, rng: Generator) -> Log:
        fixes = fixes_of(log)
        found, at = fixes.poses.copy(), hit(fixes.stamps, begin, end)
        times = (fixes.stamps[at] - begin) / SECOND
        found[at, :2] = change(found[at, :2], times, rng)
        return replace(log, fixes=replace(fixes, poses=found))

    return put


def without_imu(log: Log, begin: int, end: int, _: Generator) -> Log:
    """No IMU samples."""
    imu = imu_of(log)
    keep, forces = ~hit(imu.stamps, begin, end), imu.linear_acceleration
    kept = None if forces is None else forces[keep]
    return replace(log, imu=ImuSeries(imu.stamps[keep], imu.angular_velocity[keep], kept))


def without_tracks(log: Log, begin: int, end: int, _: Generator) -> Log:
    """No track speeds."""
    keep = ~hit(log.tracks.stamps, begin, end)
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps[keep], log.tracks.speeds[keep]))


def silent(log: Log, begin: int, end: int, rng: Generator) -> Log:
    """Neither IMU samples nor track speeds."""
    return without_tracks(without_imu(log, begin, end, rng), begin, end, rng)


def late_tracks(log: Log, begin: int, end: int, _: Generator) -> Log:
    """Track speeds 0.2 s late."""
    stamps, speeds = log.tracks.stamps, log.tracks.speeds.copy()
    at = hit(stamps, begin, end)
    for side in range(2):
        speeds[at, side] = np.interp(stamps[at] - SECOND // 5, stamps, log.tracks.speeds[:, side])
    return replace(log, tracks=TrackSpeedSeries(stamps, speeds))


def counted(log: Log, begin: int, end: int, _: Generator) -> Log:
    """Track speeds of an encoder with counts of `COUNT`: whole counts of each interval."""
    stamps, found = log.tracks.stamps, log.tracks.speeds.copy()
    at = hit(stamps, begin, end)
    intervals = np.diff(stamps, prepend=0)[at, None] / SECOND
    counts = np.floor(np.cumsum(found[at] * intervals, axis=0) / COUNT)
    found[at] = COUNT * np.diff(counts, axis=0, prepend=0.0) / intervals
    return replace(log, tracks=TrackSpeedSeries(stamps, found))


def odd_wheel(log: Log, begin: int, end: int, rng: Generator) -> Log:
    """Two wheels a side of their own, the front left one 0.8 m/s too fast."""
    stamps, speeds = log.tracks.stamps, log.tracks.speeds.copy()
    sides = []
    for side in range(2):
        apart = 0.005 * rng.standard_normal((len(stamps), 2))
        sides.append(speeds[:, side, None] * np.array([1.01, 0.99]) + apart)
    sides[0][hit(stamps, begin, end), 0] += 0.8
    means = np.stack([one.mean(axis=1) for one in sides], axis=1)
    return replace(log, tracks=TrackSpeedSeries(stamps, means, sides[0], sides[1]))


def shaken(log: Log, begin: int, end: int, rng: Generator) -> Log:
    """White noise of 0.1 rad/s and 3 m/s² more in each axis."""
    imu = imu_of(log)
    at, turned, forces = hit(imu.stamps, begin, end), imu.angular_velocity.copy(), None
    turned[at] += 0.1 * rng.standard_normal(turned[at].shape)
    if imu.linear_acceleration is not None:
        forces = imu.linear_acceleration.copy()
        forces[at] += 3.0 * rng.standard_normal(forces[at].shape)
    return replace(log, imu=ImuSeries(imu.stamps, turned, forces))


def tilted(log: Log, begin: int, end: int, _: Generator) -> Log:
    """IMU knocked aside by 10 degrees of pitch."""
    imu, R = imu_of(log), rpy_to_matrix(0.0, np.radians(10.0), 0.0)
    at, turned, forces = hit(imu.stamps, begin, end), imu.angular_velocity.copy(), None
    turned[at] = turned[at] @ R
    if imu.linear_acceleration is not None:
        forces = imu.linear_acceleration.copy()
        forces[at] = forces[at] @ R
    return replace(log, imu=ImuSeries(imu.stamps, turned, forces))


def spike(log: Log, begin: int, _: int, rng: Generator) -> Log:
    """One track speed of 30 m/s and one yaw rate of 20 rad/s."""
    stamps = log.tracks.stamps
    end = int(stamps[np.searchsorted(stamps, begin) + 1])
    log = tracks(lambda speeds: np.full_like(speeds, 30.0))(log, begin, end, rng)
    stamps = imu_of(log).stamps
    end = int(stamps[np.searchsorted(stamps, begin) + 1])
    return rates(lambda found, _: np.full_like(found, 20.0))(log, begin, end, rng)


def clipped(found: Floats, _: Generator) -> Floats:
    """Rates of a gyro with a range of 0.3 rad/s."""
    return np.asarray(found.clip(-0.3, 0.3))


def noisy(found: Floats, rng: Generator) -> Floats:
    """Rates with noise of 3 mrad/s."""
    return np.asarray(found + 0.003 * rng.standard_normal(len(found)))


def away(count: int, rng: Generator, distance: float, *, alike: bool) -> Floats:
    """Offsets (n, 2) of fixes, in one direction or in many [m]."""
    angle = rng.uniform(-np.pi, np.pi, 1 if alike else count)
    offsets = distance * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(np.broadcast_to(offsets, (count, 2)))


def outliers(found: Floats, _: Floats, rng: Generator) -> Floats:
    """A tenth of the fixes 10 m off, in any direction."""
    hits = rng.random(len(found)) < 0.1
    return np.asarray(found + hits[:, None] * away(len(found), rng, 10.0, alike=False))


def off_by(distance: float) -> Put:
    """All fixes off to one side."""
    return places(lambda found, _, rng: found + away(len(found), rng, distance, alike=True))


def wandering(sigma: float, time: float) -> Put:
    """Fixes that wander by sigma [m], a Gauss-Markov process of a time [s] that begins at zero."""

    def change(found: Floats, times: Floats, rng: Generator) -> Floats:
        error, before = np.zeros((len(found), 2)), np.zeros(2)
        for k, dt in enumerate(np.diff(times, prepend=0.0)):
            kept = np.exp(-dt / time)
            before = kept * before + sigma * np.sqrt(1.0 - kept**2) * rng.standard_normal(2)
            error[k] = before
        return np.asarray(found + error)

    return places(change)


def floating(log: Log, begin: int, end: int, rng: Generator) -> Log:
    """RTK that floats, and says so: it wanders by 0.35 m until 5 s before the end."""
    fixed_at = end - 5 * SECOND
    log = wandering(0.35, 30.0)(log, begin, fixed_at, rng)
    fixes = fixes_of(log)
    variances = fixes.variances.copy()
    variances[hit(fixes.stamps, begin, fixed_at), 0] = 0.35**2
    return replace(log, fixes=replace(fixes, variances=variances))


def more(size: float) -> Put:
    """Yaw rates that are larger by a constant [rad/s]."""
    return rates(lambda found, _: found + size)


SPIN = tracks(lambda speeds: speeds + np.array([0.8, 0.0]))
BOTH_SPIN = tracks(lambda speeds: speeds + 0.5)
FAULTS: dict[str, Fault] = {
    "stuck encoder, 3 s": Fault(
        tracks(lambda v: np.stack([np.full(len(v), v[0, 0]), v[:, 1]], axis=1)), 3.0, real=True
    ),
    "both encoders frozen, 10 s": Fault(
        tracks(lambda v: np.repeat(v[:1], len(v), axis=0)), 10.0, real=True
    ),
    "left encoder reads zero, 10 s": Fault(
        tracks(lambda v: v * np.array([0.0, 1.0])), 10.0, real=True
    ),
    "no track speeds, 4 s": Fault(without_tracks, 4.0, real=True),
    "IMU silent, 5 s": Fault(without_imu, 5.0, real=True),
    "IMU and tracks silent, 2 s": Fault(silent, 2.0),
    "spike in tracks and gyro": Fault(spike, 1.0, real=True),
    "tracks 0.2 s late, 20 s": Fault(late_tracks, 20.0, real=True),
    "gyro frozen, 5 s": Fault(rates(lambda r, _: np.full_like(r, r[0])), 5.0, real=True),
    "gyro clipped, 10 s": Fault(rates(clipped), 10.0, real=True),
    "gyro clipped, with noise, 10 s": Fault(
        rates(lambda r, rng: noisy(clipped(r, rng), rng)), 10.0, real=True
    ),
    "gyro reads 2 rad/s, 1 s": Fault(rates(lambda r, _: np.full_like(r, 2.0)), 1.0, real=True),
    "gyro reads 2 rad/s more, 1 s": Fault(more(2.0), 1.0),
    "gyro reads 0.2 rad/s more, 10 s": Fault(more(0.2), 10.0, real=True),
    "gyro reads noise alone, 20 s": Fault(
        rates(lambda r, rng: noisy(np.zeros_like(r), rng)), 20.0, real=True
    ),
    "gyro's sign is turned, 20 s": Fault(rates(lambda r, _: -r), 20.0, real=True),
    "gyro reads 1.5 times the rate, 10 s": Fault(rates(lambda r, _: 1.5 * r), 10.0),
    "bias + 0.02 rad/s, fixes": Fault(more(0.02), 30.0, UNDER, real=True, goes_on=True),
    "bias + 0.05 rad/s, fixes": Fault(more(0.05), 30.0, UNDER, real=True, goes_on=True),
    "bias + 0.1 rad/s, fixes": Fault(more(0.1), 30.0, UNDER, real=True, goes_on=True),
    "bias + 0.02 rad/s at rest": Fault(more(0.02), 20.0, when=RESTING, goes_on=True),
    "bias + 0.05 rad/s at rest": Fault(more(0.05), 20.0, when=RESTING, goes_on=True),
    "bias + 0.1 rad/s at rest": Fault(more(0.1), 20.0, when=RESTING, goes_on=True),
    "bias 0.05 rad/s from power-up": Fault(more(0.05), 30.0, NEVER, POWER_UP, goes_on=True),
    "left track spins, 3 s": Fault(SPIN, 3.0, real=True),
    "left track spins, 3 s, RTK": Fault(SPIN, 3.0, RTK),
    "both tracks spin, 10 s": Fault(BOTH_SPIN, 10.0, real=True),
    "both tracks spin, 10 s, RTK": Fault(BOTH_SPIN, 10.0, RTK),
    "carried at rest, 10 s": Fault(tracks(np.zeros_like), 15.0, when=RESTING),
    "wheel against its side, 3 s": Fault(odd_wheel, 3.0),
    "IMU shaken, 20 s": Fault(shaken, 20.0, real=True),
    "IMU tilted by 10°": Fault(tilted, 20.0, real=True, goes_on=True),
    "outliers of 10 m, 30 s": Fault(places(outliers), 30.0, UNDER, real=True),
    "fixes 50 m off, 5 s": Fault(off_by(50.0), 5.0, UNDER, real=True),
    "fixes 0.3 m off, 5 s, RTK": Fault(off_by(0.3), 5.0, RTK),
    "RTK floats for 30 s, is fixed for 5 s": Fault(floating, 35.0, RTK),
    "receiver repeats, 30 s": Fault(
        places(lambda p, *_: np.repeat(p[:1], len(p), axis=0)), 30.0, UNDER, real=True
    ),
    "fixes scatter by 0.5 m, 30 s": Fault(
        places(lambda p, _, rng: p + 0.5 * rng.standard_normal(p.shape)), 30.0, UNDER, real=True
    ),
    "fixes wander by 5 m, 30 s": Fault(wandering(5.0, 60.0), 30.0, UNDER, real=True),
    "encoders of 10 mm a count, 30 s": Fault(counted, 30.0, real=True),
}
