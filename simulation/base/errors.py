"""The error of the simulation package."""

from icreckon.estimator.base.errors import IcreckonError


class SimulationError(IcreckonError, ValueError):
    """A simulation that cannot be run as configured.

    It is a `ValueError`, so that `icreckon.estimator.base.config.convert` reports the table and the file
    in which it arose.
    """
