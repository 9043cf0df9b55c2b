"""What goes wrong with many filters at once."""

from __future__ import annotations

from estimator.errors import EstimatorError


class BatchError(EstimatorError):
    """Runs or filters that cannot be worked through side by side."""
