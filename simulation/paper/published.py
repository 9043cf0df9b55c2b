"""Numbers that the paper publishes of Auriga-alpha, with their units and places.

A number is stored as the printed text, which gives both its value and the number of published digits.
The largest steering efficiency is not printed: it is read off a figure, and listed separately.
"""

from functools import cache

import msgspec

from icreckon.estimator.motion.icr import PaperTwist
from icreckon.estimator.motion.motion_model import VehicleConstants
from icreckon.estimator.robot.robot_file import PAPER_PARAMETERS, ConstantIcr, Indices

# Tolerance of rounding to nearest in binary floating point, as a share of the last digit.
ROUNDING_NOISE = 1e-9


class PublishedNumber(msgspec.Struct, frozen=True):
    """Number published in the paper."""

    name: str  # name used in tables, results and tests
    unit: str  # SI unit, "" for none
    printed: str  # the digits as the paper prints them
    where: str  # the place in the paper
    read_off: bool = False  # True if it is read off a figure instead of printed

    @property
    def value(self) -> float:
        """Value of the number [unit]."""
        return float(self.printed)

    def rounds_from(self, reproduced: float) -> bool:
        """Return True if a value [unit] rounds to the published digits; False for NaN."""
        _, _, decimals = self.printed.partition(".")
        half = 0.5 * 10.0 ** -len(decimals)
        return abs(reproduced - self.value) <= half * (1.0 + ROUNDING_NOISE)


_MEANS = "section II, under Fig. 3"
_FITS = "section III-C"
_TABLE = "Table II"

PUBLISHED: tuple[PublishedNumber, ...] = (
    PublishedNumber("mean_x_ICRl", "m", "-0.458", _MEANS),
    PublishedNumber("mean_x_ICRr", "m", "0.630", _MEANS),
    PublishedNumber("mean_y_ICR", "m", "0.0482", _MEANS),
    PublishedNumber("H", "", "0.67134", "section III-A, (13)"),
    PublishedNumber("zeta0", "m", "0.048", f"{_FITS}, (25)"),
    PublishedNumber("zeta1", "m/N", "0.0002424", f"{_FITS}, (25)"),
    PublishedNumber("epsilon0", "m", "0.106", f"{_FITS}, (26)"),
    PublishedNumber("epsilon1", "m/N", "0.0011", f"{_FITS}, (26)"),
    PublishedNumber("eta0", "", "2.62", f"{_FITS}, (27)"),
    PublishedNumber("eta1", "1/N", "0.0019", f"{_FITS}, (27)"),
    PublishedNumber("eta2", "1/N²", "0.00001", f"{_FITS}, (27)"),
    PublishedNumber("rmse_inertia_v_x", "m/s", "0.0044424", _TABLE),
    PublishedNumber("rmse_inertia_v_y", "m/s", "0.0383464", _TABLE),
    PublishedNumber("rmse_inertia_w", "rad/s", "0.0637394", _TABLE),
    PublishedNumber("rmse_constant_v_x", "m/s", "0.015962", _TABLE),
    PublishedNumber("rmse_constant_v_y", "m/s", "0.0821718", _TABLE),
    PublishedNumber("rmse_constant_w", "rad/s", "0.143285", _TABLE),
)
READ_OFF: tuple[PublishedNumber, ...] = (
    PublishedNumber("largest_eta", "", "4.15", "read off Fig. 7c", read_off=True),
)

# Table I: gauge L [m], mass M [kg], x_CM and y_CM [m].
AURIGA_ALPHA = VehicleConstants(gauge=0.42, mass=258.0, x_CM=-0.015, y_CM=0.04)


@cache
def published(name: str) -> PublishedNumber:
    """Published number by its name; KeyError if it is unknown."""
    return {number.name: number for number in (*PUBLISHED, *READ_OFF)}[name]


def published_parameters() -> Indices:
    """Eight index parameters as published (section III)."""
    return Indices(**{name: published(name).value for name in PAPER_PARAMETERS})


def published_mean_icrs() -> ConstantIcr:
    """Constant ICRs as published (section II)."""
    names = ("x_ICRl", "x_ICRr", "y_ICR")
    return ConstantIcr(*(published(f"mean_{name}").value for name in names))


def published_errors(model: str) -> PaperTwist:
    """Column of Table II [m/s, m/s, rad/s], of the model "inertia" or "constant"."""
    return PaperTwist(*(published(f"rmse_{model}_{part}").value for part in PaperTwist._fields))
