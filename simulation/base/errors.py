"""The error of the simulation package."""

from icreckon.estimator.base.errors import IcreckonError


class SimulationError(IcreckonError, ValueError):
    """A simulation that cannot be run as asked.

    It is a `ValueError`, so that `estimator.base.config.convert` says in which table of which file it
    arose.
    """
