"""Track speeds from encoders: noise, scale errors, quantisation, dropouts.

An encoder counts. Its speed is the travel counted since the previous sample, over the time since. The
next sample contains the fraction of a count that one sample misses, so quantisation does not add up.
Noise is a density (per root second). Every parameter has its own random numbers, so that changing one
changes no other error.
"""

import msgspec
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.simulation.base.sampling import to_stamps

DROPOUT_READINGS = ("nothing", "last", "zero")
# A slower track counts as standing: a true one comes to rest exponentially, and never quite [m/s].
STANDING = 1e-4


class EncoderErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of the track speeds.

    Attributes:
        speed_noise_density: white noise of each track's speed [m/s/√Hz].
        scale_sigma: standard deviation of the relative error of the effective sprocket radius, common
            to both tracks [-].
        scale_difference_sigma: standard deviation of the left track's scale less the right one's [-].
        resolution: travel of the track per count [m]; 0 for no quantisation.
        dropouts_per_hour: mean number of dropouts per hour outside dropouts; both tracks drop out
            together.
        dropout_duration: mean length of a dropout [s]; both this and the time between dropouts are
            exponentially distributed.
        dropout_reads: reading in a dropout, one of `DROPOUT_READINGS`: "nothing" (samples are missing
            from the log), the "last" speeds before it, or "zero".
    """

    speed_noise_density: float = 0.0
    scale_sigma: float = 0.0
    scale_difference_sigma: float = 0.0
    resolution: float = 0.0
    dropouts_per_hour: float = 0.0
    dropout_duration: float = 1.0
    dropout_reads: str = "nothing"


def with_encoder_errors(
    true: Floats, times: Floats, rate: float, errors: EncoderErrors, rng: Generator
) -> TrackSpeedSeries:
    """Track speeds from encoders; exactly zero on a standing track.

    `true` (n, 2) are mean speeds since the previous sample [m/s], at `times` (n,) [s]; the `rate` [Hz]
    converts the noise density to noise per sample.
    """
    constants, events = rng.spawn(2)
    scale = 1.0 + errors.scale_sigma * rng.standard_normal()
    difference = errors.scale_difference_sigma * constants.standard_normal()
    noise = errors.speed_noise_density * np.sqrt(rate) * rng.standard_normal(true.shape)
    measured = true / (scale + difference * np.array([0.5, -0.5])) + noise
    speeds = np.where(np.abs(true) > STANDING, measured, 0.0)
    first_fraction = constants.random(2)  # of a count, at the start
    if errors.resolution > 0.0:
        steps = np.diff(times, prepend=times[0] - 1.0 / rate)[:, None]
        counts = np.floor(np.cumsum(speeds * steps, axis=0) / errors.resolution + first_fraction)
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
    """Mask (n,) of samples in a dropout; never the first one, which "last" may repeat."""
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
