"""Error type of the replay package."""

from icreckon.estimator.base.errors import IcreckonError


class ReplayError(IcreckonError):
    """A log cannot be read, mapped or replayed as requested."""
