"""Chi-square gates with re-acquisition.

A wrong measurement cannot capture the filter, and a right one cannot be rejected for ever.
"""

from __future__ import annotations

from icreckon.estimator.robot.settings import GateSettings

# Quantiles of the chi-square distribution at a right-tail probability of 1e-4, by degrees of freedom
# (scipy.stats.chi2.isf, which is not imported here for the sake of a light library).
CHI_SQUARE_1E4 = {1: 15.137, 2: 18.421, 3: 21.108}

# Verdicts of a gate. A re-acquired measurement is used after the variance of the states that it measures
# was inflated.
ADMITTED, REJECTED, REACQUIRED = range(3)
VERDICTS = ("admitted", "rejected", "reacquired")
# Largest inflation, over the variance of the innovation: double precision would lose that beside more.
LARGEST_INFLATION = 1e10


def verdict(nis: float, threshold: float, rejected_in_a_row: int, patience: int) -> int:
    """Verdict of a gate; plain Python, for numba too.

    Args:
        nis: normalised innovation squared.
        threshold: threshold of the gate.
        rejected_in_a_row: rejections since the gate last let a measurement pass.
        patience: rejections in a row after which the next measurement is re-acquired.
    """
    if nis <= threshold:
        return ADMITTED
    return REACQUIRED if rejected_in_a_row >= patience else REJECTED


def inflation(square: float, expected: float) -> float:
    """Variance to add to a state that is to follow an innovation.

    Args:
        square: square of the innovation.
        expected: its variance, before the inflation.
    """
    return min(square, LARGEST_INFLATION * expected)


class Gate:
    """Gate of one sensor.

    Args:
        degrees: number of components of the innovation.
        settings: settings of all gates.

    Attributes:
        threshold: threshold of the normalised innovation squared.
        patience: rejections in a row after which the next measurement is re-acquired.
        rejected_in_a_row: rejections since the gate last let a measurement pass.
    """

    def __init__(self, degrees: int, settings: GateSettings) -> None:
        self.threshold = CHI_SQUARE_1E4[degrees]
        self.patience = settings.patience
        self.rejected_in_a_row = 0

    def judge(self, nis: float) -> int:
        """Return the verdict on a normalised innovation squared, and count it."""
        return self.count(verdict(nis, self.threshold, self.rejected_in_a_row, self.patience))

    def count(self, verdict: int) -> int:
        """Count a verdict, and return it."""
        self.rejected_in_a_row = self.rejected_in_a_row + 1 if verdict == REJECTED else 0
        return verdict
