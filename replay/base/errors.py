"""The error of the replay package."""

from icreckon.estimator.base.errors import IcreckonError


class ReplayError(IcreckonError):
    """A log that cannot be read, mapped or replayed as asked."""
