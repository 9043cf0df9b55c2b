"""What the encoders of the tracks read of a true motion.

An encoder counts. Its speed is the travel counted since the sample before, over the time since: what
one sample misses of a count the next one has, so quantisation does not add up. Noise is a density (per
root second). Every figure has its own random numbers, so that changing one changes no other error.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.simulation.base.sampling import to_stamps
from icreckon.simulation.truth.true_motion import TrueMotion

DROPOUT_READINGS = ("nothing", "last", "zero")

# A slower track stands: a true one comes to rest exponentially, and never quite [m/s].
STANDING = 1e-4


class EncoderErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of the track speeds.

    Attributes:
        speed_noise_density: white noise of each track's speed [m/s/√Hz].
        scale_sigma: of the unknown part of the effective sprocket radius, both tracks alike [-].
        scale_difference_sigma: of the left track's scale less the right one's [-].
        resolution: travel of the track for each count [m]; 0 for an encoder that does not count.
        dropouts_per_hour: mean number of dropouts in an hour without; both tracks drop out together.
        dropout_duration: mean length of a dropout [s]; both this and the time between dropouts are
            exponentially distributed.
        dropout_reads: what samples read in a dropout, one of `DROPOUT_READINGS`: "nothing" (they are
            missing from the log), the "last" speeds before it, or "zero".
    """

    speed_noise_density: float = 0.0
    scale_sigma: float = 0.0
    scale_difference_sigma: float = 0.0
    resolution: float = 0.0
    dropouts_per_hour: float = 0.0
    dropout_duration: float = 1.0
    dropout_reads: str = "nothing"


def read_tracks(
    motion: TrueMotion, times: Floats, rate: float, errors: EncoderErrors, rng: Generator
) -> TrackSpeedSeries:
    """Track speeds from encoders: averages since the sample before; exactly zero on a standing track.

    Args:
        motion: the true motion.
        times: (n,) when to sample [s].
        rate: samples per second [Hz], which turns density into noise per sample.
        errors: of the track speeds.
        rng: draws the errors.
    """
    return with_encoder_errors(motion.mean_track_speeds(times), times, rate, errors, rng)


def with_encoder_errors(
    true: Floats, times: Floats, rate: float, errors: EncoderErrors, rng: Generator
) -> TrackSpeedSeries:
    """What encoders read of true mean speeds (n, 2) since the sample before [m/s]; see `read_tracks`."""
    constants, events = rng.spawn(2)
    scale = 1.0 + errors.scale_sigma * rng.standard_normal()
    difference = errors.scale_difference_sigma * constants.standard_normal()
    noise = errors.speed_noise_density * np.sqrt(rate) * rng.standard_normal(true.shape)
    measured = true / (scale + difference * np.array([0.5, -0.5])) + noise
    speeds = np.where(np.abs(true) > STANDING, measured, 0.0)
    begun = constants.random(2)
    if errors.resolution > 0.0:
        steps = np.diff(times, prepend=times[0] - 1.0 / rate)[:, None]
        counts = np.floor(np.cumsum(speeds * steps, axis=0) / errors.resolution + begun)
        speeds = np.diff(counts, axis=0, prepend=0.0) * errors.resolution / steps
    lost = _dropouts(times, errors, events)
    if errors.dropout_reads == "nothing":
        times, speeds = times[~lost], speeds[~lost]
    elif errors.dropout_reads == "last":
        speeds = speeds[np.maximum.accumulate(np.where(lost, 0, np.arange(len(times))))]
    else:
        speeds = np.where(lost[:, None], 0.0, speeds)
    return TrackSpeedSeries(to_stamps(times), speeds)


def _dropouts(times: Floats, errors: EncoderErrors, rng: Generator) -> NDArray[np.bool_]:
    """Which samples (n,) fall into a dropout; the first one, at the start of the run, never does."""
    lost = np.zeros(len(times), dtype=bool)
    if errors.dropouts_per_hour == 0.0:
        return lost
    end = times[0]
    while True:
        start = end + rng.exponential(3600.0 / errors.dropouts_per_hour)
        end = start + rng.exponential(errors.dropout_duration)
        if start > times[-1]:
            return lost
        first, after = np.searchsorted(times, [start, end], side="right")
        lost[first:after] = True
