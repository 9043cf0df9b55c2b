"""Truth models by name; each moves a simulated robot."""

from typing import Any

from icreckon.estimator.base.errors import nearest_hint
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.truth.friction import FrictionTruth
from icreckon.simulation.truth.kinematic import KinematicTruth
from icreckon.simulation.truth.true_motion import TruthModel

TRUTHS: dict[str, type[FrictionTruth] | type[KinematicTruth]] = {
    "friction": FrictionTruth,
    "kinematic": KinematicTruth,
}


def make_truth(name: str, options: dict[str, Any]) -> TruthModel:
    """Make a truth model by name.

    Args:
        name: one of `TRUTHS`.
        options: fields of the model; None stands for the model's default.

    Raises:
        SimulationError: an unknown truth (the message names the nearest), or one that does not support
            the given lag, terrain or payload.
    """
    if name not in TRUTHS:
        raise SimulationError(f"no truth named {name!r}{nearest_hint(name, list(TRUTHS))}")
    given = {key: value for key, value in options.items() if value is not None}
    unknown = [key for key in given if key not in TRUTHS[name].__dataclass_fields__]
    if unknown:
        raise SimulationError(
            f"the {name} truth does not support {' or '.join(unknown)}; use truth = 'friction'"
        )
    return TRUTHS[name](**given)
