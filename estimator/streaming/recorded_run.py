"""One variant's run over a log, row by row."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.streaming.innovation_rows import Singles


@dataclass(frozen=True)
class Run:
    """One variant's run over a log, sampled after each pair of track speeds.

    Attributes:
        variant: name of the filter variant; with "-smoothed" behind it, of a run that was smoothed.
        trajectory: poses and twists with covariances.
        indices: (n, 3) zeta [m], epsilon [m], eta [-] of the motion at that time.
        state_names: (SIZE,) of the filter's states, see `estimator.base.state`.
        states: (n, SIZE) the filter's state.
        state_sigmas: (n, SIZE) standard deviations of the state.
        health: what became of the measurements.
        innovation_names: (k,) components of the sensors that were judged, see
            `estimator.streaming.innovation_rows`.
        innovations: (n, k) of each the newest innovation since the row before over the standard deviation
            that it should have [-], NaN where there was none; of a smoothed run there are none.
    """

    variant: str
    trajectory: Trajectory
    indices: Floats
    state_names: tuple[str, ...]
    states: Floats
    state_sigmas: Floats
    health: Health
    innovation_names: tuple[str, ...] = ()
    innovations: Singles = field(default_factory=lambda: np.zeros((0, 0), np.float32))

    @property
    def stamps(self) -> Stamps:
        """(n,) [ns]."""
        return self.trajectory.stamps
