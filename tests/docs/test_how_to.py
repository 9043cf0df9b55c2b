"""The guides: their commands run, and print what they show."""

from pathlib import Path

import pytest

from conftest import thorough
from readme import ROOT, blocks, run_page

GUIDES = (
    "how-to/drifts-while-standing.md",
    "how-to/lidar-odometry.md",
    "how-to/obstacles-smear.md",
    "how-to/several-logs.md",
    "how-to/simulators.md",
    "how-to/turns-too-far.md",
    "how-to/wheels-and-gps.md",
    "how-to/where-is-the-icr.md",
    "how-to/which-gyro.md",
    "tutorials/microcontroller.md",
    "tutorials/simulate-and-study.md",
)
# Half a minute each and more, of what other tests and the cross build show, too.
LONGEST = ("how-to/several-logs.md", "how-to/which-gyro.md", "tutorials/microcontroller.md")
ELSEWHERE = {"check.md", "embedding.md", "from-robot-localization.md", "three-dimensions.md"}
"""Guides whose commands other tests run."""


def test_no_guide_is_left_out() -> None:
    pages = {page.name for page in (ROOT / "docs" / "how-to").glob("*.md")}
    with_commands = {
        page
        for page in pages
        if {kind for kind, _ in blocks(f"docs/how-to/{page}")} & {"sh", "python"}
    }
    assert with_commands == ELSEWHERE | {Path(page).name for page in GUIDES if "how-to" in page}


@pytest.mark.slow
@pytest.mark.parametrize("page", [thorough(page) if page in LONGEST else page for page in GUIDES])
def test_a_guide_runs(page: str, tmp_path: Path) -> None:
    run_page(f"docs/{page}", tmp_path)
