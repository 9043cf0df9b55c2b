"""Terms of the pages' tables and charts, explained on hover, tap or focus."""

import re
from typing import NamedTuple


class Term(NamedTuple):
    """Term: key in the page, name, meaning, pattern of headings that use it (the key)."""

    key: str
    name: str
    meaning: str
    pattern: str = ""


TERMS = (
    Term(
        "nees",
        "NEES, normalised estimation error squared",
        "The pose error, weighed by the filter's own covariance. If that is right, the mean is 3 for "
        "a pose (x, y, yaw) and 2 for a position. More: the filter is too sure. Less: too cautious.",
    ),
    Term(
        "nis",
        "NIS, normalised innovation squared",
        "The innovation of a sensor squared, over the variance that it should have. 1 per degree of "
        "freedom is ideal. More: the sensor is noisier than in the robot file, or the model is wrong.",
    ),
    Term(
        "innovation",
        "Innovation",
        "A measurement less what the filter expected of it.",
        r"\binnovations?\b",
    ),
    Term(
        "sigma",
        "σ, sigma",
        "The standard deviation that the filter reports. If it is right, 68 % of the errors are "
        "within 1σ, 95 % within 2σ and 99.7 % within 3σ.",
        r"σ|\bsigma\b",
    ),
    Term(
        "yaw-drift",
        "Yaw drift",
        "Heading error after 30 s of dead reckoning, over the distance driven in that time.",
        r"\byaw drift\b",
    ),
    Term(
        "drift",
        "Drift",
        "Position error at the end of a stretch of dead reckoning, with estimate and truth aligned "
        "at its start, in % of the distance driven.",
    ),
    Term(
        "ratio",
        "Ratio",
        "Drift over that of another filter, on the same stretches. Below 1 is better. An interval "
        "that holds 1 may be chance.",
    ),
    Term(
        "rmse",
        "RMSE, root mean square error",
        "Size of the usual error of a speed, large ones counted more.",
    ),
    Term(
        "icr",
        "ICR, instantaneous centre of rotation",
        "The point about which the robot turns at a moment. Each track has one, too: the point where its "
        "tread would not slide over the ground.",
        r"\bICRs?\b",
    ),
    Term(
        "apart",
        "Apart",
        "Distance from the variant that the others are compared with, since there is no ground truth.",
    ),
    Term(
        "rejected",
        "Rejected",
        "Measurements that the filter did not use, since they were too far from what it expected "
        "(gate), or implausible on their own.",
    ),
    Term(
        "standstill",
        "Standstill updates",
        "Moments at which tracks and IMU showed the robot at rest, and the filter used a speed of zero.",
    ),
)


def term_of(heading: str) -> Term | None:
    """Return the first term that a heading uses; None for none."""
    for term in TERMS:
        if re.search(term.pattern or rf"\b{term.key}\b", heading, re.IGNORECASE):
            return term
    return None
