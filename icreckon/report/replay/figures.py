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
from icreckon.report.replay.page_charts import breaks_of
from icreckon.report.replay.page_drive import floats
from icreckon.report.replay.page_text import failures, has_yaw_errors, page_title

# Variants whose uncertainty and indices are drawn, and those in the title, wheels and gyro first.
SHOWN_IN_DETAIL = ("constant-online", "inertia-online")
IN_TITLE = ("gyro", *SHOWN_IN_DETAIL)
# Least range of the axes, also for a robot that never moved [m, deg].
LEAST_POSITION_ERROR, LEAST_YAW_ERROR = 1e-3, 0.01
# Bounds beyond this multiple of an axis are not drawn.
FAR_BEYOND = 3.0
# Largest range of the axis of yaw errors, which are at most 180 [deg].
LARGEST_YAW_ERROR = 190.0
# Most intervals between the ticks of an axis of time.
TIME_TICKS = 5
# Size [in] and dots per inch: letters are about 12 px high where a page shows it 800 px wide.
SIZE, DOTS = (10.0, 8.6), 160
# Labels of shades in the legend.
SHADES, BOUNDS = ("no fixes",), "3σ of a filter"


def write_figure(path: Path, results: Results) -> None:
    """Draw paths, errors with 3-sigma bounds, and the indices over time, as PNG."""
    results = _with_breaks(results)
    with drawing(SIZE, {"font.size": 11, "text.parse_math": False}) as figure:
        grid = figure.add_gridspec(2, 1, height_ratios=(2.2, 1.0))
        of_errors = grid[0].subgridspec(2, 2, width_ratios=(1.0, 1.1), height_ratios=(1.7, 1.0))
        paths = figure.add_subplot(of_errors[:, 0])
        _draw_paths(paths, results)
        errors = figure.add_subplot(of_errors[0, 1])
        yaw = figure.add_subplot(of_errors[1, 1], sharex=errors)
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
        indices = grid[1].subgridspec(1, 3)
        for place, key in enumerate(INDEX_TITLES):
            axes = figure.add_subplot(indices[place], sharex=errors)
            _draw_index(axes, results, key)
            axes.set_xlabel("time [s]")
        handles = [*paths.get_legend_handles_labels()[0], *_shades(errors)]
        figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=10)
        title = "\n".join([_title(results), *failures(results)])
        figure.suptitle(printable(title), fontsize=12)
        figure.savefig(path, dpi=DOTS, metadata={"Title": title})


def _shades(axes: Axes) -> list[Any]:
    """Legend handles of the shaded areas: times without fixes, 3-sigma bounds."""
    handles, labels = axes.get_legend_handles_labels()
    shades = [one for one, label in zip(handles, labels, strict=True) if label in SHADES]
    # One for all: each band has the colour of its filter.
    return shades + [Patch(color="0.5", alpha=0.3, lw=0, label=BOUNDS)] * (BOUNDS in labels)


def _with_breaks(results: Results) -> Results:
    """Insert a row of None in each hole of the series, so that no line crosses it."""
    series = results["series"]
    rows, count = breaks_of(series["t_s"]), len(series["t_s"])
    if not rows:
        return results

    def inserted(values: Any) -> Any:
        if isinstance(values, dict):
            return {key: inserted(one) for key, one in values.items()}
        if not isinstance(values, list) or len(values) != count:
            return values
        found = np.insert(floats(values), rows, np.nan).tolist()
        return [None if math.isnan(value) else value for value in found]

    broken = {key: inserted(values) for key, values in series.items()}
    broken["t_s"] = np.insert(floats(series["t_s"]), rows, floats(series["t_s"])[rows]).tolist()
    return results | {"series": broken}


def _title(results: Results) -> str:
    log, truth = results["log"], results["truth"]
    title = f"{page_title(results)}, {log['duration_s']:.0f} s"
    if truth is None:
        return f"{title}, no ground truth"
    drifts = {
        name: results["variants"][name]["drift_percent_30s_mean"]
        for name in IN_TITLE
        if name in results["variants"]
    }
    text = ", ".join(f"{name} {value:.2f} %" for name, value in drifts.items() if value is not None)
    drift = f"\ndrift after 30 s without fixes: {text}" if text else ""
    simulated = "simulated: " if results["command"] == "demo" else ""
    return f"{simulated}{title}, truth: {truth['source']}{drift}"


def _detailed(results: Results) -> list[str]:
    """Names of `SHOWN_IN_DETAIL` that were run, else of the last two variants."""
    variants = results["series"]["variants"]
    shown = [name for name in SHOWN_IN_DETAIL if name in variants]
    return shown or list(variants)[-2:]


def _style(name: str, *, bold: bool) -> str:
    if name.endswith(SMOOTHED):
        return ":"
    return "-" if bold else "--"


