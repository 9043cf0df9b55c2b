"""A robot's calibration from logs with a pose truth: maximum likelihood over segments."""

from estimator.identification.identify import identify as identify
from estimator.identification.records import Identification as Identification

__all__ = ["Identification", "identify"]
