"""Fingerprint of the estimates: one of its cases is that of the file."""

from _scoreboard_faults import groups
from estimates import changed, kept, of_case


def test_a_case_has_the_figures_of_the_file() -> None:
    found = of_case(("faults", min(groups(), key=lambda one: len(groups()[one]))))
    assert found
    before = kept()
    assert changed({name: before[name] for name in found}, found) == []
