"""Which parameters are learnt on the way is chosen one by one."""

from functools import cache

import msgspec
import pytest

from fed_estimators import feed_all
from icreckon import Log, PoseEstimator, Scenario, Settings, load_robot, simulate
from icreckon.estimator.robot.variants import DEFAULT_ADAPTATION, find_variant

ALPHA = load_robot("auriga-alpha")
# Parameter -> the figure of `Adaptation` that says how far it may be from where it starts.
OF_INDICES = {
    name: name
    for name in ("zeta0", "zeta1", "epsilon0", "epsilon1", "eta0", "eta1", "eta2", "epsilon_F")
}
CASES = [("inertia-online", *case) for case in OF_INDICES.items()]


@cache
def log() -> Log:
    return simulate(Scenario(duration=25.0, seed=11), ALPHA)


def driven(variant: str, settings: Settings | None = None) -> PoseEstimator:
    return feed_all(PoseEstimator(ALPHA, variant, settings=settings), log())


@pytest.mark.parametrize(("variant", "parameter", "figure"), CASES)
def test_a_parameter_can_be_kept_fixed_while_the_others_are_learnt(
    variant: str, parameter: str, figure: str
) -> None:
    default = DEFAULT_ADAPTATION[find_variant(variant).model]
    settings = Settings(adaptation=msgspec.structs.replace(default, **{figure: 0.0}))
    start = PoseEstimator(ALPHA, variant).parameters
    kept = driven(variant, settings)
    assert kept.parameters[parameter] == start[parameter]
    assert kept.parameter_health[parameter].sigma == 0.0
    learnt = {name for name, value in kept.parameters.items() if value != start[name]}
    assert learnt == set(start) - {parameter, "H"}


def test_by_default_all_but_H_are_learnt() -> None:
    variant = "inertia-online"
    start, end = PoseEstimator(ALPHA, variant).parameters, driven(variant).parameters
    assert {name for name in end if end[name] != start[name]} == set(OF_INDICES)
