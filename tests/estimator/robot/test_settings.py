"""What settings, adaptation and the estimator's arguments may be; the rest is refused in words."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import icreckon
from icreckon import VARIANTS, EstimatorError, Settings, default_adaptation, state_names
from icreckon.estimator.robot.variants import DEFAULT_ADAPTATION

ALPHA = icreckon.load_robot("auriga-alpha")


@pytest.mark.parametrize(
    ("kind", "name", "value", "said"),
    [
        ("Settings", "engine", "compield", "did you mean 'compiled'?"),
        ("Settings", "engine", ["plain"], "did you mean 'plain'?"),
        ("Settings", "slip", {}, "Slip(...) or None, found dict"),
        ("Settings", "adaptation", {"eta0": 0.0}, "Adaptation(...) or None, found dict"),
        ("Settings", "hold", 0.0, "no more than 1e+09 s, found 0.0"),
        ("Settings", "use_accelerometer", "no", "True or False, found 'no'"),
        ("Adaptation", "eta0", None, "zero or a positive number, found None"),
        ("GateSettings", "patience", True, "a time of 0 s or more, found True"),
    ],
)
def test_what_a_setting_cannot_be_is_refused(kind: str, name: str, value: Any, said: str) -> None:
    with pytest.raises(EstimatorError) as caught:
        getattr(icreckon, kind)(**{name: value})
    message = str(caught.value)
    assert message.startswith(f"{kind}.{name} ")
    assert said in message
    with pytest.raises(EstimatorError):
        msgspec.structs.replace(getattr(icreckon, kind)(), **{name: value})


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"robot": "auriga-alpha"}, r"found str 'auriga-alpha'; use load_robot\('auriga-alpha'\)"),
        ({"robot": Path("my.toml")}, r"use load_robot\('my.toml'\)"),
        ({"variant": ["inertia-online"]}, "did you mean 'inertia-online'?"),
        ({"settings": {"hold": 1.0}}, r"settings must be Settings\(...\) or None, found dict"),
        ({"start": (0, 0)}, r"start must be three finite numbers: x, y \[m\], yaw \[rad\], found"),
        ({"start": np.zeros((3, 1))}, "start must be three finite"),
        (
            {"start_sigma": (-1, 0, 0)},
            "start_sigma must be three finite numbers, 0 or more: the st",
        ),
    ],
)
def test_what_an_estimator_cannot_be_made_of_is_refused(arguments, said):
    with pytest.raises(EstimatorError, match=said):
        icreckon.PoseEstimator(**{"robot": ALPHA, **arguments})


@pytest.mark.parametrize("kind", [list, np.array, lambda row: np.array(row, dtype=np.float32)])
def test_the_start_may_be_any_row_of_three(kind: Any) -> None:
    estimator = icreckon.PoseEstimator(ALPHA, start=kind([1, 2, 0.5]), start_sigma=kind([1, 0, 2]))
    assert estimator.pose.tolist() == [1.0, 2.0, 0.5]
    assert estimator.pose_covariance.diagonal().tolist() == [1.0, 0.0, 4.0]


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_default_adaptation_is_what_the_filter_uses(variant: str) -> None:
    default = default_adaptation(variant)
    assert default == DEFAULT_ADAPTATION[VARIANTS[variant].model]
    told = icreckon.PoseEstimator(ALPHA, variant, settings=Settings(adaptation=default))
    assert (told.covariance == icreckon.PoseEstimator(ALPHA, variant).covariance).all()


def test_state_names_by_name_and_by_variant() -> None:
    for name, variant in VARIANTS.items():
        assert icreckon.state_names(name) == state_names(variant)
    assert icreckon.state_names("inertia-online") == icreckon.STATE_NAMES
    with pytest.raises(EstimatorError, match="did you mean"):
        icreckon.state_names("inertia-onlin")
