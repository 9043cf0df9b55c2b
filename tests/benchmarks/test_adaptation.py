"""Which parameters are learnt on the way is chosen one by one."""

from functools import cache

import msgspec
import pytest

from fed_estimators import feed_all
from icreckon import Log, PoseEstimator, Scenario, Settings, load_robot, simulate
from icreckon.estimator.robot.variants import DEFAULT_ADAPTATION, find_variant

ALPHA = load_robot("auriga-alpha")
VARIANT = "inertia-online"
# As in `Adaptation`, which says how far each may be from where it starts.
PARAMETERS = ("zeta0", "zeta1", "epsilon0", "epsilon1", "eta0", "eta1", "eta2", "epsilon_F")


@cache
def log() -> Log:
    return simulate(Scenario(duration=25.0, seed=11), ALPHA)


def driven(settings: Settings | None = None) -> PoseEstimator:
    return feed_all(PoseEstimator(ALPHA, VARIANT, settings=settings), log())


@pytest.mark.parametrize("parameter", PARAMETERS)
def test_a_parameter_can_be_kept_fixed_while_the_others_are_learnt(parameter: str) -> None:
    default = DEFAULT_ADAPTATION[find_variant(VARIANT).model]
    settings = Settings(adaptation=msgspec.structs.replace(default, **{parameter: 0.0}))
    start = PoseEstimator(ALPHA, VARIANT).parameters
    kept = driven(settings)
    assert kept.parameters[parameter] == start[parameter]
    assert kept.parameter_health[parameter].sigma == 0.0
    learnt = {name for name, value in kept.parameters.items() if value != start[name]}
    assert learnt == set(start) - {parameter, "H"}


def test_by_default_all_but_H_are_learnt() -> None:
    start, end = PoseEstimator(ALPHA, VARIANT).parameters, driven().parameters
    assert {name for name in end if end[name] != start[name]} == set(PARAMETERS)
