"""The page of limits lists those that the code has."""

import re

import pytest

from conftest import REPOSITORY
from icreckon.cli.common.console import LONGEST_LINE
from icreckon.estimator.base import checks
from icreckon.estimator.robot import robot_file, settings
from icreckon.replay.bags import table_files, unpacking
from icreckon.replay.inspection import topic_survey
from icreckon.simulation import scenario
from icreckon.simulation.drives import recorded
from icreckon.simulation.study import plan

NUMBER = re.compile(r"\d+(?: \d{3})*(?:\.\d+)?(?:e-?\d+)?")
ROWS = {
    "unpacked size of a chunk": (unpacking.MOST_IN_MEMORY / unpacking.GIGABYTE,),
    "columns of a table": (table_files.MOST_COLUMNS,),
    "messages of a topic": (topic_survey.SAMPLES, topic_survey.SAMPLE_BYTES),
    "characters of a line": (LONGEST_LINE,),
    "any number": (checks.LARGEST_NUMBER, checks.LEAST_POSITIVE),
    "contact points": (robot_file.MOST_POINTS,),
    "`Settings.history`": (settings.LONGEST_HISTORY,),
    "rate of a simulated": (scenario.HIGHEST_RATE,),
    "samples of a simulated": (scenario.MOST_SAMPLES,),
    "recorded drive": (recorded.LONGEST_RECORDING,),
    "cells of a study": (plan.MOST_CELLS,),
    "runs of a cell": (plan.MOST_RUNS,),
}


@pytest.mark.parametrize("row", ROWS)
def test_a_limit_is_the_one_of_the_code(row: str) -> None:
    text = (REPOSITORY / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
    text = text.partition("## Limits")[2].partition("## Size")[0]
    (line,) = (line for line in text.splitlines() if line.startswith(f"| {row}"))
    found = {float(number.replace(" ", "")) for number in NUMBER.findall(line)}
    assert set(ROWS[row]) <= found
