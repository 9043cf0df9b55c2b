"""Figures of a study, made from its results only."""

import math
import re
from collections.abc import Callable
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, ScalarFormatter

from icreckon.replay.base.colours import COLOURS
from icreckon.report.drawing import SIZE, drawing, png
from icreckon.report.pages import Picture
from icreckon.report.replay.page_drive import floats
from icreckon.report.study.text import NEES, statistic_of, swept
from icreckon.simulation.study.cells import OUTAGE
from icreckon.simulation.study.results import FINAL_ERROR, PERCENTILES, Results, shown
from icreckon.simulation.study.summary import CONFIDENCE

# Custom labels have the colours that the variants leave.
OTHER_COLOURS = ("#009E73", "black", "#F0E442", *COLOURS.values())
MARKERS = "osD^vPX*"
STYLE = {"font.size": 12, "axes.titlesize": 11, "legend.fontsize": 10, "legend.framealpha": 0.9}
METADATA = {"Software": None}  # no version of matplotlib: equal figures are equal bytes
# Most names on an axis, or letters in them, without rotation; most cells named by their values, level and
# upright.
MOST_UPRIGHT = 4
MOST_LETTERS = 60
MOST_NAMED_CELLS, MOST_UPRIGHT_CELLS = 12, 40
LEAST_DRIFT = 1e-6  # smallest drift that a colour shows [%]
LOG_SPAN = 30.0  # ratio of the largest to the smallest value from which an axis is logarithmic
SPREAD = 0.5  # range of the variants at one place, as a share of the distance between places
INERTIAL = {
    "noise_density": "{}/√Hz",
    "bias_sigma": "{}",
    "bias_instability": "{}",
    "bias_instability_time": "s",
    "bias_walk": "{}/√s",
    "misalignment_sigma": "rad",
    "range": "{}",
}
ENCODERS = {"speed_noise_density": "m/s/√Hz", "resolution": "m"}
ENCODERS |= {"dropouts_per_hour": "1/h", "dropout_duration": "s"}
FIXES = {"sigma": "m", "heading_sigma": "rad", "outlier_sigma": "m", "latency": "s"}
FIXES |= {"wander_sigma": "m", "wander_time": "s"}
UNITS = {
    **{f"gyro.{name}": unit.format("rad/s") for name, unit in INERTIAL.items()},
    **{f"accelerometer.{name}": unit.format("m/s²") for name, unit in INERTIAL.items()},
    **{f"encoders.{key}": unit for key, unit in ENCODERS.items()},
    **{f"fixes.{key}": unit for key, unit in FIXES.items()},
    **dict.fromkeys(("duration", "track_lag"), "s"),
    **dict.fromkeys(("track_rate", "imu_rate", "truth_rate", "fix_rate"), "Hz"),
}
"""Unit by the key of a scenario."""


def with_unit(axis: str) -> str:
    """Name of an axis with its unit, if it is a key that has one."""
    unit = (UNITS | {OUTAGE: "s"}).get(axis)
    return axis if unit is None else f"{axis} [{unit}]"


def study_figures(results: Results) -> list[Picture]:
    """Draw all figures of a study."""
    figures, drift = [], results["drift"]
    drift_title = _title(results, drift)
    others = ", over all else that is swept" if len(swept(results)) > 1 else ""
    is_grid = len(swept(results)) == 2 and not any(axis["sampled"] for axis, _ in swept(results))
    if is_grid and _has_values(results, drift):
        figures.append(_draw_drift_grid(results))
    for axis, effect in swept(results):
        name = re.sub(r"[^A-Za-z0-9]+", "-", axis["name"]).strip("-").lower()
        for prefix, statistic in (("drift", drift), ("final-error", FINAL_ERROR)):
            if _has_values(results, statistic):
                title = _title(results, statistic)
                caption = f"{title} against {axis['name']}{others}: means and their 95 % intervals."
                figure_name = f"{prefix}-{name}"
                data = (results, axis, effect, statistic)
                figures.append(_picture(figure_name, caption, _draw_effect, *data))
        if _has_values(results, drift) and len(results["variants"]) > 1:
            caption = (
                f"{drift_title} over that of {results['baseline']} in the same runs, against "
                f"{axis['name']}, with 95 % intervals. Below 1 a variant is better; an interval that "
                "holds 1 shows no difference."
            )
            data = (results, axis, effect, drift)
            figures.append(_picture(f"ratio-{name}", caption, _draw_effect, *data, "ratio"))
    if _has_values(results, NEES):
        caption = (
            "NEES of the pose at the end (error squared over the filter's own covariance), mean of "
            "the runs with its 95 % interval. Consistent filters lie in the grey band (chi-square "
            "with 3 degrees of freedom, over runs). Above it a filter is overconfident."
        )
        figures.append(_picture("consistency", caption, _draw_consistency, results))
    if results["final_errors"][0]["percentiles"]:
        caption = f"Share of runs up to each position error at the end{others}."
        figures.append(_picture("final-error-distribution", caption, _draw_distribution, results))
    return figures


