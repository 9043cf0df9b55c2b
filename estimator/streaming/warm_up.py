"""Compilation ahead of the first measurement, so that `feed` never waits for it.

A filter that is thrown away processes measurements of each kind, in motion, at rest and across a gap.
Afterwards every kernel that a filter of this motion model calls is compiled, or loaded from disk.
"""

import logging
import time
from collections.abc import Iterator

from icreckon.estimator.log import measurements
from icreckon.estimator.log.input_checks import Event
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings, wander_of
from icreckon.estimator.robot.variants import Variant
from icreckon.estimator.streaming.reckoning import Reckoning

LOGGER = logging.getLogger(__name__)
INTERVAL = 10_000_000  # time between IMU samples [ns]; track speeds come at every second one
AT_ORIGIN = (0.0, 0.0, 0.0)
READY: set[tuple[object, ...]] = set()  # shapes of filters whose kernels this process has


def warm_up(model: MotionModel, robot: Robot, variant: Variant, settings: Settings) -> None:
    """Compile all kernels of a filter, once in a process for each shape of filter."""
    if settings.engine == "plain":
        return
    from icreckon.estimator.engine.model import traced_model

    wanders = wander_of(robot, settings).sigma > 0.0
    # Kernels depend on the model, the number of states, and on states that are fixed.
    shape = (type(model), traced_model(model), settings.considered, wanders)
    if shape in READY:
        return
    begin = time.perf_counter()
    discarded = Reckoning(robot, variant, settings, AT_ORIGIN, AT_ORIGIN)
    for event in _events_of_each_kind(settings):
        discarded.take(event)
    READY.add(shape)
    LOGGER.info("%s: compiled or loaded in %.1f s", variant.name, time.perf_counter() - begin)


def _events_of_each_kind(settings: Settings) -> Iterator[Event]:
    """Yield measurements in order of their stamps: in motion, at rest, across a gap."""
    stamp = 0

    def samples(count: int, left: float, right: float) -> Iterator[Event]:
        nonlocal stamp
        is_turning = left != right
        for k in range(count):
            stamp += INTERVAL
            if k % 2 == 0:
                yield TrackSpeeds(stamp, left, right)
            yield ImuSample(stamp, (0.0, 0.0, 0.1 * is_turning), (0.0, 0.01 * is_turning, 9.81))

    def fixes() -> Iterator[Event]:
        yield measurements.PositionFix(stamp, 0.0, 0.0, 1.0)
        yield measurements.HeadingFix(stamp, 0.0, 1.0)
        yield measurements.HeightFix(stamp, 0.0, 1.0)
        yield measurements.BodyVelocity(stamp, 0.1, 0.0, 1.0)
        covariance = ((1.0, 0.1, 0.0), (0.1, 1.0, 0.0), (0.0, 0.0, 1.0))
        yield measurements.PoseFix(stamp, 0.0, 0.0, 0.0, covariance)

    yield from samples(4, 0.1, 0.2)
    yield from fixes()
    yield from samples(2, 0.1, 0.2)
    stamp += INTERVAL // 2
    yield from fixes()
    yield from samples(2, 0.1, 0.2)
    yield from samples(2, 0.0, 0.0)
    yield measurements.ZeroVelocity(stamp)
    yield from samples(int(settings.standstill.duration * 1e9 / INTERVAL) + 4, 0.0, 0.0)
    stamp += int(2.0 * settings.hold * 1e9)
    yield from samples(4, 0.1, 0.2)
    # Steps with a mark are made part by part, so it comes last.
    yield measurements.Mark(stamp)
    yield from samples(2, 0.1, 0.2)
    yield from fixes()
    yield from samples(2, 0.1, 0.2)
