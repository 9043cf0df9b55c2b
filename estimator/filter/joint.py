"""Numbers that are measured together, with noise that may be correlated: one gate, all or none.

The filter takes in one number at a time, and their noises must be independent of each other then. With
N = L D L' (L lower triangular with ones on its diagonal, D diagonal) the numbers L⁻¹ z have noise D, and
say the same as z (Simon, Optimal State Estimation, section 6.1).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.look_ahead import Foretold, Surprise
from icreckon.estimator.sensors.sensor_models import Reading, shift


class Joint(NamedTuple):
    """Three numbers that were measured, set against what was foretold of them.

    Attributes:
        residual: (3,) measured less foretold.
        rows: (3, SIZE) derivative of what was foretold by the state.
        noise: (3, 3) covariance of the measurement and of what the state does not tell.
        foretold_at: (SIZE,) the state that it was foretold at.
    """

    residual: Floats
    rows: Floats
    noise: Floats
    foretold_at: Floats

    @classmethod
    def of(cls, residual: Floats, covariance: Floats, foretold: Foretold, x: Floats) -> Joint:
        """What was measured against what was foretold.

        Args:
            residual: (3,) measured less foretold.
            covariance: (3, 3) of the measurement, symmetric to rounding.
            foretold: at the state `x`.
            x: (SIZE,) the state.
        """
        symmetric = 0.5 * (covariance + covariance.T)
        return cls(residual, foretold.by_state, symmetric + foretold.covariance, x.copy())

    def surprise(self, P: Floats) -> Surprise:
        """How far the numbers are from what was foretold, at a covariance (SIZE, SIZE) of the state."""
        spread = self.rows @ P @ self.rows.T + self.noise
        nis = float(self.residual @ np.linalg.solve(spread, self.residual))
        return Surprise(self.residual, spread, nis)

    def readings(self) -> Iterator[Reading]:
        """The same as numbers of independent noise, one after the other, at the state of foretelling."""
        root = np.linalg.cholesky(self.noise)
        scale = root.diagonal()
        mix = root / scale
        rows, residual = np.linalg.solve(mix, self.rows), np.linalg.solve(mix, self.residual)
        for axis, sigma in enumerate(scale.tolist()):
            yield Reading(residual.item(axis), rows[axis], sigma * sigma)

    def left_of(self, reading: Reading, x: Floats) -> Reading:
        """One of `readings` at a state (SIZE,) that those before it have moved."""
        moved = shift(reading.row, x, self.foretold_at)
        return reading._replace(residual=reading.residual - moved)