def _picture(name: str, caption: str, draw: Callable[..., None], *data: Any) -> Picture:
    """Picture that `draw` draws of the data on axes of its own."""
    with drawing(SIZE, STYLE) as figure:
        draw(figure.add_subplot(), *data)
        return Picture(name, caption, png(figure, METADATA))


def _draw_effect(
    axes: Axes,
    results: Results,
    axis: dict[str, Any],
    effect: dict[str, Any],
    statistic: str,
    key: str = "mean",
) -> None:
    """Draw a statistic of all variants against a swept axis, with 95 % intervals.

    `key` is "mean", or "ratio" for the mean over that of the baseline, which is left out.
    """
    groups, variants, colours = effect["groups"], results["variants"], _colours(results)
    has_names = axis["scale"] == "names"
    places = np.arange(len(groups)) if has_names else floats([group["value"] for group in groups])
    means, highs = [], []
    y_label = "{title}\n[{unit}]".format(**statistic_of(results, statistic))
    if key == "ratio":
        axes.axhline(1.0, color="black", lw=0.8)
        title = statistic_of(results, statistic)["title"]
        y_label = f"{title}\nover that of {results['baseline']} [-]"
    for number, label in enumerate(variants):
        if key == "ratio" and label == results["baseline"]:
            continue
        summaries = [group["variants"][label][statistic] for group in groups]
        mean, low, high = _with_ends(summaries, key)
        colour, x = colours[label], places
        style: Any = {"color": colour, "marker": MARKERS[number % len(MARKERS)], "ms": 5}
        if has_names:
            x = places + _offset(number, len(variants))
            whiskers = _whiskers(mean, low, high)
            axes.errorbar(x, mean, whiskers, ls="", capsize=3, label=label, **style)
        else:
            axes.plot(x, mean, lw=1.5, label=label, **style)
            axes.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
        _mark_missing(axes, x, mean, colour)
        if axis["sampled"] and key == "mean":
            # A dot for each cell of the Latin hypercube.
            cells = results["cells"]
            cell_x = floats([cell["values"][axis["name"]] for cell in cells])
            cell_means = floats([cell["variants"][label][statistic]["mean"] for cell in cells])
            axes.plot(cell_x, cell_means, ".", color=colour, ms=4, alpha=0.5)
        means.append(mean)
        highs.append(np.fmax(mean, high))
    _limit_y(axes, np.concatenate(means), np.concatenate(highs))
    _label_places(axes, axis, groups, places)
    axes.set(xlabel=with_unit(axis["name"]), ylabel=y_label)
    _add_legend(axes)


def _label_places(axes: Axes, axis: dict[str, Any], groups: list[Any], places: Any) -> None:
    """Set scale and ticks of the horizontal axis: names, all values if few, or none."""
    if axis["scale"] == "names":
        _name_places(axes, [group["name"] for group in groups])
        return
    if axis["scale"] == "log":
        axes.set_xscale("log")
    if not axis["sampled"] and len(groups) <= MOST_NAMED_CELLS:
        axes.set_xticks(places, [shown(group["value"]) for group in groups])
        axes.minorticks_off()
    elif axis["scale"] == "log" and places.max() < LOG_SPAN * places.min():
        # A short logarithmic axis would have few powers of ten, and so few ticks.
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.minorticks_off()


def _add_legend(axes: Axes) -> None:
    """Draw the legend above the axes, where it hides no line."""
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(handles, labels, loc="outside upper center", ncols=4)


def _mark_missing(axes: Axes, places: Any, values: Any, colour: str) -> None:
    """Mark places without a result with a cross at the lower edge."""
    missing = places[~np.isfinite(values)]
    style: Any = {"color": colour, "ms": 9, "mew": 2.5, "clip_on": False}
    style["transform"] = axes.get_xaxis_transform()
    is_first = "no result" not in axes.get_legend_handles_labels()[1]
    style["label"] = "no result" if len(missing) and is_first else None
    axes.plot(missing, np.full(len(missing), 0.03), "x", **style)


