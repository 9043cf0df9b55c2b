"""Figure of a calibration, and its parts for the page, made from its results only."""

from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from icreckon.replay.comparison.results import Results
from icreckon.report.drawing import SIZE, drawing, png
from icreckon.report.pages import Picture
from icreckon.report.printable import printable

BEFORE, AFTER = "#999999", "#0072B2"
# Components of a segment's error, and factors from m, m and rad to their units.
ERROR_LABELS = ("along [cm]", "across [cm]", "turning [deg]")
ERROR_FACTORS = (100.0, 100.0, 180.0 / np.pi)
LINE_LENGTH = 110  # length of a line of the verdict [characters]
STYLE = {"font.size": 10, "axes.titlesize": 10, "text.parse_math": False}
TICKS = [2.0, 4.0, 10.0, 30.0, 100.0, 300.0, 1000.0]  # ticks of an axis in standard errors
LINEAR_UP_TO = 4.0  # standard errors beyond which that axis is logarithmic
BY_CHANCE = 1.96  # standard errors within which 95 % of the changes lie by chance


def write_calibration_figure(path: Path, results: Results) -> None:
    """Draw segment errors before and after, certainties and held-out scores as PNG."""
    with drawing((15, 9), STYLE) as figure:
        grid = figure.add_gridspec(3, 2, width_ratios=(1.4, 1.0))
        error_axes = [figure.add_subplot(grid[0, 0])]
        error_axes += [figure.add_subplot(grid[row, 0], sharex=error_axes[0]) for row in (1, 2)]
        _draw_errors(error_axes, results)
        _draw_scores(figure.add_subplot(grid[0, 1]), results)
        _draw_errors_by_turning(figure.add_subplot(grid[1, 1]), results)
        _draw_certainty(figure.add_subplot(grid[2, 1]), results)
        verdict = fill(
            results["verdict"], LINE_LENGTH, break_long_words=False, break_on_hyphens=False
        )
        figure.suptitle(printable(verdict), fontsize=11)
        figure.savefig(path, dpi=110)


def calibration_pictures(results: Results) -> list[Picture]:
    """Draw the parts of the figure one by one, the models first."""
    models = (
        "Position error by the tracks alone, in % of the way, on parts of the logs that were left "
        "out of the fit, with 95 % intervals. Blue: the model that the logs support."
    )
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
    certainty = (
        "Each dot is a parameter: the value found less that of the robot file, over its standard "
        "error. Grey, up to 1.96: chance explains it. Beyond 4 the axis is logarithmic."
    )
    pictures = []
    # Each with its number of axes and its height over the usual one.
    for name, caption, count, height, draw in (
        ("models", models, 1, 1.0, _draw_scores),
        ("errors", errors, 3, 1.6, _draw_errors),
        ("turning", turning, 1, 1.0, _draw_errors_by_turning),
        ("certainty", certainty, 1, 1.3, _draw_certainty),
    ):
        with drawing((SIZE[0], height * SIZE[1]), STYLE) as figure:
            axes = figure.subplots(count, 1, sharex=True)
            draw(axes, results)
            pictures.append(Picture(name, caption, png(figure)))
    return pictures


def _draw_errors(component_axes: Any, results: Results) -> None:
    """Draw along, across and turning errors of the segments over time, one axes each."""
    series = results["series"]
    seconds = np.array(series["t_s"])
    calibrated = f"calibrated, {results['supported_model']}"
    stages = (("before", BEFORE, "as the robot file was"), ("after", AFTER, calibrated))
    for component, axes in enumerate(component_axes):
        for key, colour, label in stages:
            errors = ERROR_FACTORS[component] * np.array(series[key])[:, component]
            rms = np.sqrt(np.mean(errors**2))
            axes.plot(seconds, errors, ".", ms=4, color=colour, label=f"{label}, RMS {rms:.2g}")
        axes.set_ylabel(ERROR_LABELS[component])
        # Above the axes: there are dots everywhere in them.
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, fontsize=8, frameon=False)
    # Above the legend.
    component_axes[0].set_title("error of each segment by the tracks", loc="left", pad=20)
    for axes in component_axes[:-1]:
        axes.tick_params(labelbottom=False)
    component_axes[-1].set_xlabel("time, one log behind the other [s]")


def _draw_errors_by_turning(axes: Axes, results: Results) -> None:
    """Draw the turning error of each segment over its turning by the gyro."""
    series = results["series"]
    turned = np.degrees(series["turned_rad"])
    for key, colour in (("before", BEFORE), ("after", AFTER)):
        turning_errors = np.degrees(np.array(series[key])[:, 2])
        axes.plot(turned, turning_errors, ".", ms=4, color=colour)
    axes.set_xlabel("turned in a segment, by the gyro [deg]")
    axes.set_ylabel("by gyro minus by tracks [deg]")
    axes.set_title("slope: effective track; offset: bias; curve: what the model lacks")


def _draw_scores(axes: Axes, results: Results) -> None:
    """Draw the held-out drift of each model, with its 95 % interval."""
    models = results["models"]
    drifts = [scores["held_out_drift_percent"] for scores in models.values()]
    intervals = [scores["held_out_drift_percent_interval_95"] for scores in models.values()]
    # (2, models): lengths of the whiskers to either side.
    whiskers = np.abs(np.array(intervals).T - np.array(drifts))
    places = np.arange(len(models))
    colours = [AFTER if name == results["supported_model"] else BEFORE for name in models]
    axes.barh(places, drifts, xerr=whiskers, color=colours, capsize=3)
    axes.set_yticks(places, list(models))
    axes.invert_yaxis()
    axes.set_xlabel("error by the tracks alone [% of distance], with 95 % interval")
    axes.set_title("on parts of the logs that were left out of the fit")


def _draw_certainty(axes: Axes, results: Results) -> None:
    """Draw the change of each estimate from the file's value, in standard errors."""
    changes = {
        name: (parameter["value"] - parameter["before"]) / parameter["sigma"]
        for name, parameter in results["parameters"].items()
        if parameter["sigma"] and parameter["before"] is not None
    }
    places = np.arange(len(changes))
    axes.axvspan(-BY_CHANCE, BY_CHANCE, color=BEFORE, alpha=0.25)
    axes.plot(list(changes.values()), places, "o", ms=4, color=AFTER)
    axes.set_yticks(places, list(changes), fontsize=7)
    axes.invert_yaxis()
    axes.set_xscale("symlog", linthresh=LINEAR_UP_TO)
    # Some of the logarithmic part is drawn, also if no parameter changed.
    reach = 1.5 * max([LINEAR_UP_TO, *map(abs, changes.values())])
    right_ticks = [tick for tick in TICKS if tick <= reach]
    ticks = [*(-tick for tick in reversed(right_ticks)), 0.0, *right_ticks]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("found minus robot file, in standard errors (logarithmic beyond 4)")
    axes.set_title("grey: chance explains it")