def _draw_paths(axes: Axes, results: Results) -> None:
    series = results["series"]
    if "truth" in series:
        truth = series["truth"]
        axes.plot(
            truth["x_m"], truth["y_m"], color=TRUTH_COLOUR, lw=2.5, alpha=0.8, label="ground truth"
        )
        # A truth may begin after the log.
        known = [
            place for place in zip(truth["x_m"], truth["y_m"], strict=True) if None not in place
        ]
        if known:
            axes.plot(*known[0], "o", color=TRUTH_COLOUR, ms=8, label="start")
    if "fixes" in series and series["fixes"]["x_m"]:
        fixes = series["fixes"]
        axes.plot(fixes["x_m"], fixes["y_m"], "+", color=FIX_COLOUR, ms=7, label="fixes used")
    detailed = _detailed(results)
    for name, one in series["variants"].items():
        bold = name in detailed
        axes.plot(
            one["x_m"],
            one["y_m"],
            color=colour_of(name),
            lw=1.6 if bold else 0.9,
            ls=_style(name, bold=bold),
            label=name,
        )
        axes.plot(one["x_m"][-1], one["y_m"][-1], "s", color=colour_of(name), ms=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title("paths (squares: ends)", fontsize=11)


def _shade_outages(axes: Axes, results: Results) -> None:
    truth = results["truth"]
    if truth is None or not results["log"]["fixes"]:
        return
    for index, (start, end) in enumerate(truth["scored_s"]):
        axes.axvspan(start, end, color="#F0E442", alpha=0.25, label=None if index else SHADES[0])


def _draw_position_errors(axes: Axes, results: Results) -> None:
    series = results["series"]
    time, detailed = series["t_s"], _detailed(results)
    _shade_outages(axes, results)
    for name, one in series["variants"].items():
        bold = name in detailed
        axes.plot(
            time,
            one["position_error_m"],
            color=colour_of(name),
            lw=1.6 if bold else 0.8,
            ls=_style(name, bold=True),
            label=name,
        )
    shown = [series["variants"][name] for name in detailed]
    top = max(float(np.nanmax(floats(one["position_error_m"]))) for one in shown)
    bounds = [3.0 * floats(one["position_sigma_m"]) for one in shown]
    limit = max(1.15 * max(top, _widest(bounds, 2.5 * top)), LEAST_POSITION_ERROR)
    for number, (name, bound) in enumerate(zip(detailed, bounds, strict=True)):
        reached, label = _in_reach(bound, limit), None if number else BOUNDS
        axes.fill_between(time, 0.0, reached, color=colour_of(name), alpha=0.13, lw=0, label=label)
    axes.set_ylim(0.0, limit)
    axes.set_title("position error [m]", fontsize=11)


def _widest(bounds: Sequence[Any], most: float) -> float:
    """Largest bound up to `most`; those of a gap of the log set no scale."""
    return max(float(np.max(bound, where=bound <= most, initial=0.0)) for bound in bounds)


def _in_reach(bounds: Any, limit: float) -> Any:
    """Bounds, NaN where they are so far beyond the axis that they would only fill it."""
    return np.where(bounds > FAR_BEYOND * limit, np.nan, bounds)


def _draw_yaw_errors(axes: Axes, results: Results) -> None:
    series = results["series"]
    time = series["t_s"]
    _shade_outages(axes, results)
    shown = [series["variants"][name] for name in _detailed(results)]
    errors = [np.degrees(floats(one["yaw_error_rad"])) for one in shown]
    bounds = [3.0 * np.degrees(floats(one["yaw_sigma_rad"])) for one in shown]
    top = max(float(np.nanmax(np.abs(values))) for values in errors)
    limit = max(1.15 * max(top, _widest(bounds, 5.0 * top)), LEAST_YAW_ERROR)
    limit = min(limit, LARGEST_YAW_ERROR)
    for name, error, bound in zip(_detailed(results), errors, bounds, strict=True):
        axes.plot(time, error, color=colour_of(name), lw=1.3)
        reached = _in_reach(bound, limit)
        axes.fill_between(time, -reached, reached, color=colour_of(name), alpha=0.13, lw=0)
    axes.set_ylim(-limit, limit)
    axes.set_title("yaw error [deg]", fontsize=11)


def _draw_lines(axes: Axes, results: Results, title: str, key: str, scale: float) -> None:
    """Draw a series of all variants over time, in another unit by `scale`."""
    series = results["series"]
    for name, one in series["variants"].items():
        axes.plot(series["t_s"], scale * floats(one[key]), color=colour_of(name), label=name)
    axes.set_title(title, fontsize=11)


INDEX_TITLES = {
    "zeta_m": "sliding ζ [m]",
    "epsilon_m": "eccentricity ε [m]",
    "eta": "steering efficiency η [-]",
}


def _draw_index(axes: Axes, results: Results, key: str) -> None:
    series = results["series"]
    time = series["t_s"]
    _shade_outages(axes, results)
    truth = _true_index(results, key)
    if truth is not None:
        axes.plot(time, truth, ".", color=TRUTH_COLOUR, ms=2.5, label="truth")
    estimates = {name: floats(series["variants"][name][key]) for name in _detailed(results)}
    for name, values in estimates.items():
        axes.plot(time, values, color=colour_of(name), lw=1.2, label=name)
    axes.set_title(INDEX_TITLES[key], fontsize=11)
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


def _true_index(results: Results, key: str) -> Any:
    """Index of the true motion over time; None if the truth has none."""
    truth = results["series"].get("truth", {})
    if "icr_distance_m" not in truth:
        return None
    if key == "eta":
        return floats(truth["icr_distance_m"]) / results["robot"]["vehicle"]["track_gauge"]
    return floats(truth[key])
