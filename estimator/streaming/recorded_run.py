"""Run of one variant over a log, row by row."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.streaming.innovation_rows import Singles


@dataclass(frozen=True)
class Run:
    """Run of one variant over a log, sampled after each pair of track speeds.

    Attributes:
        variant: name of the filter variant, with "-smoothed" appended if the run is smoothed.
        trajectory: poses and twists with covariances.
        indices: (n, 3) zeta [m], epsilon [m], eta [-] of the motion at that time.
        state_names: (SIZE,) names of the states, see `icreckon.estimator.base.state`.
        states: (n, SIZE) states of the filter.
        state_sigmas: (n, SIZE) standard deviations of the states.
        health: counts of the measurements.
        innovation_names: (k,) components of the sensors with innovations, see
            `icreckon.estimator.streaming.innovation_rows`.
        innovations: (n, k) newest innovation of each component since the row before, over its predicted
            standard deviation [-]; NaN if there was none. A smoothed run has no innovations.
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
        """Stamps (n,) of the rows [ns]."""
        return self.trajectory.stamps
