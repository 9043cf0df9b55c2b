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
from icreckon.replay.comparison.holes import LONGEST_BRIDGE
from icreckon.replay.comparison.plot_series import rounded
from icreckon.replay.comparison.results import Results
from icreckon.report.replay.page_drive import Numbers, drive_data, floats, known
from icreckon.report.replay.page_text import found_faults, has_yaw_errors

TRUTH, FIXES = "ground truth", "fixes used"
# Variants shown when the page opens, next to the best and the baseline.
FIRST_SHOWN = ("differential", "constant-online", "inertia-online")
MOST_SHOWN = 4  # number of variants up to which all are shown at first
ON_TRACKS = "differential"  # its ICRs lie on its tracks by definition, and would widen the axes
LARGEST_INNOVATION = 10.0  # innovations beyond are not drawn
DEGREES = 180.0 / math.pi
LEFT_COLOUR, RIGHT_COLOUR, GYRO_COLOUR = "#0072B2", "#D55E00", "#444444"
STEADY = 0.1  # change of a parameter over its standard deviation, below which it has no chart
USUAL_INTERVALS = 4.0  # a hole is longer than this number of usual intervals
Chart = dict[str, Any]


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
    "gyro_bias_x": "Bias of the gyro about the forward axis",
    "gyro_bias_y": "Bias of the gyro about the axis to the left",
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
    makers = (_error_charts, _motion_charts, _input_charts, _icr_charts, _parameter_charts)
    charts = [chart for make in (*makers, _innovation_charts) for chart in make(results, columns)]
    drive = drive_data(results, columns)
    items = [item for chart in charts for key in ("lines", "bands") for item in chart.get(key, [])]
    time_columns = dict.fromkeys(["t", *(item["x"] for item in items)])
    return {
        "series": switches(results),
        "columns": columns,
        "holes": results["log"]["holes_s"],
        "breaks": {name: breaks_of(columns[name]) for name in time_columns},
        "charts": charts,
        "drive": drive,
    }


def switches(results: Results) -> list[Results]:
    """Series that can be hidden: name, colours, dash, and whether shown at first."""
    names, verdict = list(results["variants"]), results["verdict"] or {}
    first_shown = {*FIRST_SHOWN, verdict.get("best"), verdict.get("baseline")}
    are_few = len(names) <= MOST_SHOWN or first_shown.isdisjoint(names)
    styles = []  # name, colour, dash, and whether shown at first
    for name in names:
        dash = "2 3" if name.endswith(SMOOTHED) else ""
        styles.append((name, colour_of(name), dash, are_few or name in first_shown))
    if "truth" in results["series"]:
        styles.append((TRUTH, TRUTH_COLOUR, "", True))
    if results["series"].get("fixes", {}).get("x_m"):
        styles.append((FIXES, FIX_COLOUR, "2 2", True))
    return [
        {"name": name, "colour": colour, "dark": on_dark(colour), "dash": dash, "shown": is_shown}
        for name, colour, dash, is_shown in styles
    ]


def _columns(results: Results) -> dict[str, Numbers]:
    """Columns that charts share; those of a variant begin with its name."""
    series = results["series"]
    columns = {"t": series["t_s"], "distance": series["distance_m"]}
    for name, variant in series["variants"].items():
        for key, values in variant.items():
            # Indices are drawn as ICRs, ellipses and all that is no list elsewhere.
            if isinstance(values, list) and key not in ("ellipses", "zeta_m", "epsilon_m", "eta"):
                columns[f"{name}/{key}"] = values
    for part, prefix in (("truth", TRUTH), ("fixes", FIXES), ("inputs", "inputs")):
        for key, values in series.get(part, {}).items():
            if key not in ("zeta_m", "epsilon_m", "icr_distance_m"):
                columns[f"{prefix}/{key}"] = values
    return columns


def breaks_of(times: Numbers) -> list[int]:
    """Rows that a hole of the log separates from the row before."""
    steps = np.diff(floats(times))
    if not len(steps):
        return []
    longest = max(LONGEST_BRIDGE, USUAL_INTERVALS * float(np.median(steps)))
    return (np.flatnonzero(steps > longest) + 1).tolist()


