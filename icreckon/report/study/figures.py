"""Figures of a study, made from its results only."""

import re
from collections.abc import Callable
from functools import partial
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
from icreckon.report.study.text import NEES, swept, title_of, unit_of
from icreckon.simulation.study.cells import OUTAGE
from icreckon.simulation.study.results import FINAL_ERROR, PERCENTILES, Results, shown
from icreckon.simulation.study.summary import CONFIDENCE

# Custom labels have the colours that the variants leave.
OTHER_COLOURS = ("#009E73", "black", "#F0E442", *COLOURS.values())
MARKERS = "osD^vPX*"
STYLE = {"font.size": 12, "legend.framealpha": 0.9}
# Without the version of matplotlib, so that equal figures are equal bytes.
METADATA = {"Software": None}
# Most names on an axis, or letters in them, without rotation; most cells named by their values.
MOST_UPRIGHT = 4
MOST_LETTERS = 60
MOST_NAMED_CELLS = 12
# Smallest drift that a colour shows [%].
LEAST_DRIFT = 1e-6
# Ratio of the largest to the smallest value from which an axis is logarithmic.
LOG_SPAN = 30.0
# Range of the variants at one place, as a share of the distance between places.
SPREAD = 0.5
INERTIAL = {
    "noise_density": "{}/√Hz",
    "bias_sigma": "{}",
    "bias_instability": "{}",
    "bias_instability_time": "s",
    "bias_walk": "{}/√s",
    "misalignment_sigma": "rad",
    "range": "{}",
}
UNITS = {
    **{f"gyro.{name}": unit.format("rad/s") for name, unit in INERTIAL.items()},
    **{f"accelerometer.{name}": unit.format("m/s²") for name, unit in INERTIAL.items()},
    "encoders.speed_noise_density": "m/s/√Hz",
    "encoders.resolution": "m",
    "encoders.dropouts_per_hour": "1/h",
    "encoders.dropout_duration": "s",
    "fixes.sigma": "m",
    "fixes.heading_sigma": "rad",
    "fixes.outlier_sigma": "m",
    "fixes.latency": "s",
    "fixes.wander_sigma": "m",
    "fixes.wander_time": "s",
    "duration": "s",
    "track_lag": "s",
    "track_rate": "Hz",
    "imu_rate": "Hz",
    "truth_rate": "Hz",
    "fix_rate": "Hz",
}
"""Unit by the key of a scenario."""


def with_unit(axis: str) -> str:
    """Name of an axis with its unit, if it is a key that has one."""
    unit = (UNITS | {OUTAGE: "s"}).get(axis)
    return axis if unit is None else f"{axis} [{unit}]"


def study_figures(results: Results) -> list[Picture]:
    """Draw all figures of a study."""
    figures, drift = [], results["drift"]
    others = ", over all else that is swept" if len(swept(results)) > 1 else ""
    is_grid = len(swept(results)) == 2 and not any(axis["sampled"] for axis, _ in swept(results))
    if is_grid and _known(results, drift):
        figures.append(_grid(results))
    for axis, effect in swept(results):
        draw = partial(_draw_effect, results=results, axis=axis, effect=effect)
        for short, statistic in (("drift", drift), ("final-error", FINAL_ERROR)):
            if not _known(results, statistic):
                continue
            title = _capital(title_of(results, statistic))
            caption = f"{title} against {axis['name']}{others}: means and their 95 % intervals."
            name = f"{short}-{_file_name(axis['name'])}"
            figures.append(_drawn(name, caption, partial(draw, statistic=statistic)))
        if _known(results, drift) and len(results["variants"]) > 1:
            caption = (
                f"{_capital(title_of(results, drift))} over that of {results['baseline']} in the same "
                f"runs, against {axis['name']}, with 95 % intervals. Below 1 a variant is better; an "
                "interval that holds 1 shows no difference."
            )
            name = f"ratio-{_file_name(axis['name'])}"
            figures.append(_drawn(name, caption, partial(draw, statistic=drift, key="ratio")))
    if _known(results, NEES):
        figures.append(
            _drawn(
                "consistency",
                "NEES of the pose at the end (error squared over the filter's own covariance), mean of "
                "the runs with its 95 % interval. Consistent filters lie in the grey band (chi-square "
                "with 3 degrees of freedom, over runs). Above it a filter is overconfident.",
                lambda axes: _draw_consistency(axes, results),
            )
        )
    figures.append(_distribution(results, others))
    return figures


