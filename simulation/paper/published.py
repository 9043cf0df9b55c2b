"""The numbers that the paper publishes of Auriga-alpha, as printed, with units and places.

A number is kept as the text that the paper prints, which says both its value and how many digits of it
are published. The largest steering efficiency is nowhere printed: it is read off a figure, and stands
apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from functools import cache

from icreckon.estimator.motion.icr import PaperTwist
from icreckon.estimator.motion.motion_model import VehicleConstants
from icreckon.estimator.robot.robot_file import ConstantIcr, Indices

# Rounding to nearest is decided in binary floating point; this much of a unit is its noise.
ROUNDING_NOISE = 1e-9


@dataclass(frozen=True)
class PublishedNumber:
    """One number of the paper.

    Attributes:
        name: ours, the same in tables, results and tests.
        unit: SI unit, "" for none.
        printed: the digits as the paper prints them.
        where: the place in the paper.
        read_off: whether it is read off a figure instead of printed.
    """

    name: str
    unit: str
    printed: str
    where: str
    read_off: bool = False

    @property
    def value(self) -> float:
        """The number [unit]."""
        return float(self.printed)

    @property
    def decimals(self) -> int:
        """Published digits after the point."""
        return max(0, -int(Decimal(self.printed).as_tuple().exponent))

    @property
    def significant_digits(self) -> int:
        """Published digits from the first that is not zero."""
        return len(Decimal(self.printed).as_tuple().digits)

    def rounds_from(self, reproduced: float) -> bool:
        """Whether a reproduced value, rounded to the published digits, is the published number.

        Args:
            reproduced: [unit]; NaN never rounds to anything.
        """
        half = 0.5 * 10.0**-self.decimals
        return abs(reproduced - self.value) <= half * (1.0 + ROUNDING_NOISE)

    def difference_percent(self, reproduced: float) -> float:
        """Reproduced less published, as a share of the published size [%]."""
        return 100.0 * (reproduced - self.value) / abs(self.value)


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
    """The published number of that name.

    Raises:
        KeyError: there is none.
    """
    return {number.name: number for number in (*PUBLISHED, *READ_OFF)}[name]


def published_parameters() -> Indices:
    """The eight parameters as published (section III)."""
    return Indices(**{name: published(name).value for name in Indices.__struct_fields__})


def published_mean_icrs() -> ConstantIcr:
    """The constant ICRs as published (section II)."""
    names = ("x_ICRl", "x_ICRr", "y_ICR")
    return ConstantIcr(*(published(f"mean_{name}").value for name in names))


def published_errors(model: str) -> PaperTwist:
    """A column of Table II [m/s, m/s, rad/s].

    Args:
        model: "inertia" or "constant".
    """
    return PaperTwist(*(published(f"rmse_{model}_{part}").value for part in PaperTwist._fields))
