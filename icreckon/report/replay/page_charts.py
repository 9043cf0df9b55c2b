"""Data of the charts on a comparison's page, made from its results only.

`columns` holds lists of numbers, of equal length for those of one time; `breaks` lists, for each column
of times, the rows before which a hole of the log ends. Each chart is a plain object for `charts.js`:
`place` (its HTML element), `title`, `y_label`, `lines`, `points` and `bands` with names of columns,
horizontal `levels` and shaded `spans` of time [s]. `x` is a column of times [s], `y` one of values, to be
multiplied by `scale`. A band reaches from `middle` (zero if null) less to plus `times` `sigma`. `series`
names the switch that shows and hides an object; without one it has a `label` and colours of its own. For
the y axis, `least` is the least margin, `trim` the share of values at both ends that may be cut, `limit`
and `floor` its bounds.
"""

import math
from typing import Any

import numpy as np

from icreckon.estimator.motion.icr import IndexValues
from icreckon.estimator.streaming.outputs import icr_points
from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.base.colours import FIX_COLOUR, TRUTH_COLOUR, colour_of, on_dark
from icreckon.replay.base.units import unit
from icreckon.replay.comparison.plot_series import LONGEST_BRIDGE
from icreckon.replay.comparison.results import Results
from icreckon.report.replay.page_drive import drive_data, floats, known, listed
from icreckon.report.replay.page_text import has_yaw_errors

TRUTH, FIXES = "ground truth", "fixes used"
# Variants shown when the page opens, next to the best and the baseline.
FIRST_SHOWN = ("differential", "constant-online", "inertia-online")
# Number of variants up to which all are shown.
FEW = 4
# Its ICRs lie on its tracks by definition, and would widen the axes.
BY_DEFINITION = "differential"
# Innovations beyond are not drawn.
LARGEST_INNOVATION = 10.0
DEGREES = 180.0 / math.pi
LEFT_COLOUR, RIGHT_COLOUR, GYRO_COLOUR = "#0072B2", "#D55E00", "#444444"
# Share of its standard deviation by which a parameter moves that has a chart.
FLAT = 0.1
# A hole is longer than this number of usual intervals.
USUAL_INTERVALS = 4.0
Chart = dict[str, Any]
Numbers = list[float | None]


# Titles of the charts of learnt parameters; docs/explanation/model.md defines them.
PARAMETER_TITLES = {
    "H": "Track-speed ratio of turning on the spot, H",
    "zeta0": "Sliding index without force, ζ₀",
    "zeta1": "Sliding index, gain with the lateral force, ζ₁",
    "epsilon0": "Eccentricity index without force, ε₀",
    "epsilon1": "Eccentricity index, gain with the lateral force, ε₁",
    "epsilon_F": "Eccentricity index, gain with the force along the tracks, ε_F",
    "eta0": "Steering efficiency index without force, η₀",
    "eta1": "Steering efficiency index, gain with the lateral force, η₁",
    "eta2": "Steering efficiency index, quadratic gain, η₂",
    "right_l": "Velocity to the right per left track speed",
    "right_r": "Velocity to the right per right track speed",
    "forward_l": "Forward velocity per left track speed",
    "forward_r": "Forward velocity per right track speed",
    "turn_l": "Yaw rate per left track speed",
    "turn_r": "Yaw rate per right track speed",
    "gyro_bias": "Bias of the gyro",
    "gyro_scale": "Scale of the gyro, less 1",
    "accelerometer_bias_x": "Bias of the accelerometer, forward",
    "accelerometer_bias_y": "Bias of the accelerometer, to the left",
    "track_scale": "Scale of the track speeds, less 1",
    "track_difference": "Difference of the sprocket radii, right less left",
    "gravity_x": "Gravity along the ground, forward",
    "gravity_y": "Gravity along the ground, to the left",
}
INNOVATION_TITLES = {
    "gyro": "Gyro",
    "accelerometer_x": "Accelerometer, forward",
    "accelerometer_y": "Accelerometer, to the left",
    "position_x": "Position fixes, x",
    "position_y": "Position fixes, y",
    "heading": "Heading fixes",
}


