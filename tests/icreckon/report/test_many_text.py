"""Words on several logs and robot files, from results made by hand."""

from typing import Any

import pytest

from icreckon.report.replay.many_page import drift_picture, many_page
from icreckon.report.replay.many_text import UNSCORED, many_headline, many_remarks

HORIZONS = ("10s", "30s", "60s", "5m", "10m", "30m", "50m")


def verdict(best: str, percent: float) -> dict[str, Any]:
    return {
        "horizon": "30s",
        "best": best,
        "drift_percent": percent,
        "drift_percent_95": [0.9 * percent, 1.2 * percent],
        "baseline": "gyro",
        "ratio": 0.5,
        "ratio_95": [0.4, 0.6],
        "ratios_to_best": {"gyro": 2.0},
        "ratios_to_best_95": {"gyro": [1.7, 2.5]},
        "not_shown_worse": [],
        "logs_with_less": 2,
        "logs_scored": 3,
    }


def scores() -> dict[str, Any]:
    found: dict[str, Any] = {"logs": 3, "nees_pose_mean": 2.9, "nees_pose_poses": 100}
    found |= {"nees_position_mean": None, "nees_position_poses": 0}
    for label in HORIZONS:
        found |= {f"drift_percent_{label}_mean": 1.5, f"drift_percent_{label}_95": [1.2, 1.9]}
        found |= {f"drift_ratio_{label}": 1.0, f"drift_ratio_{label}_95": None}
        found[f"drift_segments_{label}"] = 200
    return found


def pooled(best: str, percent: float) -> dict[str, Any]:
    variants = {"gyro": scores(), "inertia-online": scores()}
    of_all = {"logs": 3, "duration_s": 600.0, "distance_m": 240.0}
    return of_all | {"verdict": verdict(best, percent), "variants": variants}


@pytest.fixture
def results() -> dict[str, Any]:
    ratio: dict[str, Any] = {"logs": 3}
    for label in HORIZONS:
        ratio |= {f"ratio_{label}": 0.5, f"ratio_{label}_95": [0.4, 0.6], f"segments_{label}": 200}
    log = {"label": "a", "log": {"duration_s": 200.0, "notes": []}, "truth": {"distance_m": 80.0}}
    variants = {"gyro": scores(), "inertia-online": scores()}
    log |= {"failed": {}, "gyro_bias": None, "variants": variants}
    ratios = {"to": "maker", "variants": {"gyro": dict(ratio), "inertia-online": ratio}}
    empty: dict[str, Any] = {key: {} for key in ("configuration", "versions", "inputs", "robots")}
    return empty | {
        "command": "replay",
        "format": 1,
        "horizons": list(HORIZONS),
        "baseline_variant": "gyro",
        "notes": [],
        "logs": [log | {"robot": name, "folder": f"a/{name}"} for name in ("maker", "mine")],
        "failed": [],
        "pooled": {"maker": pooled("gyro", 3.0), "mine": pooled("inertia-online", 1.5)},
        "ratios": {"mine": ratios},
    }


def test_the_variant_that_learns_is_compared_too_where_another_is_best(results):
    """A fixed variant with another robot's file is no rival to be proud of."""
    of = results["ratios"]["mine"]["variants"]
    of["inertia-fixed"] = dict(of["gyro"]) | {"ratio_30s": 0.34, "ratio_30s_95": [0.2, 0.5]}
    of["inertia-online"] = dict(of["gyro"]) | {"ratio_30s": 0.96, "ratio_30s_95": [0.66, 1.36]}
    results["pooled"]["mine"] = pooled("inertia-fixed", 0.8)
    assert many_headline(results).endswith(
        " inertia-online, which learns as it drives, drifts 4 % less (95 %: 34 % less to 36 % more)."
    )


def test_robot_files_are_compared_by_the_variant_that_drifts_least(results: dict[str, Any]) -> None:
    assert many_headline(results) == (
        "With mine, inertia-online drifts 50 % less than with maker (95 %: 40 to 60 % less), after 30 s "
        "of dead reckoning."
    )
    of_each = many_remarks(results)[:2]
    assert of_each[0].startswith("maker: gyro drifts least: 3.00 %")
    assert of_each[1].startswith("mine: inertia-online drifts least: 1.50 %")
    results["ratios"]["mine"]["variants"] = {}  # no common segment
    assert "cannot be compared with maker" in many_headline(results)


@pytest.mark.parametrize(
    ("ratio", "interval", "end"),
    [
        (0.9, [0.7, 1.1], "That may be chance."),
        (0.9, None, "The logs are too short to say whether that is more than chance."),
        (1.001, [0.99, 1.01], "That may be chance."),
    ],
)
def test_a_lead_that_may_be_chance_is_called_so(results, ratio, interval, end):
    one = results["ratios"]["mine"]["variants"]["inertia-online"]
    one["ratio_30s"], one["ratio_30s_95"] = ratio, interval
    assert many_headline(results).endswith(end)
    assert ("as far as with maker" in many_headline(results)) == (ratio > 1.0)


def test_one_robot_file_has_the_verdict_over_all_logs(results: dict[str, Any]) -> None:
    del results["pooled"]["maker"]
    results["ratios"] = {}
    assert many_headline(results).startswith("inertia-online drifts least: 1.50 % of the distance")
    assert many_headline(results).endswith("(95 %: 40 to 60 % less), and less in 2 of 3 logs.")
    results["pooled"]["mine"]["verdict"]["ratio_95"] = [0.8, 1.2]
    assert "on these 3 logs" in many_headline(results)
    results["pooled"]["mine"] |= {"verdict": None, "logs": 0}
    assert many_headline(results) == UNSCORED


def test_the_picture_places_the_drifts_of_each_log_along_one_axis(results: dict[str, Any]) -> None:
    results["logs"] += [one | {"label": "b"} for one in results["logs"]]
    of_b = results["logs"][2]["variants"] = {"gyro": scores(), "differential": scores()}
    of_b["gyro"] |= {"drift_percent_30s_mean": 5.0, "drift_percent_30s_95": None}
    of_b["differential"] |= {"drift_percent_30s_mean": 40.0, "drift_percent_30s_95": [10.0, 99.0]}
    found = drift_picture(results)
    assert "|".join(text for _, text in found.ticks) == "1 %|2 %|5 %|10 %|20 %|50 %|100 %"
    labels = [f"{log}, {robot}" for log in ("all logs", "a", "b") for robot in ("maker", "mine")]
    assert [row.label for row in found.rows] == labels
    assert [row.is_pooled for row in found.rows] == [True, True, False, False, False, False]
    assert [one.name for one in found.variants] == ["gyro", "inertia-online", "differential"]
    gyro, differential = found.rows[4].marks
    assert (gyro.at, gyro.interval) == (34.95, None)
    assert gyro.text == "gyro: 5.00 %"
    assert differential.interval == pytest.approx((50.0, 99.78))
    assert differential.text == "differential: 40.0 % (95 % interval 10.0 to 99.0)"
    heights = [mark.y for row in found.rows for mark in row.marks]
    assert heights == sorted(set(heights))
    assert heights[-1] < found.height
    assert many_page(results).count('<g class="mark"') == len(heights)


def test_one_log_has_no_row_of_all_logs_and_without_a_truth_no_picture(results) -> None:
    assert [row.label for row in drift_picture(results).rows] == ["a, maker", "a, mine"]
    for one in (*results["logs"], *results["pooled"].values()):
        one["variants"] = {"gyro": {}}
    assert drift_picture(results) is None
