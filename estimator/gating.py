"""Chi-square gates with a way back.

A wrong measurement cannot capture the filter, and a right one cannot be locked out for ever.
"""

from __future__ import annotations

import msgspec

# Quantiles of the chi-square distribution at a right-tail probability of 1e-4, by degrees of freedom
# (scipy.stats.chi2.isf, which is not imported here for the sake of a light library).
CHI_SQUARE_1E4 = {1: 15.137, 2: 18.421, 3: 21.108}


class GateSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When to stop rejecting.

    Attributes:
        patience: after this many rejections in a row the next sample is taken as right.
    """

    patience: int = 10


class Gate:
    """The gate of one kind of measurement.

    Attributes:
        rejected_in_a_row: how many it has rejected since it last admitted one.
    """

    def __init__(self, degrees: int, settings: GateSettings) -> None:
        self._threshold = CHI_SQUARE_1E4[degrees]
        self._patience = settings.patience
        self.rejected_in_a_row = 0

    @property
    def must_reacquire(self) -> bool:
        """Whether so many were rejected before the newest that the filter must be the wrong one."""
        return self.rejected_in_a_row > self._patience

    def admits(self, nis: float) -> bool:
        """Whether a measurement of this normalised innovation squared is to be used."""
        if nis <= self._threshold:
            self.rejected_in_a_row = 0
            return True
        self.rejected_in_a_row += 1
        return False

    def reacquired(self) -> None:
        """The filter was opened to the measurement; start counting anew."""
        self.rejected_in_a_row = 0