def _drawn(name: str, caption: str, draw: Callable[[Axes], None]) -> Picture:
    with drawing(SIZE, STYLE) as figure:
        draw(figure.add_subplot())
        return Picture(name, caption, png(figure, METADATA))


def _draw_effect(
    axes: Axes,
    results: Results,
    axis: dict[str, Any],
    effect: dict[str, Any],
    statistic: str,
    key: str = "mean",
) -> None:
    """Draw a statistic against one axis: its "mean", or its "ratio" to the baseline's."""
    groups = effect["groups"]
    names = axis["scale"] == "names"
    places = np.arange(len(groups)) if names else floats([one["value"] for one in groups])
    variants, colours = results["variants"], _colours(results)
    lows, highs = [], []
    if key == "ratio":
        axes.axhline(1.0, color="black", lw=0.8)
    for number, label in enumerate(variants):
        if key == "ratio" and label == results["baseline"]:
            continue
        summaries = [group["variants"][label][statistic] for group in groups]
        mean, low, high = (
            floats([one[f"{key}{end}"] for one in summaries]) for end in ("", "_low", "_high")
        )
        style: Any = {"color": colours[label], "marker": MARKERS[number % len(MARKERS)], "ms": 5}
        if names:
            at = places + _offset(number, len(variants))
            axes.errorbar(
                at, mean, _whiskers(mean, low, high), ls="", capsize=3, label=label, **style
            )
        else:
            axes.plot(places, mean, lw=1.5, label=label, **style)
            axes.fill_between(places, low, high, color=style["color"], alpha=0.15, lw=0)
        _mark_missing(axes, at if names else places, mean, style["color"])
        if axis["sampled"] and key == "mean":
            _draw_cells(axes, results, axis["name"], label, statistic, style["color"])
        lows.append(mean)
        highs.append(np.fmax(mean, high))
    _limit(axes, np.concatenate(lows), np.concatenate(highs))
    if names:
        _name_places(axes, [group["name"] for group in groups])
    elif axis["scale"] == "log":
        axes.set_xscale("log")
    if not names and not axis["sampled"] and len(groups) <= MOST_NAMED_CELLS:
        axes.set_xticks(places, [shown(one["value"]) for one in groups])
        axes.minorticks_off()
    elif axis["scale"] == "log" and places.max() < LOG_SPAN * places.min():
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.minorticks_off()
    axes.set_xlabel(with_unit(axis["name"]))
    if key == "ratio":
        axes.set_ylabel(f"{title_of(results, statistic)}\nover that of {results['baseline']} [-]")
    else:
        axes.set_ylabel(f"{title_of(results, statistic)}\n[{unit_of(results, statistic)}]")
    _name_variants(axes)


def _name_variants(axes: Axes) -> None:
    """Draw the legend above the axes, where it hides no line."""
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=10)


def _mark_missing(axes: Axes, places: Any, values: Any, colour: str) -> None:
    """Mark places without a result with a cross at the lower edge."""
    missing = places[~np.isfinite(values)]
    axes.plot(
        missing,
        np.full(len(missing), 0.03),
        "x",
        color=colour,
        ms=9,
        mew=2.5,
        clip_on=False,
        transform=axes.get_xaxis_transform(),
        label="no result" if len(missing) else None,
    )


def _draw_cells(
    axes: Axes, results: Results, axis: str, label: str, statistic: str, colour: str
) -> None:
    """Draw the cells of a Latin hypercube, one point each."""
    cells = results["cells"]
    at = floats([one["values"][axis] for one in cells])
    values = floats([one["variants"][label][statistic]["mean"] for one in cells])
    axes.plot(at, values, ".", color=colour, ms=4, alpha=0.5)


