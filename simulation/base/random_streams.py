"""Random streams of a run, from the study's seed and the run's index alone."""

from typing import NamedTuple

import numpy as np
from numpy.random import Generator, SeedSequence

from icreckon.simulation.base.errors import SimulationError

LARGEST_SEED = 2**63 - 1  # numPy accepts larger seeds; TOML and most other programs do not


class Streams(NamedTuple):
    """Independent random streams of one run.

    New streams are appended, so that existing runs do not change.
    """

    trajectory: Generator
    truth: Generator
    tracks: Generator
    gyro: Generator
    accelerometer: Generator
    fixes: Generator


def random_streams(seed: int, run_index: int = 0) -> Streams:
    """Random streams of a run, from the study's seed and the run's index alone.

    Raises:
        SimulationError: seed or index is not a whole number from 0 to `LARGEST_SEED`.
    """
    check_whole("seed", seed)
    check_whole("run_index", run_index)
    children = SeedSequence([seed, run_index]).spawn(len(Streams._fields))
    return Streams(*(np.random.default_rng(child) for child in children))


def check_whole(name: str, value: int) -> None:
    """Reject a value that is not a whole number from 0 to `LARGEST_SEED`."""
    if not (isinstance(value, int | np.integer) and 0 <= value <= LARGEST_SEED):
        raise SimulationError(
            f"{name} must be a whole number from 0 to {LARGEST_SEED}, found {value!r}"
        )
