"""Ground under the tracks, as the `[soil]` of a robot file describes it."""

from typing import Annotated, Literal

from icreckon.estimator.base.checks import Bound, Bounded, NotNegative, Positive

# Coefficient of friction; forces by far smaller ones have no precision.
Friction = Annotated[float, Bound("from 0.001 to 100", 1e-3, 100.0)]


class Soil(Bounded, frozen=True):
    """Friction and rolling resistance of the ground under a track.

    Attributes:
        friction: coefficient of friction mu, across the track, and along it unless
            `longitudinal_friction` is set [-].
        longitudinal_friction: coefficient along the track; None for isotropic friction [-].
        rolling_resistance: resistance of a track as a share of its load [-].
        shear_modulus: shear deformation modulus K; 0 for full friction at any slip [m].
        regularising_speed: slip and travel below which friction and rolling resistance fade to
            zero instead of jumping [m/s].
        resistance_opposes: "travel", the motion of the track's centreline over the ground, or
            "track", the motion of the track around its rollers.
    """

    friction: Friction = 0.9
    longitudinal_friction: Friction | None = None
    rolling_resistance: NotNegative = 0.05
    shear_modulus: NotNegative = 0.0
    regularising_speed: Positive = 1e-4
    resistance_opposes: Literal["travel", "track"] = "travel"

    @property
    def coefficients(self) -> tuple[float, float]:
        """Coefficients of friction (right, forward) [-]."""
        along = self.longitudinal_friction
        return self.friction, self.friction if along is None else along