def page_data(results: Results) -> Results:
    """Input of the page's scripts: series with styles, columns, charts, the drive."""
    columns = _columns(results)
    charts = [*_errors(results, columns), *_motion(results, columns), *_inputs(results, columns)]
    charts += [*_icrs(results, columns), *_parameters(results, columns)]
    charts += _innovations(results, columns)
    drive = drive_data(results, columns)
    return {
        "series": switches(results),
        "columns": columns,
        "breaks": {name: breaks_of(columns[name]) for name in _times_in(charts)},
        "charts": charts,
        "drive": drive,
    }


def switches(results: Results) -> list[Results]:
    """Series that can be hidden: name, colours, dash, and whether shown at first."""
    names, verdict = list(results["variants"]), results["verdict"] or {}
    first = {*FIRST_SHOWN, verdict.get("best"), verdict.get("baseline")}
    few = len(names) <= FEW
    shown = {name: few or name in first for name in names}
    if not any(shown.values()):
        shown = dict.fromkeys(names, True)
    found = [
        _switch(name, colour_of(name), "2 3" if name.endswith(SMOOTHED) else "", shown=shown[name])
        for name in names
    ]
    if "truth" in results["series"]:
        found.append(_switch(TRUTH, TRUTH_COLOUR, ""))
    if results["series"].get("fixes", {}).get("x_m"):
        found.append(_switch(FIXES, FIX_COLOUR, "2 2"))
    return found


def _switch(name: str, colour: str, dash: str, *, shown: bool = True) -> Results:
    return {"name": name, "colour": colour, "dark": on_dark(colour), "dash": dash, "shown": shown}


def _columns(results: Results) -> dict[str, Numbers]:
    """Columns that charts share; those of a variant begin with its name."""
    series = results["series"]
    columns = {"t": series["t_s"], "distance": series["distance_m"]}
    for name, one in series["variants"].items():
        for key, values in one.items():
            if isinstance(values, list) and key not in ("ellipses", "zeta_m", "epsilon_m", "eta"):
                columns[f"{name}/{key}"] = values
    for part, title in (("truth", TRUTH), ("fixes", FIXES), ("inputs", "inputs")):
        for key, values in series.get(part, {}).items():
            if key not in ("zeta_m", "epsilon_m", "icr_distance_m"):
                columns[f"{title}/{key}"] = values
    return columns


def _times_in(charts: list[Chart]) -> list[str]:
    """Names of all columns of times."""
    parts = ("lines", "bands")
    found = [item["x"] for chart in charts for part in parts for item in chart.get(part, [])]
    return list(dict.fromkeys(["t", *found]))


def breaks_of(times: Numbers) -> list[int]:
    """Rows that a hole of the log separates from the row before."""
    steps = np.diff(floats(times))
    if not len(steps):
        return []
    longest = max(LONGEST_BRIDGE, USUAL_INTERVALS * float(np.median(steps)))
    return (np.flatnonzero(steps > longest) + 1).tolist()


