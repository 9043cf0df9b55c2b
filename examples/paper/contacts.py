"""Parameters that the paper leaves open: contact, soil, height, and reading.

`PaperContact` is the content of a TOML file; the best known one is `contact.toml`.
"""

from pathlib import Path
from typing import Literal

import msgspec
from readings import Reading

from icreckon.estimator.base.config import convert, read_toml
from icreckon.estimator.robot.soil import Soil
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.contact.contact import Body, Contact, ContactGeometry, equally_spaced
from icreckon.simulation.paper.published import AURIGA_ALPHA

BEST_FILE = Path(__file__).parent / "contact.toml"


class ContactParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Contact of Auriga-alpha; mass, gauge, x_CM and y_CM are those of Table I."""

    half_length: float = 0.39  # half the length of a track's contact [m]
    points: int = 5  # contact points along each track, evenly spaced
    end_weight: float = 1.0  # weight of the first and last point, relative to those between [-]
    tread_width: float = 0.0  # width of each contact, by three points across; 0 for one point [m]
    z_CM: float = 0.79  # height of the centre of mass [m]
    friction: float = 0.9  # coefficient across the track, and along it times `friction_ratio` [-]
    friction_ratio: float = 1.0  # along over across [-]
    rolling_resistance: float = 0.074  # of a track as a share of its load [-]
    # "travel" or "track", see `icreckon.simulation.contact.contact.Soil`
    resistance_opposes: Literal["travel", "track"] = "travel"
    shear_modulus: float = 0.0  # K; 0 for full friction at any slip [m]


class PaperContact(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Guess at all parameters that the paper leaves open."""

    contact: ContactParameters = ContactParameters()  # the robot on its ground
    reading: Reading = Reading()  # method that derives the numbers from its motions


def make_contact(parameters: ContactParameters) -> Contact:
    """Make the contact model of Auriga-alpha.

    Raises:
        SimulationError: the values are no valid contact.
    """
    half = 0.5 * parameters.tread_width
    try:
        even = equally_spaced(AURIGA_ALPHA.gauge, parameters.half_length, parameters.points)
        inner = (1.0,) * (parameters.points - 2)
        weights = parameters.end_weight, *inner, parameters.end_weight
        across = (-half, 0.0, half) if half > 0.0 else (0.0,)
        soil = Soil(
            friction=parameters.friction,
            longitudinal_friction=parameters.friction * parameters.friction_ratio,
            rolling_resistance=parameters.rolling_resistance,
            resistance_opposes=parameters.resistance_opposes,
            shear_modulus=parameters.shear_modulus,
        )
        geometry = ContactGeometry(even.gauge, even.positions, weights=weights, across=across)
        body = Body(AURIGA_ALPHA.mass, AURIGA_ALPHA.x_CM, AURIGA_ALPHA.y_CM, parameters.z_CM)
        return Contact(soil, geometry, body)
    except ValueError as error:
        raise SimulationError(f"these contact parameters make no sense: {error}") from error


def load_paper_contact(path: Path = BEST_FILE) -> PaperContact:
    """Load a guess from a TOML file; the best known one by default.

    Raises:
        SimulationError: no such file, a misspelt key, a wrong type or a bad value.
    """
    return convert(read_toml(path, SimulationError), PaperContact, str(path), SimulationError)