def _grid(results: Results) -> Picture:
    """Draw the drift in each cell of two axes, with a panel for each variant."""
    drift, variants = results["drift"], results["variants"]
    (down, by_row), (across, by_column) = swept(results)
    groups = by_row["groups"], by_column["groups"]

    def mean_in(one: dict[str, Any], other: dict[str, Any], label: str) -> float | None:
        (cell,) = {*one["cells"]} & {*other["cells"]}
        found: float | None = results["cells"][cell]["variants"][label][drift]["mean"]
        return found

    panels = {
        label: floats([[mean_in(one, other, label) for other in groups[1]] for one in groups[0]])
        for label in variants
    }
    every = np.concatenate([one[np.isfinite(one)] for one in panels.values()])
    columns = min(len(variants), 2)
    rows = -(-len(variants) // columns)
    height = max(2.6, 0.5 * len(groups[0]) + 1.2)
    size = (max(SIZE[0], 1.2 + columns * (0.7 * len(groups[1]) + 0.6)), rows * height)
    with drawing(size, STYLE | {"axes.grid": False}) as figure:
        places = figure.subplots(rows, columns, squeeze=False, sharey=True)
        top = max(float(every.max()), LEAST_DRIFT)
        low = max(float(every.min()), LEAST_DRIFT, 1e-3 * top)
        scale = LogNorm(low, max(top, 1.01 * low))
        for axes, (label, values) in zip(places.flat, panels.items(), strict=False):
            image = axes.imshow(values, "cividis_r", aspect="auto", norm=scale)
            for (row, column), value in np.ndenumerate(values):
                colour = "white" if np.isfinite(value) and scale(value) > 0.5 else "black"
                text = f"{value:#.3g}".rstrip(".") if np.isfinite(value) else "x"
                axes.text(column, row, text, ha="center", va="center", color=colour, size=10)
            axes.set_title(label, fontsize=11)
            axes.set_xticks(range(len(groups[1])), [one["name"] for one in groups[1]])
            axes.set_yticks(range(len(groups[0])), [one["name"] for one in groups[0]])
            if max(len(one["name"]) for one in groups[1]) * len(groups[1]) * columns > MOST_LETTERS:
                axes.tick_params("x", rotation=60)
        for axes in list(places.flat)[len(variants) :]:
            axes.set_visible(False)
        figure.supxlabel(with_unit(across["name"]), fontsize=12)
        figure.supylabel(with_unit(down["name"]).replace(" [", "\n["), fontsize=12, ma="center")
        named = f"{title_of(results, drift)}\n[{unit_of(results, drift)}]"
        ticks = LogLocator(subs=(1.0, 2.0, 5.0)) if top > 5.0 * low else MaxNLocator(5)
        bar = figure.colorbar(image, ax=places, label=named, ticks=ticks)
        bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        bar.ax.yaxis.set_minor_locator(NullLocator())
        caption = (
            f"{_capital(title_of(results, drift))} in each cell (mean of the runs), darker is more."
        )
        return Picture("drift-grid", caption, png(figure, METADATA))


def _draw_consistency(axes: Axes, results: Results) -> None:
    """Draw the mean NEES by cell, with the band of a consistent filter."""
    from scipy.stats import chi2

    cells, variants = results["cells"], results["variants"]
    runs = results["runs"]
    low, high = (bound / runs for bound in chi2.interval(CONFIDENCE, 3.0 * runs))
    axes.axhspan(low, high, color="grey", alpha=0.3, lw=0)
    axes.axhline(3.0, color="black", lw=0.8)
    means, ends = [], []
    for number, label in enumerate(variants):
        summaries = [cell["variants"][label][NEES] for cell in cells]
        mean, least, most = (
            floats([one[key] for one in summaries]) for key in ("mean", "mean_low", "mean_high")
        )
        means.append(mean)
        ends.append(least)
        # On a logarithmic axis, an interval that reaches below zero has no lower end.
        least = np.where(least > 0.0, least, np.fmin(mean, 3.0) * 1e-3)
        at = np.arange(len(cells)) + _offset(number, len(variants))
        axes.errorbar(
            at,
            mean,
            _whiskers(mean, least, most),
            ls="",
            capsize=2,
            ms=4,
            lw=1.0 if len(cells) <= MOST_NAMED_CELLS else 0.5,
            color=_colours(results)[label],
            marker=MARKERS[number % len(MARKERS)],
            label=label,
        )
    axes.set_yscale("log")
    heights, lowest = np.concatenate(means), np.concatenate(ends)
    heights = heights[np.isfinite(heights) & (heights > 0.0)]
    lowest = lowest[np.isfinite(lowest) & (lowest > 0.0)]
    # Whiskers are whole, but for those that dwarf the means.
    bottom = max(0.8 * min([low, *heights, *lowest]), 0.1 * min([low, *heights]))
    axes.set_ylim(bottom, 3.0 * max([high, *heights]))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    keys = [axis["name"] for axis, _ in swept(results)]
    if keys and len(cells) <= MOST_NAMED_CELLS:
        names = ["\n".join(shown(cell["values"][key]) for key in keys) for cell in cells]
        _name_places(axes, names)
        axes.set_xlabel("\n".join(map(with_unit, keys)))
    elif len(cells) == 1:
        places = [_offset(number, len(variants)) for number in range(len(variants))]
        axes.set_xticks(places, [name.replace("-", "-\n") for name in variants])
    else:
        axes.set_xlabel("cell")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("NEES of the pose at the end [-]")
    _name_variants(axes)


def _distribution(results: Results, others: str) -> Picture:
    """Draw the cumulative distribution of final errors, in a panel for each group."""
    kept = [one for one in results["final_errors"] if one["percentiles"]]
    rows = max(1, (len(kept) + 1) // 2)
    columns = min(2, max(1, len(kept)))
    share = np.array(PERCENTILES) / 100.0
    size = (SIZE[0], SIZE[1] * (0.35 + 0.65 * rows))
    with drawing(size, STYLE) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharey=True, sharex=True)
        panels = list(grid.flat)
        for axes, one in zip(panels, kept, strict=False):
            for label in results["variants"]:
                if label in one["percentiles"]:
                    found = floats(one["percentiles"][label])
                    axes.plot(found, share, color=_colours(results)[label], lw=1.5, label=label)
            axes.set_title(f"{one['axis']} {one['group']}".strip(), fontsize=11)
        every = [value for one in kept for found in one["percentiles"].values() for value in found]
        positive = [value for value in every if value > 0.0]
        if positive and max(positive) > LOG_SPAN * np.median(positive):
            panels[0].set_xscale("log")
        for axes in panels[len(kept) :]:
            axes.set_visible(False)
        for axes in panels[max(0, len(kept) - columns) : len(kept) or 1]:
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("position error at the end [m]")
        for axes in grid[:, 0]:
            axes.set_ylabel("share of runs")
        if kept:
            panels[0].legend(fontsize=10, loc="lower right")
        caption = (
            "Distribution of the position error at the end of the run: share of runs up to it"
            f"{others}."
        )
        return Picture("final-error-distribution", caption, png(figure, METADATA))


def _limit(axes: Axes, means: Any, highs: Any) -> None:
    """Limit the axis to all means, and to intervals that do not dwarf them."""
    means, highs = means[np.isfinite(means)], highs[np.isfinite(highs)]
    if not len(means):
        return
    low, high = float(means.min()), float(means.max())
    if low > 0.0 and high > LOG_SPAN * low:
        axes.set_yscale("log")
        axes.set_ylim(0.5 * low, 2.0 * high)
        return
    axes.set_ylim(0.0, 1.08 * min(float(highs.max()), 2.5 * high) or 1.0)


def _name_places(axes: Axes, names: list[str]) -> None:
    longest = max(len(line) for name in names for line in name.split("\n"))
    upright = len(names) <= MOST_UPRIGHT or longest * len(names) <= MOST_LETTERS
    axes.set_xticks(np.arange(len(names)), names, rotation=0 if upright else 60)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.grid(visible=False, axis="x")


def _whiskers(mean: Any, low: Any, high: Any) -> Any:
    """Lengths (2, n) of intervals below and above; zero if there is no interval."""
    return np.nan_to_num(np.maximum(np.stack([mean - low, high - mean]), 0.0))


def _offset(number: int, count: int) -> float:
    """Offset of one of several variants from its place."""
    return SPREAD * ((number + 0.5) / count - 0.5)


def _known(results: Results, statistic: str) -> bool:
    return any(one[statistic]["n"] for one in results["overall"].values())


def _colours(results: Results) -> dict[str, str]:
    """Label -> colour."""
    variants = results["variants"]
    left = [colour for colour in OTHER_COLOURS if colour not in map(COLOURS.get, variants)]
    spare = cycle(left)
    return {label: COLOURS.get(label) or next(spare) for label in variants}


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _file_name(axis: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "-", axis).strip("-").lower()
