"""Truth models by name; each moves a simulated robot."""

from typing import Any

from icreckon.estimator.base.errors import nearest_hint
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.truth.friction import FrictionTruth
from icreckon.simulation.truth.kinematic import KinematicTruth
from icreckon.simulation.truth.terrain import Patch, Payload, Terrain
from icreckon.simulation.truth.true_motion import DEFAULT_SPREAD, TruthModel

TRUTHS: dict[str, type[FrictionTruth] | type[KinematicTruth]] = {
    "friction": FrictionTruth,
    "kinematic": KinematicTruth,
}


def make_truth(
    name: str,
    spread: float = DEFAULT_SPREAD,
    *,
    slip_noise: float | None = None,
    track_lag: float | None = None,
    terrain: Terrain | None = None,
    patches: tuple[Patch, ...] = (),
    payloads: tuple[Payload, ...] = (),
) -> TruthModel:
    """Make a truth model by name; None stands for the model's default.

    Args:
        name: one of `TRUTHS`.
        spread: relative spread of the true robot about its file.
        slip_noise: factor on the slip residual `icreckon.simulation.truth.true_motion.TRUE_SLIP` [-].
        track_lag: time constant of the tracks behind their commands [s].
        terrain: shape of the ground; level is None, too.
        patches: terrain along the path.
        payloads: loads along the path.

    Raises:
        SimulationError: an unknown truth (the message names the nearest), or one that does not support
            the given lag, terrain or payload.
    """
    if name not in TRUTHS:
        raise SimulationError(f"no truth named {name!r}{nearest_hint(name, list(TRUTHS))}")
    options: dict[str, Any] = {
        "slip_noise": slip_noise,
        "track_lag": track_lag,
        "terrain": None if terrain is None or terrain.is_level else terrain,
        "patches": patches or None,
        "payloads": payloads or None,
    }
    given = {key: value for key, value in options.items() if value is not None}
    unknown = [key for key in given if key not in TRUTHS[name].__dataclass_fields__]
    if unknown:
        raise SimulationError(
            f"the {name} truth does not support {' or '.join(unknown)}; use truth = 'friction'"
        )
    return TRUTHS[name](spread=spread, **given)
