"""Fingerprint of the estimates: what counts as a difference, and one of its cases."""

import pytest
from _scoreboard_faults import groups
from estimates import Figures, changed, kept, of_case

BEFORE: Figures = {"run": [1.0, -20.0, 0.0]}


@pytest.mark.parametrize("after", [[1.0, -20.0, 0.0], [1.00005, -20.001, 9e-7]])
def test_rounding_is_no_difference(after: list[float]) -> None:
    assert changed(BEFORE, {"run": after}) == []


def test_each_difference_has_a_line() -> None:
    after = {"run": [1.0, -20.003, 0.0], "other": [0.0]}
    assert changed(BEFORE, after) == ["other: new", "run: -20 is -20.003 now (figure 1)"]
    lost = [1.0, float("nan"), 0.0]
    assert changed(BEFORE, {"run": lost}) == ["run: -20 is nan now (figure 1)"]
    assert changed(after, {"run": [1.0]}) == ["other: missing", "run: 3 figures, now 1"]


def test_a_case_has_the_figures_of_the_file() -> None:
    found = of_case(("faults", min(groups(), key=lambda one: len(groups()[one]))))
    assert found
    before = kept()
    assert changed({name: before[name] for name in found}, found) == []
