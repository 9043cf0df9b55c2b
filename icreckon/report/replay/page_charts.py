"""Data of the charts on a comparison's page, made from its results only.

Each chart is a plain object that `replay.js` draws: `place` (its HTML element), `title`, labels of the
axes, `lines`, `points`, `bands` with `x` and `y` (numbers, or the name of one of the page's `columns`),
horizontal `levels`, grey `spans` of x. `series` names the switch that shows and hides an object. For the
y axis, `least` is the least margin, `trim` the share of values at both ends that may be cut, `limit` and
`floor` its bounds, `band_size` the least part of bands in view.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.base.colours import OTHER_COLOUR, TRUTH_COLOUR, colour_of
from icreckon.replay.base.units import unit
from icreckon.replay.comparison.results import Results
from icreckon.replay.export.tables import icr_series
from icreckon.report.replay.page_text import has_yaw_errors

TRUTH, FIXES = "ground truth", "fixes used"
# Variants shown when the page opens, beside the best and the baseline.
FIRST_SHOWN = ("differential", "constant-online", "inertia-online", "friction-online")
# Number of variants up to which all are shown.
FEW = 4
# Its ICRs lie on its tracks by definition, and would widen the axes.
BY_DEFINITION = "differential"
# Innovations beyond are not drawn.
LARGEST_INNOVATION = 10.0
INNOVATION_TITLES = {
    "gyro": "gyro",
    "accelerometer_x": "accelerometer, forward",
    "accelerometer_y": "accelerometer, to the left",
    "position_x": "position fixes, x",
    "position_y": "position fixes, y",
    "heading": "heading fixes",
}
Chart = dict[str, Any]
Numbers = list[float | None]


def page_data(results: Results) -> Results:
    """Input of `replay.js`: series with their styles, shared columns, charts."""
    series = results["series"]
    charts = [_paths(results), *_errors(results), *_icrs(results)]
    charts += [*_parameters(results), *_innovations(results)]
    return {
        "series": switches(results),
        "columns": {"t": series["t_s"], "distance": series["distance_m"]},
        "charts": charts,
    }


def switches(results: Results) -> list[Results]:
    """Series that can be hidden: name, colour, dash, and whether shown at first."""
    names, verdict = list(results["variants"]), results["verdict"] or {}
    first = {*FIRST_SHOWN, verdict.get("best"), verdict.get("baseline")}
    few = len(names) <= FEW
    shown = {name: few or name in first for name in names}
    if not any(shown.values()):
        shown = dict.fromkeys(names, True)
    found = [
        {
            "name": name,
            "colour": colour_of(name),
            "dash": "2 3" if name.endswith(SMOOTHED) else "",
            "shown": shown[name],
        }
        for name in names
    ]
    if "truth" in results["series"]:
        found.append({"name": TRUTH, "colour": TRUTH_COLOUR, "dash": "", "shown": True})
    if results["series"].get("fixes", {}).get("x_m"):
        found.append({"name": FIXES, "colour": OTHER_COLOUR, "dash": "2 2", "shown": True})
    return found


def _paths(results: Results) -> Chart:
    series = results["series"]
    lines, points = [], []
    if "truth" in series:
        truth = series["truth"]
        lines.append({"series": TRUTH, "x": truth["x_m"], "y": truth["y_m"], "width": 4})
        lines[-1]["colour"] = "#00000073"
    if series.get("fixes", {}).get("x_m"):
        fixes = series["fixes"]
        points.append({"series": FIXES, "x": fixes["x_m"], "y": fixes["y_m"]})
        points[-1] |= {"shape": "cross", "size": 3}
    for name, one in series["variants"].items():
        lines.append({"series": name, "x": one["x_m"], "y": one["y_m"], "width": 1.6})
        end = {"series": name, "x": one["x_m"][-1:], "y": one["y_m"][-1:]}
        points.append(end | {"shape": "square", "size": 4})
    return {
        "place": "paths",
        "title": "Paths in odom",
        "map": True,
        "x_label": "x [m]",
        "y_label": "y [m]",
        "least": 0.05,
        "lines": lines,
        "points": points,
        "note": "Squares: where they end. Drag to move, wheel or pinch to zoom, double-click for all.",
    }


def _errors(results: Results) -> list[Chart]:
    """Errors over the distance, against the truth or else the reference variant."""
    if results["truth"]:
        position, title = "position_error_m", "Position error"
        headings = has_yaw_errors(results)
        yaw, yaw_title = ("yaw_error_rad", "Yaw error") if headings else ("yaw_rad", "Yaw")
    else:
        position = yaw = ""
        title = f"Distance from {results['reference_variant']}"
        yaw_title = f"Yaw less that of {results['reference_variant']}"
    spans = _scored_spans(results)
    grey = " Grey: without fixes, where drift is scored." if spans else ""
    charts = []
    common = {"place": "errors", "x_label": "distance driven [m]", "spans": spans}
    note = f"Bands: the filter's own 3σ.{grey}"
    lines, bands = [], []
    for name, one in results["series"]["variants"].items():
        values = one[position] if position else _apart(results, name)
        lines.append({"series": name, "x": "distance", "y": values})
        high = _times(one["position_sigma_m"], 3.0)
        low = [None if value is None else 0.0 for value in high]
        bands.append({"series": name, "x": "distance", "low": low, "high": high})
    chart = {"title": title, "y_label": "position [m]", "floor": 0.0, "least": 1e-3}
    charts.append(common | chart | {"lines": lines, "bands": bands, "note": note})
    lines, bands = [], []
    for name, one in results["series"]["variants"].items():
        values = _times(one[yaw], 180.0 / math.pi) if yaw else _yaw_apart(results, name)
        lines.append({"series": name, "x": "distance", "y": values})
        bound = 3.0 * np.degrees(_floats(one["yaw_sigma_rad"]))
        middle = _floats(values) if yaw == "yaw_rad" else 0.0
        low, high = _listed(middle - bound), _listed(middle + bound)
        bands.append({"series": name, "x": "distance", "low": low, "high": high})
    chart = {"title": yaw_title, "y_label": "yaw [deg]", "least": 0.01}
    charts.append(common | chart | {"lines": lines, "bands": bands, "note": note})
    return charts


def _apart(results: Results, name: str) -> Numbers:
    series = results["series"]["variants"]
    one, other = series[name], series[results["reference_variant"]]
    x, y = (_floats(one[key]) - _floats(other[key]) for key in ("x_m", "y_m"))
    return _listed(np.hypot(x, y))


def _yaw_apart(results: Results, name: str) -> Numbers:
    series = results["series"]["variants"]
    one, other = series[name], series[results["reference_variant"]]
    return _listed(np.degrees(_floats(one["yaw_rad"]) - _floats(other["yaw_rad"])))


def _scored_spans(results: Results) -> list[list[float]]:
    """Intervals of distance in which drift is scored, if there are fixes elsewhere."""
    truth, series = results["truth"], results["series"]
    if not truth or not results["log"]["fixes"]:
        return []
    known, travelled = _floats(series["t_s"]), _floats(series["distance_m"])
    return [np.interp(span, known, travelled).tolist() for span in truth["scored_s"]]


def _icrs(results: Results) -> list[Chart]:
    """Coordinates of the ICRs in base_link over time."""
    gauge, series = results["robot"]["vehicle"]["track_gauge"], results["series"]
    places: dict[str, Any] = {}
    for name, one in series["variants"].items():
        if name.removesuffix(SMOOTHED) == BY_DEFINITION:
            continue
        indices = np.column_stack([_floats(one[key]) for key in ("zeta_m", "epsilon_m", "eta")])
        places[name] = icr_series(indices, gauge)
    truth = series.get("truth", {})
    if "icr_distance_m" in truth:
        distance = _floats(truth["icr_distance_m"]) / gauge
        columns = [_floats(truth["zeta_m"]), _floats(truth["epsilon_m"]), distance]
        places[TRUTH] = icr_series(np.column_stack(columns), gauge)
    charts = []
    for title, field, label in (
        ("Left track's ICR, to the left", "left_y", "y of the left ICR [m]"),
        ("Right track's ICR, to the left", "right_y", "y of the right ICR [m]"),
        ("Both ICRs, forward", "left_x", "x of the ICRs [m]"),
    ):
        lines: list[Results] = []
        points: list[Results] = []
        for name, one in places.items():
            item = {"series": name, "x": "t", "y": _listed(getattr(one, field))}
            (points if name == TRUTH else lines).append(item)
        chart = {"place": "icrs", "title": title, "x_label": "time [s]", "y_label": label}
        if not lines:
            continue
        charts.append(chart | {"lines": lines, "points": points, "trim": 0.01, "least": 2e-3})
    return charts


def _parameters(results: Results) -> list[Chart]:
    """One chart for each parameter that a variant estimates."""
    learnt: dict[str, list[tuple[str, Any, Any]]] = {}
    for name, one in results["series"]["variants"].items():
        found = one["parameters"]
        for parameter, values in found.items():
            if parameter != "t_s":
                learnt.setdefault(parameter, []).append((name, found["t_s"], values))
    charts = []
    for parameter, rows in learnt.items():
        lines, bands = [], []
        for name, times, one in rows:
            value, bound = _floats(one["value"]), 2.0 * _floats(one["sigma"])
            lines.append({"series": name, "x": times, "y": one["value"]})
            low, high = _listed(value - bound), _listed(value + bound)
            bands.append({"series": name, "x": times, "low": low, "high": high})
        usual = max(float(np.nanmedian(2.0 * _floats(one["sigma"]))) for _, _, one in rows)
        charts.append(
            {
                "place": "parameters",
                "title": parameter,
                "x_label": "time [s]",
                "y_label": f"[{unit(parameter)}]",
                "x_range": [0.0, results["log"]["duration_s"]],
                "lines": lines,
                "bands": bands,
                "least": max(0.1 * usual, 1e-12),
                "band_size": 1.2 * usual,
            }
        )
    return charts


def _innovations(results: Results) -> list[Chart]:
    """One chart for each component of a sensor."""
    rows: dict[str, list[tuple[str, Any]]] = {}
    for name, one in results["series"]["variants"].items():
        for component, values in one["innovations"].items():
            rows.setdefault(component, []).append((name, values))
    levels = [{"y": y, "dash": "4 3"} for y in (-2.0, 2.0)]
    levels += [{"y": y} for y in (-3.0, 3.0)]
    return [
        {
            "place": "innovations",
            "title": INNOVATION_TITLES.get(component, component.replace("_", " ")),
            "x_label": "time [s]",
            "y_label": "innovation / σ [-]",
            "points": [
                {"series": name, "x": one["t_s"], "y": one["normalised"], "size": 1.1}
                for name, one in found
            ],
            "x_range": [0.0, results["log"]["duration_s"]],
            "levels": levels,
            "limit": LARGEST_INNOVATION,
            "least": 0.1,
        }
        for component, found in rows.items()
    ]


def _times(values: Numbers, factor: float) -> Numbers:
    return [None if value is None else float(f"{value * factor:.5g}") for value in values]


def _floats(values: Numbers) -> Any:
    return np.array([math.nan if value is None else value for value in values], dtype=float)


def _listed(values: Any) -> Numbers:
    return [float(f"{one:.5g}") if math.isfinite(one) else None for one in values.tolist()]
