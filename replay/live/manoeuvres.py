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
    """List manoeuvres by which uncertain states become known, each with these states.

    `sigmas` are standard deviations of the states `names`, 0 if a state is not estimated; `fixes` is True
    for a robot with position fixes.
    """
    sigma_of = dict(zip(names, sigmas, strict=False))
    states_of: dict[str, list[str]] = {}
    for need in NEEDS:
        if (fixes or not need.fixes) and sigma_of.get(need.state, 0.0) > need.enough:
            text = f"{need.state} ± {sigma_of[need.state]:.2g}{need.unit}"
            states_of.setdefault(need.manoeuvre, []).append(text)
    return [f"{manoeuvre} ({', '.join(states)})" for manoeuvre, states in states_of.items()]
