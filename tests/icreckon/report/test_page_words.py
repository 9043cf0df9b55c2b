"""What a stranger needs on the page of a comparison: terms, constant parameters, titles, rows."""

import copy
import re
from typing import Any

import pytest

from icreckon import Scenario, compare, load_robot, simulate, summarise
from icreckon.replay.comparison.plot_series import series_points
from icreckon.report.replay.page import replay_page
from icreckon.report.replay.page_charts import constant_parameters, page_data
from icreckon.report.terms import TERMS


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    robot = load_robot("auriga-alpha")
    log = simulate(Scenario(duration=40.0, seed=4, outages=((15.0, 40.0),)), robot)
    found = compare(log, robot, ["constant-online", "inertia-online"])
    return summarise(found, robot, command="replay", configuration={"log": "run"})


@pytest.fixture(scope="module")
def page(results: dict[str, Any]) -> str:
    return replay_page(results)


def test_each_term_is_explained_without_a_script(page: str) -> None:
    """A popover opens by a tap or a key, a title on hover; neither needs JavaScript."""
    for one in TERMS:
        assert page.count(f'popover id="term-{one.key}"') == 1
    targets = set(re.findall(r'popovertarget="term-([\w-]+)"', page))
    assert targets <= {one.key for one in TERMS}
    assert {"nees", "nis", "sigma", "drift", "innovation", "icr", "rmse"} <= targets
    for button in re.findall(r"<button [^>]*popovertarget[^>]*>", page):
        assert 'type="button"' in button
        assert re.search(r'title="[^"]{20,}"', button)


def test_a_parameter_that_the_log_does_not_move_is_no_chart(results: dict[str, Any]) -> None:
    flat = copy.deepcopy(results)
    for one in flat["series"]["variants"].values():
        learnt = one["parameters"]["gyro_bias"]
        learnt["value"] = [1.5e-4] * len(learnt["value"])
        learnt["sigma"] = [2e-3] * len(learnt["sigma"])
    assert constant_parameters(flat)["gyro_bias"]["inertia-online"] == (1.5e-4, 2e-3)
    titles = [chart["title"] for chart in page_data(flat)["charts"]]
    assert "Bias of the gyro" not in titles
    row = re.search(r"<td class=\"text\">gyro_<wbr>bias</td>(.*?)</tr>", replay_page(flat), re.S)
    assert "0.00015 ± 0.004 rad/s" in row[1]
    assert "constant-online, inertia-online" in row[1]


@pytest.mark.parametrize("change", ["value", "sigma"])
def test_a_parameter_that_one_variant_learns_is_a_chart(results, change):
    moved = copy.deepcopy(results)
    for name, one in moved["series"]["variants"].items():
        learnt = one["parameters"]["gyro_bias"]
        learnt["value"] = [0.0] * len(learnt["value"])
        learnt["sigma"] = [2e-3] * len(learnt["sigma"])
        if name == "inertia-online":
            learnt[change][-1] = 1e-3
    # The level line of the other would only lie over it.
    assert list(constant_parameters(moved)["gyro_bias"]) == ["constant-online"]
    (chart,) = (one for one in page_data(moved)["charts"] if one["title"] == "Bias of the gyro")
    for part in ("lines", "bands"):
        assert [one["series"] for one in chart[part]] == ["inertia-online"]


@pytest.mark.parametrize(("seconds", "rows"), [(90.0, 1500), (600.0, 2400), (36_000.0, 4000)])
def test_longer_logs_have_more_rows_up_to_a_limit(seconds: float, rows: int) -> None:
    assert series_points(seconds) == rows
