"""Manoeuvres from which a robot's parameters become known, if they are not."""

from collections.abc import Iterable
from typing import NamedTuple


class Need(NamedTuple):
    """State of the filter, and the manoeuvre that shows it."""

    state: str  # its name in `STATE_NAMES`
    enough: float  # standard deviation with which it counts as known, in its own unit
    unit: str  # that unit, with a blank before it
    manoeuvre: str  # what to drive
    fixes: bool = False  # whether that takes position fixes, too


# On real logs without fixes, standing brings gyro_bias to 0.0003 and turning eta0 from 0.4 to 0.1, the
# others stay. In simulation with fixes, a minute of bends halves zeta0 and epsilon0. No manoeuvre
# shows the gains (zeta1, epsilon1, eta1, eta2) within minutes: `icreckon calibrate` does.
BENDS = "drive bends to both sides with position fixes"
NEEDS = (
    Need("gyro_bias", 5e-4, " rad/s", "stand still for 10 s"),
    Need("eta0", 0.2, "", "turn on the spot once to each side"),
    Need("track_scale", 0.015, "", "drive 30 m straight ahead with position fixes", fixes=True),
    Need("zeta0", 0.05, " m", BENDS, fixes=True),
    Need("epsilon0", 0.05, " m", BENDS, fixes=True),
)


def missing_manoeuvres(
    names: Iterable[str], sigmas: Iterable[float], *, fixes: bool = False
) -> list[str]:
    """Manoeuvres by which uncertain states become known, each with these states.

    Standard deviations of states that are not estimated are 0. `fixes`: the robot has position fixes.
    """
    sigma_of, unknown = dict(zip(names, sigmas, strict=False)), dict[str, list[str]]()
    for need in NEEDS:
        if sigma_of.get(need.state, 0.0) > need.enough and fixes >= need.fixes:
            text = f"{need.state} ± {sigma_of[need.state]:.2g}{need.unit}"
            unknown.setdefault(need.manoeuvre, []).append(text)
    return [f"{manoeuvre} ({', '.join(texts)})" for manoeuvre, texts in unknown.items()]
