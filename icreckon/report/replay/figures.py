"""Figure of a comparison, made from its results only."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.base.colours import FIX_COLOUR, TRUTH_COLOUR, colour_of
from icreckon.replay.comparison.results import Results
from icreckon.report.drawing import drawing
from icreckon.report.printable import printable
from icreckon.report.replay.page_charts import breaks_of, outages
from icreckon.report.replay.page_drive import floats
from icreckon.report.replay.page_text import failures, has_yaw_errors, page_title

# Variants whose uncertainty and indices are drawn, and those in the title, wheels and gyro first.
SHOWN_IN_DETAIL = ("constant-online", "inertia-online")
IN_TITLE = ("gyro", *SHOWN_IN_DETAIL)
# Least range of the axes, also for a robot that never moved [m, deg].
LEAST_POSITION_ERROR, LEAST_YAW_ERROR = 1e-3, 0.01
FAR_BEYOND = 3.0  # bounds beyond this multiple of an axis are not drawn
LARGEST_YAW_ERROR = 190.0  # largest range of the axis of yaw errors, which are at most 180 [deg]
TIME_TICKS = 5  # most intervals between the ticks of an axis of time
# Size [in] and dots per inch: letters are about 12 px high where a page shows it 800 px wide.
SIZE, DOTS = (10.0, 8.6), 160
# Legend labels of the shaded areas: times without fixes, 3-sigma bounds.
NO_FIXES, BOUNDS = "no fixes", "3σ of a filter"


def write_figure(path: Path, results: Results) -> None:
    """Draw paths, errors (without a truth bounds and yaws), and indices, as PNG."""
    results = _with_breaks(results)
    style = {"font.size": 11, "axes.titlesize": 11, "text.parse_math": False}
    with drawing(SIZE, style) as figure:
        rows = figure.add_gridspec(2, 1, height_ratios=(2.2, 1.0))
        upper = rows[0].subgridspec(2, 2, width_ratios=(1.0, 1.1), height_ratios=(1.7, 1.0))
        paths = figure.add_subplot(upper[:, 0])
        _draw_paths(paths, results)
        errors = figure.add_subplot(upper[0, 1])
        yaw = figure.add_subplot(upper[1, 1], sharex=errors)
        if results["truth"]:
            _draw_position_errors(errors, results)
        else:
            _draw_lines(errors, results, "own 3σ of position [m]", "position_sigma_m", 3.0)
        if has_yaw_errors(results):
            _draw_yaw_errors(yaw, results)
        else:
            _draw_lines(yaw, results, "yaw [deg]", "yaw_rad", 180.0 / math.pi)
        errors.tick_params(labelbottom=False)
        # All axes of time share these, the narrow ones of the indices, too.
        errors.xaxis.set_major_locator(MaxNLocator(TIME_TICKS, steps=[1, 2, 5, 10]))
        yaw.set_xlabel("time [s]")
        lower = rows[1].subgridspec(1, 3)
        for place, key in enumerate(INDEX_TITLES):
            axes = figure.add_subplot(lower[place], sharex=errors)
            _draw_index(axes, results, key)
            axes.set_xlabel("time [s]")
        handles, _ = paths.get_legend_handles_labels()
        shade_handles, labels = errors.get_legend_handles_labels()
        shades = dict(zip(labels, shade_handles, strict=True))
        if NO_FIXES in shades:
            handles.append(shades[NO_FIXES])
        if BOUNDS in shades:
            # One grey patch for all bounds: each has the colour of its filter.
            handles.append(Patch(color="0.5", alpha=0.3, lw=0, label=BOUNDS))
        figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=10)
        title = "\n".join([_title(results), *failures(results)])
        figure.suptitle(printable(title), fontsize=12)
        figure.savefig(path, dpi=DOTS, metadata={"Title": title})


def _with_breaks(results: Results) -> Results:
    """Insert a row of None in each hole of the series, so that no line crosses it."""
    series = results["series"]
    rows, count = breaks_of(series["t_s"]), len(series["t_s"])
    if not rows:
        return results

    def with_breaks(values: Any) -> Any:
        if isinstance(values, dict):
            return {key: with_breaks(nested) for key, nested in values.items()}
        # Columns with times of their own, as the fixes, have another number of rows.
        if not isinstance(values, list) or len(values) != count:
            return values
        with_nan = np.insert(floats(values), rows, np.nan).tolist()
        return [None if math.isnan(value) else value for value in with_nan]

    broken = {key: with_breaks(values) for key, values in series.items()}
    # Times have no None: the stamp of such a row is that of the row after it.
    times = floats(series["t_s"])
    broken["t_s"] = np.insert(times, rows, times[rows]).tolist()
    return results | {"series": broken}


def _title(results: Results) -> str:
    """Robot, log, truth, and the drift after 30 s of the variants `IN_TITLE`."""
    log, truth = results["log"], results["truth"]
    title = f"{page_title(results)}, {log['duration_s']:.0f} s"
    if truth is None:
        return f"{title}, no ground truth"
    variants, key = results["variants"], "drift_percent_30s_mean"
    drifts = {name: variants[name][key] for name in IN_TITLE if name in variants}
    text = ", ".join(f"{name} {drift:.2f} %" for name, drift in drifts.items() if drift is not None)
    drift_line = f"\ndrift after 30 s without fixes: {text}" if text else ""
    simulated = "simulated: " if results["command"] == "demo" else ""
    return f"{simulated}{title}, truth: {truth['source']}{drift_line}"


def _detailed(results: Results) -> list[str]:
    """Names of `SHOWN_IN_DETAIL` that were run, else of the last two variants."""
    variants = results["series"]["variants"]
    shown = [name for name in SHOWN_IN_DETAIL if name in variants]
    return shown or list(variants)[-2:]


def _style(name: str, *, is_bold: bool) -> str:
    """Line style of a variant: dotted if smoothed, solid if bold, dashed otherwise."""
    if name.endswith(SMOOTHED):
        return ":"
    return "-" if is_bold else "--"


def _draw_paths(axes: Axes, results: Results) -> None:
    """Draw the paths of truth and variants, the fixes used, start and ends."""
    series = results["series"]
    if "truth" in series:
        x, y = series["truth"]["x_m"], series["truth"]["y_m"]
        axes.plot(x, y, color=TRUTH_COLOUR, lw=2.5, alpha=0.8, label="ground truth")
        # A truth may begin after the log.
        known = [position for position in zip(x, y, strict=True) if None not in position]
        if known:
            axes.plot(*known[0], "o", color=TRUTH_COLOUR, ms=8, label="start")
    if "fixes" in series and series["fixes"]["x_m"]:
        fixes = series["fixes"]
        axes.plot(fixes["x_m"], fixes["y_m"], "+", color=FIX_COLOUR, ms=7, label="fixes used")
    detailed = _detailed(results)
    for name, columns in series["variants"].items():
        is_bold, colour = name in detailed, colour_of(name)
        x, y = columns["x_m"], columns["y_m"]
        style = _style(name, is_bold=is_bold)
        axes.plot(x, y, color=colour, lw=1.6 if is_bold else 0.9, ls=style, label=name)
        axes.plot(x[-1], y[-1], "s", color=colour, ms=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]", title="paths (squares: ends)")


def _shade_outages(axes: Axes, results: Results) -> None:
    for number, (start, end) in enumerate(outages(results)):
        # The first one alone is in the legend.
        label = NO_FIXES if number == 0 else None
        axes.axvspan(start, end, color="#F0E442", alpha=0.25, label=label)


def _draw_position_errors(axes: Axes, results: Results) -> None:
    """Draw position errors of all variants, with 3-sigma bounds of the detailed ones."""
    series = results["series"]
    time, detailed = series["t_s"], _detailed(results)
    _shade_outages(axes, results)
    for name, columns in series["variants"].items():
        style = _style(name, is_bold=True)
        width = 1.6 if name in detailed else 0.8
        errors = columns["position_error_m"]
        axes.plot(time, errors, color=colour_of(name), lw=width, ls=style, label=name)
    shown = [series["variants"][name] for name in detailed]
    largest = max(float(np.nanmax(floats(columns["position_error_m"]))) for columns in shown)
    bounds = [3.0 * floats(columns["position_sigma_m"]) for columns in shown]
    limit = max(1.15 * max(largest, _widest(bounds, 2.5 * largest)), LEAST_POSITION_ERROR)
    for number, (name, bound) in enumerate(zip(detailed, bounds, strict=True)):
        reached, label = _in_reach(bound, limit), BOUNDS if number == 0 else None
        axes.fill_between(time, 0.0, reached, color=colour_of(name), alpha=0.13, lw=0, label=label)
    axes.set(ylim=(0.0, limit), title="position error [m]")


def _widest(bounds: Sequence[Any], most: float) -> float:
    """Largest bound up to `most`; those of a gap of the log set no scale."""
    return max(float(np.max(bound, where=bound <= most, initial=0.0)) for bound in bounds)


def _in_reach(bounds: Any, limit: float) -> Any:
    """Bounds, NaN where they are so far beyond the axis that they would only fill it."""
    return np.where(bounds > FAR_BEYOND * limit, np.nan, bounds)


def _draw_yaw_errors(axes: Axes, results: Results) -> None:
    """Draw yaw errors of the detailed variants with their 3-sigma bounds."""
    time, variants = results["series"]["t_s"], results["series"]["variants"]
    names = _detailed(results)
    errors = [np.degrees(floats(variants[name]["yaw_error_rad"])) for name in names]
    bounds = [3.0 * np.degrees(floats(variants[name]["yaw_sigma_rad"])) for name in names]
    # The axis shows all errors, and bounds up to five times these.
    largest_error = max(float(np.nanmax(np.abs(error))) for error in errors)
    largest = max(largest_error, _widest(bounds, 5.0 * largest_error))
    limit = min(max(1.15 * largest, LEAST_YAW_ERROR), LARGEST_YAW_ERROR)
    _shade_outages(axes, results)
    for name, error, bound in zip(names, errors, bounds, strict=True):
        colour, drawn_bound = colour_of(name), _in_reach(bound, limit)
        axes.plot(time, error, color=colour, lw=1.3)
        axes.fill_between(time, -drawn_bound, drawn_bound, color=colour, alpha=0.13, lw=0)
    axes.set(ylim=(-limit, limit), title="yaw error [deg]")


def _draw_lines(axes: Axes, results: Results, title: str, key: str, scale: float) -> None:
    """Draw column `key` of all variants, times `scale`, over time."""
    series = results["series"]
    for name, columns in series["variants"].items():
        values = scale * floats(columns[key])
        axes.plot(series["t_s"], values, color=colour_of(name), label=name)
    axes.set_title(title)


INDEX_TITLES = {
    "zeta_m": "sliding ζ [m]",
    "epsilon_m": "eccentricity ε [m]",
    "eta": "steering efficiency η [-]",
}


def _draw_index(axes: Axes, results: Results, key: str) -> None:
    """Draw an index (a key of `INDEX_TITLES`) over time, with the truth."""
    series = results["series"]
    time, truth = series["t_s"], None
    _shade_outages(axes, results)
    if "icr_distance_m" in series.get("truth", {}):
        true_key = "icr_distance_m" if key == "eta" else key
        gauge = results["robot"]["vehicle"]["track_gauge"]
        truth = floats(series["truth"][true_key]) / (gauge if key == "eta" else 1.0)
        axes.plot(time, truth, ".", color=TRUTH_COLOUR, ms=2.5, label="truth")
    estimates = {name: floats(series["variants"][name][key]) for name in _detailed(results)}
    for name, values in estimates.items():
        axes.plot(time, values, color=colour_of(name), lw=1.2, label=name)
    axes.set_title(INDEX_TITLES[key])
    estimated = np.concatenate([*estimates.values()])
    if np.isfinite(estimated).any():
        axes.set_ylim(*_index_limits(estimated, truth))


def _index_limits(estimated: Any, truth: Any) -> tuple[float, float]:
    """Limits of an axis for estimates (n,) and a truth (m,) or None, NaN if unknown.

    Indices diverge when the robot goes almost straight, so the base range leaves out 1 % of all values at
    each end. Peaks of an estimate extend it, by at most its own width on either side.
    """
    shown = estimated if truth is None else np.concatenate([truth, estimated])
    low, high = np.nanpercentile(shown, (1.0, 99.0))
    width = high - low
    lowest_peak, highest_peak = np.nanmin(estimated), np.nanmax(estimated)
    low = min(low, max(lowest_peak, low - width))
    high = max(high, min(highest_peak, high + width))
    margin = 0.15 * (high - low) + 1e-3
    return low - margin, high + margin