def _draw_drift_grid(results: Results) -> Picture:
    """Draw the drift in each cell of two swept axes, with a panel for each variant."""
    drift, variants = results["drift"], results["variants"]
    # The first axis goes down, the second one to the right.
    (row_axis, row_effect), (column_axis, column_effect) = swept(results)
    row_names = [group["name"] for group in row_effect["groups"]]
    column_names = [group["name"] for group in column_effect["groups"]]
    drifts = {label: _mean_drifts(results, label) for label in variants}
    finite = np.concatenate([values[np.isfinite(values)] for values in drifts.values()])
    panel_columns = min(len(variants), 2)
    panel_rows = math.ceil(len(variants) / panel_columns)
    # Lengths in inches.
    panel_width, panel_height = 0.7 * len(column_names) + 0.6, 0.5 * len(row_names) + 1.2
    size = (max(SIZE[0], 1.2 + panel_columns * panel_width), panel_rows * max(2.6, panel_height))
    with drawing(size, STYLE | {"axes.grid": False}) as figure:
        panels = figure.subplots(panel_rows, panel_columns, squeeze=False, sharey=True)
        high = max(float(finite.max()), LEAST_DRIFT)
        # At most three powers of ten; the bounds of a logarithmic scale must differ.
        low = max(float(finite.min()), LEAST_DRIFT, 1e-3 * high)
        scale = LogNorm(low, max(high, 1.01 * low))
        for axes, (label, values) in zip(panels.flat, drifts.items(), strict=False):
            image = axes.imshow(values, "cividis_r", aspect="auto", norm=scale)
            for (row, column), value in np.ndenumerate(values):
                colour = "white" if np.isfinite(value) and scale(value) > 0.5 else "black"
                text = f"{value:#.3g}".rstrip(".") if np.isfinite(value) else "x"
                axes.text(column, row, text, ha="center", va="center", color=colour, size=10)
            axes.set_title(label)
            axes.set_xticks(range(len(column_names)), column_names)
            axes.set_yticks(range(len(row_names)), row_names)
            if max(map(len, column_names)) * len(column_names) * panel_columns > MOST_LETTERS:
                axes.tick_params("x", rotation=60)
        for axes in list(panels.flat)[len(variants) :]:
            axes.set_visible(False)
        figure.supxlabel(with_unit(column_axis["name"]), fontsize=12)
        figure.supylabel(with_unit(row_axis["name"]).replace(" [", "\n["), fontsize=12, ma="center")
        label = "{title}\n[{unit}]".format(**statistic_of(results, drift))
        ticks = LogLocator(subs=(1.0, 2.0, 5.0)) if high > 5.0 * low else MaxNLocator(5)
        bar = figure.colorbar(image, ax=panels, label=label, ticks=ticks)
        bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        bar.ax.yaxis.set_minor_locator(NullLocator())
        caption = f"{_title(results, drift)} in each cell (mean of the runs)."
        return Picture("drift-grid", caption, png(figure, METADATA))


def _mean_drifts(results: Results, label: str) -> Any:
    """Mean drift (rows, columns) of a variant [%], NaN if unknown, by two swept axes."""
    (_, row_effect), (_, column_effect) = swept(results)
    means = []
    for row in row_effect["groups"]:
        for column in column_effect["groups"]:
            # One cell has both values: nothing else is swept.
            (cell,) = {*row["cells"]} & {*column["cells"]}
            means.append(results["cells"][cell]["variants"][label][results["drift"]]["mean"])
    return floats(means).reshape(len(row_effect["groups"]), -1)


def _draw_consistency(axes: Axes, results: Results) -> None:
    """Draw the mean NEES by cell, with the band of a consistent filter."""
    from scipy.stats import chi2

    cells, variants = results["cells"], results["variants"]
    # The mean NEES of n runs is chi-square with 3 n degrees of freedom, over n.
    runs = results["runs"]
    band_low, band_high = (bound / runs for bound in chi2.interval(CONFIDENCE, 3.0 * runs))
    axes.axhspan(band_low, band_high, color="grey", alpha=0.3, lw=0)
    axes.axhline(3.0, color="black", lw=0.8)
    means, lows = [], []
    for number, label in enumerate(variants):
        summaries = [cell["variants"][label][NEES] for cell in cells]
        mean, low, high = _with_ends(summaries, "mean")
        means.append(mean)
        lows.append(low)
        # On a logarithmic axis, an interval that reaches below zero has no lower end.
        low = np.where(low > 0.0, low, np.fmin(mean, 3.0) * 1e-3)
        x = np.arange(len(cells)) + _offset(number, len(variants))
        width = 1.0 if len(cells) <= MOST_NAMED_CELLS else 0.5
        style: Any = {"color": _colours(results)[label], "marker": MARKERS[number % len(MARKERS)]}
        style |= {"ls": "", "capsize": 2, "ms": 4, "lw": width, "label": label}
        axes.errorbar(x, mean, _whiskers(mean, low, high), **style)
    all_means, all_lows = np.concatenate(means), np.concatenate(lows)
    # NaN is not positive.
    shown_means = [band_low, band_high, *all_means[all_means > 0.0]]
    _scale_log_axis(axes, shown_means, all_lows[all_lows > 0.0])
    _label_cells(axes, results)
    axes.set_ylabel("NEES of the pose at the end [-]")
    _add_legend(axes)