def _errors(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """Errors against the truth, or else differences from the reference variant."""
    truth, names = results["truth"], results["series"]["variants"]
    headings = has_yaw_errors(results)
    if truth:
        titles = ["Position error", "Yaw error" if headings else "Yaw"]
        keys = ["position_error_m", "yaw_error_rad" if headings else "yaw_rad"]
    else:
        reference = results["reference_variant"]
        titles = [f"Distance from {reference}", f"Yaw less that of {reference}"]
        keys = ["apart_m", "yaw_apart_rad"]
        for name in names:
            columns[f"{name}/apart_m"], columns[f"{name}/yaw_apart_rad"] = _apart(results, name)
    spans = _scored_spans(results)
    scored = " Yellow: without fixes, where drift is scored." if spans else ""
    common = {
        "place": "errors",
        "spans": spans,
        "note": f"Bands: the filter's own 3σ; bar at the edge: 3σ is off scale.{scored}",
    }
    position: Chart = {
        "title": titles[0],
        "y_label": "position [m]",
        "floor": 0.0,
        "least": 1e-3,
        "lines": [_line(name, keys[0]) for name in names],
        "bands": [
            _band(name, f"{name}/position_sigma_m", 3.0)
            for name in names
            if known(columns[f"{name}/position_sigma_m"])
        ],
    }
    yaw: Chart = {
        "title": titles[1],
        "y_label": "yaw [deg]",
        "least": 0.01,
        "lines": [_line(name, keys[1], scale=DEGREES) for name in names],
        "bands": [
            _band(name, f"{name}/yaw_sigma_rad", 3.0, scale=DEGREES)
            | {"middle": f"{name}/yaw_rad" if keys[1] == "yaw_rad" else None}
            for name in names
            if known(columns[f"{name}/yaw_sigma_rad"])
        ],
    }
    return [common | position, common | yaw]


def _apart(results: Results, name: str) -> tuple[Numbers, Numbers]:
    """Distance and yaw from the reference variant, row by row."""
    series = results["series"]["variants"]
    one, other = series[name], series[results["reference_variant"]]
    x, y, yaw = (floats(one[key]) - floats(other[key]) for key in ("x_m", "y_m", "yaw_rad"))
    return listed(np.hypot(x, y)), listed(yaw)


def _scored_spans(results: Results) -> list[list[float]]:
    """Intervals of time in which drift is scored, if there are fixes elsewhere."""
    truth = results["truth"]
    return list(truth["scored_s"]) if truth and results["log"]["fixes"] else []


def _motion(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """Pose, speed and yaw rate over time, with the truth where it is known."""
    series = results["series"]
    yaw = _one_turn(results, columns)
    charts = []
    for title, key, label, scale in (
        ("x in odom", "x_m", "x [m]", 1.0),
        ("y in odom", "y_m", "y [m]", 1.0),
        ("Yaw, counter-clockwise", "yaw_rad", "yaw [deg]", DEGREES),
        ("Forward speed", "v_x_m_s", "v_x [m/s]", 1.0),
        ("Sideways speed, to the left", "v_y_m_s", "v_y [m/s]", 1.0),
        ("Yaw rate", "w_rad_s", "w [rad/s]", 1.0),
        ("Height above the start", "z_m", "z [m]", 1.0),
        ("Roll", "roll_rad", "roll [deg]", DEGREES),
        ("Pitch, nose down", "pitch_rad", "pitch [deg]", DEGREES),
    ):
        lines = [
            _line(name, key, scale=scale) for name, one in series["variants"].items() if key in one
        ]
        sigma = key.replace("_", "_sigma_")
        bands = [
            _band(name, f"{name}/{sigma}", 2.0, scale=scale) | {"middle": f"{name}/{key}"}
            for name, one in series["variants"].items()
            if sigma in one and key != "yaw_rad"
        ]
        if key in series.get("truth", {}):
            lines.insert(0, _line(TRUTH, key, scale=scale) | {"width": 3})
        if key == "yaw_rad":
            lines = [line | {"y": yaw.get(line["series"], line["y"])} for line in lines]
        chart: Chart = {"place": "motion", "title": title, "y_label": label, "least": 1e-3}
        if bands:
            chart |= {"bands": bands, "note": "Bands: ±2σ of the filter."}
        charts.append(chart | {"lines": lines})
    return [chart for chart in charts if chart["lines"]]


def _one_turn(results: Results, columns: dict[str, Numbers]) -> dict[str, str]:
    """Columns of yaws, by variant, moved by full turns to that of the truth.

    In a hole of the log, a filter may turn more or less often than the robot did.
    """
    series, reference = results["series"], results["reference_variant"]
    target = floats(
        series["truth"]["yaw_rad"]
        if "truth" in series
        else series["variants"][reference]["yaw_rad"]
    )
    found = {}
    for name, one in series["variants"].items():
        own = floats(one["yaw_rad"])
        turns = np.round((target - own) / (2.0 * math.pi))
        # Where the target is not known, the newest number of turns holds.
        rows = np.maximum.accumulate(np.where(np.isfinite(turns), np.arange(len(turns)), 0))
        turns = np.nan_to_num(turns[rows]) if len(turns) else turns
        if turns.any():
            found[name] = f"{name}/yaw_of_truth_rad"
            columns[found[name]] = listed(own + 2.0 * math.pi * turns)
    return found


def _inputs(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """Measured track speeds, and the yaw rate by them and that of the gyro."""
    inputs, place = results["series"]["inputs"], "inputs"
    tracks: Chart = {
        "place": place,
        "title": "Track speeds, as measured",
        "y_label": "speed [m/s]",
        "least": 1e-3,
        "lines": [
            _labelled("left track", "inputs/left_m_s", LEFT_COLOUR),
            _labelled("right track", "inputs/right_m_s", RIGHT_COLOUR),
        ],
    }
    commanded = turning_by_tracks(results)
    columns["inputs/tracks_rad_s"] = listed(commanded)
    label = "by the tracks, (right − left) / gauge"
    lines = [_labelled(label, "inputs/tracks_rad_s", RIGHT_COLOUR)]
    if "gyro_rad_s" in inputs:
        lines.append(_labelled("by the gyro", "inputs/gyro_rad_s", GYRO_COLOUR))
    turning: Chart = {
        "place": place,
        "title": "Yaw rate: tracks against gyro",
        "y_label": "yaw rate [rad/s]",
        "least": 1e-3,
        "lines": lines,
    }
    return [tracks, turning]


def turning_by_tracks(results: Results) -> Any:
    """Yaw rate (n,) of an ideal differential drive by the track speeds [rad/s]."""
    inputs, gauge = results["series"]["inputs"], results["robot"]["vehicle"]["track_gauge"]
    return (floats(inputs["right_m_s"]) - floats(inputs["left_m_s"])) / gauge


def _icrs(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """Coordinates of the tracks' ICRs in base_link over time."""
    gauge, series = results["robot"]["vehicle"]["track_gauge"], results["series"]
    indices = {
        name: [floats(one[key]) for key in ("zeta_m", "epsilon_m", "eta")]
        for name, one in series["variants"].items()
    }
    truth = series.get("truth", {})
    if "icr_distance_m" in truth:
        indices[TRUTH] = [floats(truth[key]) for key in ("zeta_m", "epsilon_m")]
        indices[TRUTH].append(floats(truth["icr_distance_m"]) / gauge)
    for name, one in indices.items():
        left, right = icr_points(IndexValues(*one), gauge)
        columns[f"{name}/icr_x_m"] = listed(left[0])
        columns[f"{name}/left_icr_y_m"] = listed(left[1])
        columns[f"{name}/right_icr_y_m"] = listed(right[1])
    charts = []
    for title, key, label in (
        ("ICR of the left track, to the left", "left_icr_y_m", "y of the left ICR [m]"),
        ("ICR of the right track, to the left", "right_icr_y_m", "y of the right ICR [m]"),
        ("Both ICRs, forward", "icr_x_m", "x of the ICRs [m]"),
    ):
        drawn = [name for name in indices if name.removesuffix(SMOOTHED) != BY_DEFINITION]
        lines = [_line(name, key) for name in drawn if name != TRUTH]
        points = [_line(name, key) for name in drawn if name == TRUTH]
        if not lines:
            continue
        chart = {"place": "icrs", "title": title, "y_label": label, "trim": 0.02, "least": 2e-3}
        charts.append(chart | {"lines": lines, "points": points})
    return charts


def _parameters(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """One chart for each parameter that a variant moves."""
    constant = constant_parameters(results)
    learnt: dict[str, list[str]] = {}
    for name, one in results["series"]["variants"].items():
        for parameter, values in one["parameters"].items():
            if parameter == "t_s":
                columns[f"{name}/parameters/t_s"] = values
                continue
            columns[f"{name}/{parameter}"] = values["value"]
            columns[f"{name}/{parameter}/sigma"] = values["sigma"]
            learnt.setdefault(parameter, []).append(name)
    charts = []
    for parameter, names in learnt.items():
        names = [name for name in names if name not in constant.get(parameter, {})]
        if not names:
            continue
        usual = max(_median(columns[f"{name}/{parameter}/sigma"]) for name in names)
        times = {name: {"x": f"{name}/parameters/t_s"} for name in names}
        charts.append(
            {
                "place": "parameters",
                "title": PARAMETER_TITLES.get(parameter, parameter),
                "y_label": f"{parameter} [{unit(parameter)}]",
                "lines": [_line(name, parameter) | times[name] for name in names],
                "bands": [
                    _band(name, f"{name}/{parameter}/sigma", 2.0)
                    | times[name]
                    | {"middle": f"{name}/{parameter}"}
                    for name in names
                ],
                "least": max(0.2 * usual, 1e-12),
            }
        )
    return charts


def constant_parameters(results: Results) -> dict[str, dict[str, tuple[float, float]]]:
    """Learnt parameters that a variant does not move: last value and sigma.

    They move by less than `FLAT` of their standard deviation at the start: their curves are level. Keys
    are the names of parameters and variants.
    """
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for name, one in results["series"]["variants"].items():
        for parameter, columns in one["parameters"].items():
            if parameter == "t_s":
                continue
            value, sigma = (floats(columns[key]) for key in ("value", "sigma"))
            moves = np.ptp(value) >= FLAT * sigma[0] or sigma[-1] < (1.0 - FLAT) * sigma[0]
            if np.isfinite(value).all() and not moves:
                found.setdefault(parameter, {})[name] = (float(value[-1]), float(sigma[-1]))
    return found


def _median(values: Numbers) -> float:
    found = floats(values)
    return float(np.nanmedian(found)) if np.isfinite(found).any() else 0.0


def _innovations(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """One chart for each component of a sensor."""
    points: dict[str, list[Results]] = {}
    for name, one in results["series"]["variants"].items():
        for component, values in one["innovations"].items():
            key = f"{name}/innovation_{component}"
            columns[f"{key}/t_s"], columns[key] = values["t_s"], values["normalised"]
            dots = {"series": name, "x": f"{key}/t_s", "y": key, "size": 1.1}
            points.setdefault(component, []).append(dots)
    levels = [{"y": y, "dash": "4 3"} for y in (-2.0, 2.0)]
    levels += [{"y": y} for y in (-3.0, 3.0)]
    return [
        {
            "place": "innovations",
            "title": INNOVATION_TITLES.get(component, component.replace("_", " ")),
            "y_label": "innovation / σ [-]",
            "points": found,
            "levels": levels,
            "limit": LARGEST_INNOVATION,
            "least": 0.1,
        }
        for component, found in points.items()
    ]


def _line(name: str, key: str, *, scale: float = 1.0) -> Results:
    return {"series": name, "x": "t", "y": f"{name}/{key}", "scale": scale}


def _band(name: str, sigma: str, times: float, *, scale: float = 1.0) -> Results:
    own: Results = {"series": name, "x": "t", "middle": None, "sigma": sigma}
    return own | {"times": times, "scale": scale}


def _labelled(label: str, column: str, colour: str) -> Results:
    style = {"label": label, "colour": colour, "dark": on_dark(colour)}
    return style | {"x": "t", "y": column, "scale": 1.0}
