"""Slides of the whole robot, by accelerometer against tracks.

Both tracks spin up against an obstacle, or stop on ice: their speed changes and the robot's does not. A
push, or a hit from the side: the robot's velocity changes and that of the tracks does not. An
accelerometer shows no velocity, only its changes, and gravity on slopes looks like one. So a slide is
found if it begins suddenly, with a speed beyond that of the robot's usual starts and stops; one that
begins slowly is not. A slide ends with the opposite change, or is forgotten after some time. Functions
are plain Python, also for numba.
"""

import math

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Interval, Size, Stamp

# Time over which a difference of velocity is forgotten, and over which gravity is averaged [s].
FORGETTING, GRAVITY_AVERAGING = 0.3, 2.0
# Time over which speeds and forces are averaged [s]: stamps that jitter falsify speeds, not distances.
AVERAGING = 0.05
# Difference that is a slide: this [m/s], or this multiple of the robot's own root mean square.
LEAST_SPEED, SIGMAS = 0.6, 8.0
# The robot's own root mean square before it is known [m/s], the time for which this counts, and the
# longest over which it is averaged [s].
RMS_AT_START, TIME_AT_START, RMS_AVERAGING = 0.2, 2.0, 20.0
# A difference to the other side, of this share of the slide's speed, ends it. The next is not found
# before the difference is below this share of the limit.
ENDING_SHARE, CALM_SHARE = 0.5, 0.5
LONGEST_SLIDE = 10.0  # time after which a slide is forgotten [s]
LONGEST_INTERVAL = 0.1  # longest interval between samples of the IMU that counts as driving [s]


class SlideRecord(msgspec.Struct):
    """Record of slides along the robot."""

    stamp: Stamp = NEVER  # stamp of the newest sample of the IMU [ns], or NEVER
    tracks: float = 0.0  # velocity by the tracks at that sample [m/s]
    force: float = 0.0  # averaged specific force [m/s²]
    mean: float = 0.0  # averaged difference of the accelerations, mostly gravity [m/s²]
    difference: float = 0.0  # recent change of velocity by accelerometer less tracks [m/s]
    square: Size = RMS_AT_START * RMS_AT_START  # averaged square of the difference [m²/s²]
    averaged: Interval = TIME_AT_START  # averaging time, up to `RMS_AVERAGING` [s]
    since: Stamp = NEVER  # stamp at which a slide began [ns], or NEVER
    speed: float = 0.0  # largest difference of that slide, 0 after its end [m/s]
    times: Count = 0  # number of slides that were found


def slides(slide: SlideRecord) -> bool:
    """Return True while a slide is found."""
    return slide.since != NEVER


def watch_slide(slide: SlideRecord, stamp: int, force: float, tracks: float) -> None:
    """Add an IMU sample [ns], and decide whether the robot slides.

    The specific force [m/s²], NaN if unknown, is forward. So is the speed of the tracks [m/s], which is
    averaged over `AVERAGING`.
    """
    if force != force:  # NaN
        return
    dt = (stamp - slide.stamp) * NANOSECOND if slide.stamp != NEVER else 0.0
    change = tracks - slide.tracks
    slide.stamp, slide.tracks = stamp, tracks
    if dt == 0.0:
        slide.mean = force
    if not 0.0 < dt < LONGEST_INTERVAL:
        slide.force, slide.difference = force, 0.0
        return
    slide.force += min(1.0, dt / AVERAGING) * (force - slide.force)
    # Change of velocity by the accelerometer less that by the tracks.
    difference = slide.force * dt - change
    slide.difference += difference - slide.mean * dt - min(1.0, dt / FORGETTING) * slide.difference
    slide.mean += (difference - slide.mean * dt) / GRAVITY_AVERAGING
    limit = max(LEAST_SPEED, SIGMAS * math.sqrt(slide.square))
    if slides(slide):
        _continue_slide(slide)
    elif slide.speed != 0.0:
        if abs(slide.difference) < CALM_SHARE * limit:
            slide.speed = 0.0
    elif abs(slide.difference) > limit:
        slide.since, slide.speed = stamp, slide.difference
        slide.times += 1
    slide.averaged = min(RMS_AVERAGING, slide.averaged + dt)
    square = slide.difference * slide.difference
    slide.square += dt / slide.averaged * (square - slide.square)


def _continue_slide(slide: SlideRecord) -> None:
    """Update the speed of a slide; end it at the opposite change, or after too long."""
    if abs(slide.difference) > abs(slide.speed) and slide.difference * slide.speed > 0.0:
        slide.speed = slide.difference
    is_opposite = slide.difference * slide.speed < -ENDING_SHARE * slide.speed * slide.speed
    if is_opposite or (slide.stamp - slide.since) * NANOSECOND > LONGEST_SLIDE:
        slide.since = NEVER


def slide_density(slide: SlideRecord, start: int, end: int) -> float:
    """Error density of the sliding speed over a step from start to end [ns] [m²/s]."""
    if not slides(slide):
        return 0.0
    # The distance is off by the slide's speed times its duration, at one standard deviation.
    age = max(0.0, 0.5 * (start - slide.since + end - slide.since) * NANOSECOND)
    return 2.0 * slide.speed * slide.speed * age