def _scale_log_axis(axes: Axes, means: Any, lows: Any) -> None:
    """Limit a logarithmic axis to all means, and to lower ends that do not dwarf them."""
    axes.set_yscale("log")
    bottom = max(0.8 * min([*means, *lows]), 0.1 * min(means))
    axes.set_ylim(bottom, 3.0 * max(means))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(NullLocator())


def _label_cells(axes: Axes, results: Results) -> None:
    """Label cells by values if few, by index if many; a lone one by its variants."""
    cells, variants = results["cells"], results["variants"]
    keys = [axis["name"] for axis, _ in swept(results)]
    if keys and len(cells) <= MOST_NAMED_CELLS:
        names = ["\n".join(shown(cell["values"][key]) for key in keys) for cell in cells]
        _name_places(axes, names)
        axes.set_xlabel("\n".join(map(with_unit, keys)))
    elif len(cells) == 1:
        places = [_offset(number, len(variants)) for number in range(len(variants))]
        axes.set_xticks(places, [name.replace("-", "-\n") for name in variants])
    elif keys and len(cells) <= MOST_UPRIGHT_CELLS:
        names = [", ".join(shown(cell["values"][key]) for key in keys) for cell in cells]
        axes.set_xticks(range(len(cells)), names, rotation=90, fontsize=8)
        axes.set_xlabel(", ".join(map(with_unit, keys)))
    else:
        axes.set_xlabel("cell")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_distribution(axes: Axes, results: Results) -> None:
    """Draw the share of runs up to each error at the end."""
    colours, errors = _colours(results), list[float]()
    for label, percentiles in results["final_errors"][0]["percentiles"].items():
        errors += percentiles
        shares = np.array(PERCENTILES) / 100.0
        axes.plot(floats(percentiles), shares, color=colours[label], lw=1.5, label=label)
    positive = [error for error in errors if error > 0.0]
    if positive and max(positive) > LOG_SPAN * np.median(positive):
        axes.set_xscale("log")
    axes.set_xlabel("position error at the end [m]")
    axes.set_ylabel("share of runs")
    _add_legend(axes)


def _limit_y(axes: Axes, means: Any, highs: Any) -> None:
    """Limit the y axis: all means, ends of intervals to 2.5 times the highest one."""
    means, highs = means[np.isfinite(means)], highs[np.isfinite(highs)]
    if not len(means):
        return
    lowest, highest = float(means.min()), float(means.max())
    if lowest > 0.0 and highest > LOG_SPAN * lowest:
        axes.set(yscale="log", ylim=(0.5 * lowest, 2.0 * highest))
        return
    top = 1.08 * min(float(highs.max()), 2.5 * highest)
    # An axis of zeros alone needs some height.
    axes.set_ylim(0.0, top or 1.0)


def _name_places(axes: Axes, names: list[str]) -> None:
    """Name the places 0, 1, ... of an axis; names that need much room are rotated."""
    longest = max(len(line) for name in names for line in name.split("\n"))
    is_upright = len(names) <= MOST_UPRIGHT or longest * len(names) <= MOST_LETTERS
    axes.set_xticks(np.arange(len(names)), names, rotation=0 if is_upright else 60)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.grid(visible=False, axis="x")


def _whiskers(mean: Any, low: Any, high: Any) -> Any:
    """Lengths (2, n) of intervals below and above; zero if there is no interval."""
    return np.nan_to_num(np.maximum(np.stack([mean - low, high - mean]), 0.0))


def _with_ends(summaries: list[dict[str, Any]], key: str) -> tuple[Any, Any, Any]:
    """Means or ratios (n,) of summaries and the ends of their intervals, NaN for None."""
    ends = [[summary[f"{key}{end}"] for summary in summaries] for end in ("", "_low", "_high")]
    mean, low, high = floats(ends)
    return mean, low, high


def _offset(number: int, count: int) -> float:
    """Offset of variant `number` of `count` from the place that they share on an axis."""
    return SPREAD * ((number + 0.5) / count - 0.5)


def _has_values(results: Results, statistic: str) -> bool:
    """Return True if any run of any variant has the statistic."""
    return any(summaries[statistic]["n"] for summaries in results["overall"].values())


def _colours(results: Results) -> dict[str, str]:
    """Colour by label: that of the variant, or for a custom label an unused one."""
    variants = results["variants"]
    unused = cycle(colour for colour in OTHER_COLOURS if colour not in map(COLOURS.get, variants))
    return {label: COLOURS.get(label) or next(unused) for label in variants}


def _title(results: Results, statistic: str) -> str:
    """Title of a statistic, which begins a caption."""
    title: str = statistic_of(results, statistic)["title"]
    return title[:1].upper() + title[1:]