def _error_charts(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """Charts of errors in position and yaw; without a truth, of differences."""
    variants = results["series"]["variants"]
    has_yaw = has_yaw_errors(results)
    position_title, position_key = "Position error", "position_error_m"
    yaw_title, yaw_key = ("Yaw error", "yaw_error_rad") if has_yaw else ("Yaw", "yaw_rad")
    if not results["truth"]:
        reference = results["reference_variant"]
        position_title, position_key = f"Distance from {reference}", "apart_m"
        yaw_title, yaw_key = f"Yaw less that of {reference}", "yaw_apart_rad"
        origin = variants[reference]
        for name, own in variants.items():
            keys = ("x_m", "y_m", "yaw_rad")
            x, y, turned = (floats(own[key]) - floats(origin[key]) for key in keys)
            columns[f"{name}/apart_m"] = rounded(np.hypot(x, y))
            columns[f"{name}/yaw_apart_rad"] = rounded(turned)
    spans = outages(results)
    scored = " Yellow: without fixes, where drift is scored." if spans else ""
    scored += " Grey: holes of the log." if results["log"]["holes_s"] else ""
    note = f"Bands: the filter's own 3σ; bar at the edge: 3σ is off scale.{scored}"
    common = {"place": "errors", "spans": spans, "note": note}
    position: Chart = {"title": position_title, "y_label": "position [m]"}
    position |= {"floor": 0.0, "least": 1e-3}
    position["lines"] = [_line(name, position_key) for name in variants]
    with_sigma = [name for name in variants if known(columns[f"{name}/position_sigma_m"])]
    position["bands"] = [_band(name, "position_sigma_m", 3.0) for name in with_sigma]
    yaw: Chart = {"title": yaw_title, "y_label": "yaw [deg]", "least": 0.01}
    yaw["lines"] = [_line(name, yaw_key, scale=DEGREES) for name in variants]
    # About zero for an error, about the yaw itself otherwise.
    middle = yaw_key if yaw_key == "yaw_rad" else None
    with_sigma = [name for name in variants if known(columns[f"{name}/yaw_sigma_rad"])]
    yaw["bands"] = [_band(name, "yaw_sigma_rad", 3.0, middle, scale=DEGREES) for name in with_sigma]
    return [common | position, common | yaw]


def outages(results: Results) -> list[list[float]]:
    """Intervals [s] in which drift is scored, if there are fixes outside of them."""
    truth = results["truth"]
    return list(truth["scored_s"]) if truth and results["log"]["fixes"] else []


def _motion_charts(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """Charts of pose, speed and yaw rate, with the truth where it is known."""
    series, variants = results["series"], results["series"]["variants"]
    shifted_yaws = _shift_by_turns(results, columns)
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
        lines = [_line(name, key, scale=scale) for name in variants if key in variants[name]]
        if key == "yaw_rad":
            lines = [line | {"y": shifted_yaws.get(line["series"], line["y"])} for line in lines]
        if key in series.get("truth", {}):
            lines.insert(0, _line(TRUTH, key, scale=scale) | {"width": 3})
        if not lines:
            continue
        chart: Chart = {"place": "motion", "title": title, "y_label": label, "least": 1e-3}
        # Height, roll and pitch have a sigma, as "z_sigma_m". The yaw's is in the chart of its errors.
        sigma = key.replace("_", "_sigma_")
        bands = [
            _band(name, sigma, 2.0, key, scale=scale)
            for name in variants
            if sigma in variants[name] and key != "yaw_rad"
        ]
        if bands:
            chart |= {"bands": bands, "note": "Bands: ±2σ of the filter."}
        charts.append(chart | {"lines": lines})
    return charts


def _shift_by_turns(results: Results, columns: dict[str, Numbers]) -> dict[str, str]:
    """Shift yaws by full turns to that of the truth, or else of the reference variant.

    In a hole of the log, a filter may turn more or less often than the robot did. Adds a column for each
    variant whose yaw is shifted; returns the names of these columns by variant.
    """
    series, variants = results["series"], results["series"]["variants"]
    reference = series.get("truth") or variants[results["reference_variant"]]
    target = floats(reference["yaw_rad"])
    column_names = {}
    for name, variant in variants.items():
        own = floats(variant["yaw_rad"])
        turns = np.round((target - own) / (2.0 * math.pi))
        # Where the target is unknown (NaN), the last known number of turns holds, at first 0.
        last_known = np.maximum.accumulate(np.where(np.isfinite(turns), np.arange(len(turns)), 0))
        turns = np.nan_to_num(turns[last_known]) if len(turns) else turns
        if turns.any():
            column_names[name] = f"{name}/yaw_of_truth_rad"
            columns[column_names[name]] = rounded(own + 2.0 * math.pi * turns)
    return column_names


def _input_charts(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """Charts of track speeds and of yaw rates by them and by the gyro; adds a column."""
    name, faults = found_faults(results)
    spans = [span for of_fault in faults.values() for span in of_fault]
    note = f"Yellow: faults found by the variant {name}, see What was dropped." if spans else ""
    common: Chart = {"place": "inputs", "least": 1e-3, "spans": spans, "note": note}
    speeds = common | {"title": "Track speeds, as measured", "y_label": "speed [m/s]"}
    speeds["lines"] = [
        _labelled("left track", "inputs/left_m_s", LEFT_COLOUR),
        _labelled("right track", "inputs/right_m_s", RIGHT_COLOUR),
    ]
    inputs, gauge = results["series"]["inputs"], results["robot"]["vehicle"]["track_gauge"]
    difference = floats(inputs["right_m_s"]) - floats(inputs["left_m_s"])
    columns["inputs/tracks_rad_s"] = rounded(difference / gauge)
    label = "by the tracks, (right − left) / gauge"
    lines = [_labelled(label, "inputs/tracks_rad_s", RIGHT_COLOUR)]
    if "gyro_rad_s" in inputs:
        lines.append(_labelled("by the gyro", "inputs/gyro_rad_s", GYRO_COLOUR))
    turning = common | {"title": "Yaw rate: tracks against gyro", "y_label": "yaw rate [rad/s]"}
    return [speeds, turning | {"lines": lines}]


def _icr_charts(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """Charts of the coordinates of the tracks' ICRs in base_link; adds their columns."""
    gauge, series = results["robot"]["vehicle"]["track_gauge"], results["series"]
    indices = {
        name: [floats(variant[key]) for key in ("zeta_m", "epsilon_m", "eta")]
        for name, variant in series["variants"].items()
    }
    truth = series.get("truth", {})
    if "icr_distance_m" in truth:
        eta = floats(truth["icr_distance_m"]) / gauge
        indices[TRUTH] = [floats(truth["zeta_m"]), floats(truth["epsilon_m"]), eta]
    for name, values in indices.items():
        (x, left_y), (_, right_y) = icr_points(IndexValues(*values), gauge)
        columns[f"{name}/icr_x_m"] = rounded(x)
        columns[f"{name}/left_icr_y_m"] = rounded(left_y)
        columns[f"{name}/right_icr_y_m"] = rounded(right_y)
    drawn = [name for name in indices if name.removesuffix(SMOOTHED) != ON_TRACKS]
    charts = []
    for title, key, label in (
        ("ICR of the left track, to the left", "left_icr_y_m", "y of the left ICR [m]"),
        ("ICR of the right track, to the left", "right_icr_y_m", "y of the right ICR [m]"),
        ("Both ICRs, forward", "icr_x_m", "x of the ICRs [m]"),
    ):
        lines = [_line(name, key) for name in drawn if name != TRUTH]
        points = [_line(name, key) for name in drawn if name == TRUTH]
        if not lines:
            continue
        chart = {"place": "icrs", "title": title, "y_label": label, "trim": 0.02, "least": 2e-3}
        charts.append(chart | {"lines": lines, "points": points})
    return charts


def _parameter_charts(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """One chart for each parameter that a variant moves; adds columns of all."""
    constant = constant_parameters(results)
    variants_of: dict[str, list[str]] = {}
    for name, variant in results["series"]["variants"].items():
        for parameter, values in variant["parameters"].items():
            if parameter == "t_s":
                columns[f"{name}/parameters/t_s"] = values
                continue
            columns[f"{name}/{parameter}"] = values["value"]
            columns[f"{name}/{parameter}/sigma"] = values["sigma"]
            variants_of.setdefault(parameter, []).append(name)
    charts = []
    for parameter, variants in variants_of.items():
        names = [name for name in variants if name not in constant.get(parameter, {})]
        if not names:
            continue
        sigmas = [floats(columns[f"{name}/{parameter}/sigma"]) for name in names]
        medians = [float(np.nanmedian(sigma)) for sigma in sigmas if np.isfinite(sigma).any()]
        usual_sigma = max(medians, default=0.0)
        lines, bands = [], []
        for name in names:
            times = {"x": f"{name}/parameters/t_s"}
            lines.append(_line(name, parameter) | times)
            bands.append(_band(name, f"{parameter}/sigma", 2.0, parameter) | times)
        title = PARAMETER_TITLES.get(parameter, parameter)
        chart: Chart = {"place": "parameters", "title": title, "lines": lines, "bands": bands}
        chart["y_label"] = f"{parameter} [{unit(parameter)}]"
        charts.append(chart | {"least": max(0.2 * usual_sigma, 1e-12)})
    return charts


def constant_parameters(results: Results) -> dict[str, dict[str, tuple[float, float]]]:
    """Learnt parameters that a variant does not move: last value and sigma.

    The value and the standard deviation change by less than `STEADY` of the standard deviation at
    the start: their curves are level. Keys are the names of parameters, then of variants.
    """
    constant: dict[str, dict[str, tuple[float, float]]] = {}
    for name, variant in results["series"]["variants"].items():
        for parameter, columns in variant["parameters"].items():
            if parameter == "t_s":
                continue
            value, sigma = floats(columns["value"]), floats(columns["sigma"])
            moves = np.ptp(value) >= STEADY * sigma[0] or sigma[-1] < (1.0 - STEADY) * sigma[0]
            if np.isfinite(value).all() and not moves:
                constant.setdefault(parameter, {})[name] = (float(value[-1]), float(sigma[-1]))
    return constant


def _innovation_charts(results: Results, columns: dict[str, Numbers]) -> list[Chart]:
    """One chart for each component of a sensor, in units of σ; adds their columns."""
    points: dict[str, list[Results]] = {}
    for name, variant in results["series"]["variants"].items():
        for component, values in variant["innovations"].items():
            key = f"{name}/innovation_{component}"
            columns[f"{key}/t_s"], columns[key] = values["t_s"], values["normalised"]
            dots = {"series": name, "x": f"{key}/t_s", "y": key, "size": 1.1}
            points.setdefault(component, []).append(dots)
    # Dashed at two sigma, solid at three.
    levels = [*({"y": y, "dash": "4 3"} for y in (-2.0, 2.0)), {"y": -3.0}, {"y": 3.0}]
    return [
        {
            "place": "innovations",
            "title": INNOVATION_TITLES.get(component, component.replace("_", " ")),
            "y_label": "innovation / σ [-]",
            "points": component_points,
            "levels": levels,
            "limit": LARGEST_INNOVATION,
            "least": 0.1,
        }
        for component, component_points in points.items()
    ]


def _line(name: str, key: str, *, scale: float = 1.0) -> Results:
    """Line of a variant's column over the common time, times `scale`."""
    return {"series": name, "x": "t", "y": f"{name}/{key}", "scale": scale}


def _band(
    name: str, sigma: str, times: float, middle: str | None = None, *, scale: float = 1.0
) -> Results:
    """Band of a variant about zero or a column, to plus and minus `times` another one."""
    columns = {"middle": f"{name}/{middle}" if middle else None, "sigma": f"{name}/{sigma}"}
    return {"series": name, "x": "t", **columns, "times": times, "scale": scale}


def _labelled(label: str, column: str, colour: str) -> Results:
    """Line of a column over the common time that no switch hides."""
    style = {"label": label, "colour": colour, "dark": on_dark(colour)}
    return style | {"x": "t", "y": column, "scale": 1.0}
