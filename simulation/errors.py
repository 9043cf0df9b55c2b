"""The error of the simulation package."""

from estimator.errors import IcreckonError


class SimulationError(IcreckonError):
    """A simulation that cannot be run as asked."""
