"""Chi-square gates with a way back.

A wrong measurement cannot capture the filter, and a right one cannot be locked out for ever.
"""

from __future__ import annotations

from icreckon.estimator.robot.settings import GateSettings

# Quantiles of the chi-square distribution at a right-tail probability of 1e-4, by degrees of freedom
# (scipy.stats.chi2.isf, which is not imported here for the sake of a light library).
CHI_SQUARE_1E4 = {1: 15.137, 2: 18.421, 3: 21.108}

# What a gate says of a measurement: to be used, not to be used, to be used with the state that it
# measures made uncertain first.
ADMITTED, REJECTED, REACQUIRED = range(3)
VERDICTS = ("admitted", "rejected", "reacquired")
# A state is not made more uncertain than this many times the variance that the residual should have had:
# double precision would lose that beside it.
LARGEST_REOPENING = 1e10


def verdict(nis: float, threshold: float, rejected_in_a_row: int, patience: int) -> int:
    """Of a gate on a normalised innovation squared; for plain Python and for numba."""
    if nis <= threshold:
        return ADMITTED
    return REACQUIRED if rejected_in_a_row >= patience else REJECTED


def reopening(square: float, expected: float) -> float:
    """Variance by which to make a state uncertain that is to follow a residual.

    Args:
        square: of the residual.
        expected: variance that the residual should have had.
    """
    return min(square, LARGEST_REOPENING * expected)


class Gate:
    """The gate of one kind of measurement.

    Attributes:
        threshold: of the normalised innovation squared.
        patience: after so many rejections in a row the next sample is taken as right.
        rejected_in_a_row: how many it has rejected since it last let one pass.
    """

    def __init__(self, degrees: int, settings: GateSettings) -> None:
        self.threshold = CHI_SQUARE_1E4[degrees]
        self.patience = settings.patience
        self.rejected_in_a_row = 0

    @property
    def gives_up(self) -> bool:
        """Whether it will believe the next, whatever it says."""
        return self.rejected_in_a_row >= self.patience

    def verdict(self, nis: float) -> int:
        """The verdict on a measurement of this normalised innovation squared, not yet counted."""
        return verdict(nis, self.threshold, self.rejected_in_a_row, self.patience)

    def judge(self, nis: float) -> int:
        """The same, counted."""
        return self.count(self.verdict(nis))

    def count(self, verdict: int) -> int:
        """Count a verdict, and hand it back."""
        self.rejected_in_a_row = self.rejected_in_a_row + 1 if verdict == REJECTED else 0
        return verdict
