"""Figure of a calibration, and its parts for the page, made from its results only."""

from collections.abc import Callable
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from icreckon.replay.comparison.results import Results
from icreckon.report.drawing import SIZE, drawing, png
from icreckon.report.pages import Picture
from icreckon.report.printable import printable

BEFORE, AFTER = "#999999", "#0072B2"
ROWS = ("along [cm]", "across [cm]", "turning [deg]")
UNITS = (100.0, 100.0, 180.0 / np.pi)
LINE = 110
STYLE = {"font.size": 10, "text.parse_math": False}
# Ticks of an axis in standard errors.
TICKS = [2.0, 4.0, 10.0, 30.0, 100.0, 300.0, 1000.0]


def write_calibration_figure(path: Path, results: Results) -> None:
    """Draw segment errors before and after, certainties and held-out scores as PNG."""
    with drawing((15, 9), STYLE) as figure:
        grid = figure.add_gridspec(3, 2, width_ratios=(1.4, 1.0))
        left = [figure.add_subplot(grid[0, 0])]
        left += [figure.add_subplot(grid[row, 0], sharex=left[0]) for row in (1, 2)]
        _draw_errors(left, results)
        _draw_scores(figure.add_subplot(grid[0, 1]), results)
        _draw_errors_by_turning(figure.add_subplot(grid[1, 1]), results)
        _draw_certainty(figure.add_subplot(grid[2, 1]), results)
        verdict = fill(results["verdict"], LINE, break_long_words=False, break_on_hyphens=False)
        figure.suptitle(printable(verdict), fontsize=11)
        figure.savefig(path, dpi=110)


def calibration_pictures(results: Results) -> list[Picture]:
    """Draw the parts of the figure one by one, the models first."""
    errors = (
        "Each dot is a segment of the logs: where it ends by the truth less where it ends by the tracks, "
        "ahead (along) and to the left (across), and its turning by the gyro less that by the tracks. "
        "Grey: by the robot file as it was; blue: calibrated; RMS: root mean square."
    )
    turning = (
        "Turning of each segment by the gyro less that by the tracks, over how far it turned. A slope is "
        "a wrong effective track, an offset a bias, a curve what the model lacks. Grey: by the robot "
        "file as it was; blue: calibrated."
    )
    parts: list[tuple[str, str, tuple[float, float], Callable[[Figure], None]]] = [
        (
            "models",
            "Position error by the tracks alone, in % of the way, on parts of the logs that were left "
            "out of the fit, with 95 % intervals. Blue: the model that the logs support.",
            SIZE,
            lambda figure: _draw_scores(figure.add_subplot(), results),
        ),
        (
            "errors",
            errors,
            (SIZE[0], 1.6 * SIZE[1]),
            lambda figure: _draw_errors(list(figure.subplots(3, 1, sharex=True)), results),
        ),
        (
            "turning",
            turning,
            SIZE,
            lambda figure: _draw_errors_by_turning(figure.add_subplot(), results),
        ),
        (
            "certainty",
            "Each dot is a parameter: the value found less that of the robot file, over its standard "
            "error. Grey, up to 1.96: chance explains it. Beyond 4 the axis is logarithmic.",
            (SIZE[0], 1.3 * SIZE[1]),
            lambda figure: _draw_certainty(figure.add_subplot(), results),
        ),
    ]
    pictures = []
    for name, caption, size, draw in parts:
        with drawing(size, STYLE) as figure:
            draw(figure)
            pictures.append(Picture(name, caption, png(figure)))
    return pictures


def _draw_errors(axes: list[Axes], results: Results) -> None:
    series = results["series"]
    seconds = np.array(series["t_s"])
    for row, (one, name, unit) in enumerate(zip(axes, ROWS, UNITS, strict=True)):
        for key, colour, label in (
            ("before", BEFORE, "as the robot file was"),
            ("after", AFTER, f"calibrated, {results['supported_model']}"),
        ):
            values = unit * np.array(series[key])[:, row]
            size = np.sqrt(np.mean(values**2))
            one.plot(seconds, values, ".", ms=4, color=colour, label=f"{label}, RMS {size:.2g}")
        one.set_ylabel(name)
        # Above the axes: there are dots everywhere in them.
        one.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=8, frameon=False)
    # Above the legend.
    axes[0].set_title("error of each segment by the tracks", fontsize=10, loc="left", pad=20)
    for one in axes[:-1]:
        one.tick_params(labelbottom=False)
    axes[-1].set_xlabel("time, one log behind the other [s]")


def _draw_errors_by_turning(axes: Axes, results: Results) -> None:
    series = results["series"]
    turned = np.degrees(series["turned_rad"])
    for key, colour in (("before", BEFORE), ("after", AFTER)):
        axes.plot(turned, UNITS[2] * np.array(series[key])[:, 2], ".", ms=4, color=colour)
    axes.set_xlabel("turned in a segment, by the gyro [deg]")
    axes.set_ylabel("by gyro minus by tracks [deg]")
    axes.set_title("slope: effective track; offset: bias; curve: what the model lacks", fontsize=10)


def _draw_scores(axes: Axes, results: Results) -> None:
    names = list(results["models"])
    scores = [results["models"][name]["held_out_drift_percent"] for name in names]
    ends = np.array(
        [results["models"][name]["held_out_drift_percent_interval_95"] for name in names]
    ).T
    spans = np.abs(ends - np.array(scores))
    places = np.arange(len(names))
    axes.barh(
        places,
        scores,
        xerr=spans,
        color=[AFTER if name == results["supported_model"] else BEFORE for name in names],
        capsize=3,
    )
    axes.set_yticks(places, names)
    axes.invert_yaxis()
    axes.set_xlabel("error by the tracks alone [% of distance], with 95 % interval")
    axes.set_title("on parts of the logs that were left out of the fit", fontsize=10)


def _draw_certainty(axes: Axes, results: Results) -> None:
    """Draw the change of each estimate from the file's value, in standard errors."""
    moved = {
        name: (one["value"] - one["before"]) / one["sigma"]
        for name, one in results["parameters"].items()
        if one["sigma"] and one["before"] is not None
    }
    places = np.arange(len(moved))
    axes.axvspan(-1.96, 1.96, color=BEFORE, alpha=0.25)
    axes.plot(list(moved.values()), places, "o", ms=4, color=AFTER)
    axes.set_yticks(places, list(moved), fontsize=7)
    axes.invert_yaxis()
    axes.set_xscale("symlog", linthresh=4.0)
    largest = max(map(abs, moved.values()), default=0.0)
    ticks = [tick for tick in TICKS if tick <= max(1.5 * largest, TICKS[1])]
    ticks = [-tick for tick in reversed(ticks)] + [0.0] + ticks
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_xlim(-1.5 * max(largest, TICKS[1]), 1.5 * max(largest, TICKS[1]))
    axes.set_xlabel("found minus robot file, in standard errors (logarithmic beyond 4)")
    axes.set_title("grey: chance explains it", fontsize=10)
