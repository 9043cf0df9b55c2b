"""Figures 3, 5, 6, 7 and 8 of the paper, reproduced, and one of all differences."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from icreckon.estimator.motion import icr
from icreckon.estimator.robot.robot_file import ConstantIcr
from icreckon.report.drawing import drawing
from icreckon.simulation.paper.fits import motions_in_fits
from icreckon.simulation.paper.published import published_mean_icrs, published_parameters
from icreckon.simulation.paper.reproduction import Reproduction, Row

BLUE, RED, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#777777"
DPI = 110
AXIS_LABELS = ("sliding index ζ [m]", "eccentricity index ε [m]", "steering efficiency index η [-]")
FARTHEST = 60.0  # differences beyond this are drawn at the edge, with an arrow [%]


def write_figures(folder: Path, reproduced: Reproduction, overview: str) -> None:
    """Draw all figures as PNG: figure-3.png to figure-8.png, and the overview."""
    _draw_differences(folder / overview, reproduced.rows)
    _draw_icrs(folder / "figure-3.png", reproduced)
    _draw_inertia(folder / "figure-5.png", reproduced)
    _draw_indices(folder / "figure-6.png", reproduced)
    _draw_fits(folder / "figure-7.png", reproduced)
    _draw_modelled_icrs(folder / "figure-8.png", reproduced)


@contextmanager
def _figure(path: Path, width: float, height: float, title: str) -> Iterator[Figure]:
    """Figure of a size [in] with a title, written as PNG when the block ends."""
    with drawing((width, height), {"font.size": 10}) as figure:
        figure.suptitle(title, fontsize=12)
        yield figure
        figure.savefig(path, dpi=DPI)


def _draw_differences(path: Path, rows: tuple[Row, ...]) -> None:
    """Draw reproduced less published [% of the published], one number a line."""
    title = "Published numbers and ours: difference as a share of the published"
    with _figure(path, 9.0, 7.0, title) as figure:
        axes = figure.add_subplot()
        axes.axvspan(-20.0, 20.0, color=BLUE, alpha=0.08, label="within 20 %")
        axes.axvspan(-10.0, 10.0, color=BLUE, alpha=0.12, label="within 10 %")
        axes.axvline(0.0, color=GREY, linewidth=1.0)
        axes.plot([], [], "o", color=RED, label="further off")
        largest = max(abs(row.difference_percent) for row in rows)
        edge = min(FARTHEST, max(25.0, 1.3 * largest))
        for line, row in enumerate(rows):
            difference = row.difference_percent
            x = float(np.clip(difference, -edge, edge))
            marker = "o"
            if abs(difference) > edge:
                marker = ">" if difference > 0.0 else "<"
            axes.plot(x, line, marker, color=RED if abs(x) > 10.0 else BLUE)
            # Next to the right edge there is no room for a label on the right.
            offset, alignment = (8, "left") if x < 0.75 * edge else (-8, "right")
            style: Any = {"textcoords": "offset points", "va": "center", "fontsize": 8.5}
            label = f"{difference:+.1f} %"
            axes.annotate(label, (x, line), xytext=(offset, 0), ha=alignment, **style)
        labels = [f"{row.name} = {row.printed} {row.unit}".strip() for row in rows]
        axes.set_yticks(range(len(rows)), labels)
        axes.set(xlim=(-1.08 * edge, 1.08 * edge), ylim=(len(rows) - 0.4, -0.6))
        axes.set(xlabel="reproduced less published [% of the published]", ylabel="published number")
        axes.legend(loc="lower left")


def _draw_icrs(path: Path, reproduced: Reproduction) -> None:
    title = "Figure 3, redrawn: track ICRs of the stationary motions"
    with _figure(path, 9.0, 5.5, title) as figure:
        axes = figure.add_subplot()
        _scatter_icrs(axes, reproduced.mapped.icrs, reproduced)
        _mark_constant(axes, reproduced.icrs, RED, "*", "constant ICRs, ours")
        _mark_constant(axes, published_mean_icrs(), "black", "x", "constant ICRs, published")
        figure.legend(loc="outside lower center", ncols=3)


def _draw_modelled_icrs(path: Path, reproduced: Reproduction) -> None:
    """Draw the ICRs by (25) to (30), by our parameters (left) and the published ones."""
    title = (
        "Figure 8, redrawn: track ICRs by the inertia-based model, |F| of the stationary motions"
    )
    panels = (
        ("our parameters", reproduced.parameters, reproduced.icrs),
        ("the published parameters", published_parameters(), published_mean_icrs()),
    )
    with _figure(path, 14.0, 5.5, title) as figure:
        left = figure.add_subplot(1, 2, 1)
        right = figure.add_subplot(1, 2, 2, sharex=left, sharey=left)
        mapped = reproduced.mapped
        # NaN for straight motions.
        force = np.where(mapped.turning, mapped.magnitude, np.nan)
        for axes, (label, parameters, constant_icrs) in zip((left, right), panels, strict=True):
            x_1, x_2 = icr.symmetry_coordinates(mapped.motion.V_l, mapped.motion.V_r, parameters.H)
            modelled = icr.indices_at_inertia(force, x_1, x_2, parameters.as_array())
            icrs = icr.icrs_from_indices(modelled, mapped.vehicle.gauge)
            _scatter_icrs(axes, icrs, reproduced)
            _mark_constant(axes, constant_icrs, RED, "*", "constant ICRs")
            axes.set_title(label)
        figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=4)


def _draw_inertia(path: Path, reproduced: Reproduction) -> None:
    title = "Figure 5, redrawn: magnitude of the force of inertia"
    with _figure(path, 7.0, 5.8, title) as figure:
        axes = figure.add_subplot()
        _draw_map(axes, reproduced, reproduced.mapped.magnitude, "|F| [N]")
        ends = np.array([-1.0, 1.0])
        axes.plot(ends, ends, color=RED, label="$V_l = V_r$ (12)")
        for H, colour, line, name in (
            (reproduced.parameters.H, "white", "-", "ours"),
            (published_parameters().H, "black", ":", "published"),
        ):
            label = f"$V_l = -H V_r$ (13), H = {H:.4f}, {name}"
            axes.plot(ends, -H * ends, line, color=colour, linewidth=2.5, label=label)
        legend = axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=1)
        legend.get_frame().set_facecolor("#bbbbbb")


def _draw_indices(path: Path, reproduced: Reproduction) -> None:
    title = "Figure 6, redrawn: the indices over the track speeds"
    with _figure(path, 16.0, 4.8, title) as figure:
        for place, label in enumerate(AXIS_LABELS):
            axes = figure.add_subplot(1, 3, place + 1)
            _draw_map(axes, reproduced, reproduced.mapped.indices[place], label)
            axes.set_title(f"({'abc'[place]})")


def _draw_fits(path: Path, reproduced: Reproduction) -> None:
    """Draw each index and its polynomials, (25) to (27), over the force it depends on."""
    title = "Figure 7, redrawn: the indices and their polynomials over the signed force of inertia"
    mapped, ours, theirs = reproduced.mapped, reproduced.parameters, published_parameters()
    motion, turning = mapped.motion, mapped.turning
    x_1, x_2 = icr.symmetry_coordinates(motion.V_l[turning], motion.V_r[turning], ours.H)
    force = mapped.magnitude[turning]
    used = motions_in_fits(mapped)[turning]
    signs = (np.sign(x_2), np.sign(x_1) * np.sign(x_2), np.sign(x_1) * np.sign(x_2))
    force_labels = ("|F| sign(x₂) [N]", "|F| sign(x₁) sign(x₂) [N]", "|F| sign(x₁) sign(x₂) [N]")
    with _figure(path, 16.0, 5.0, title) as figure:
        for place, (values, sign) in enumerate(zip(mapped.indices, signs, strict=True)):
            axes = figure.add_subplot(1, 3, place + 1)
            for which, colour, name in ((used, BLUE, "fitted"), (~used, "#bbbbbb", "not fitted")):
                at, shown = (force * sign)[which], values[turning][which]
                axes.plot(at, shown, ".", color=colour, label=f"stationary motions, {name}")
            abscissa = np.linspace((force * sign).min(), (force * sign).max(), 200)
            for parameters, colour, style, name in (
                (ours, RED, "-", "our fit"),
                (theirs, "black", "--", "published fit"),
            ):
                # |F| and signs that give the abscissa: x_1 > 0 and x_2 with its sign.
                modelled = icr.indices_at_inertia(
                    np.abs(abscissa), np.ones_like(abscissa), abscissa, parameters.as_array()
                )
                axes.plot(abscissa, modelled[place], style, color=colour, lw=2.0, label=name)
            title = f"({'abc'[place]})"
            axes.set(title=title, xlabel=force_labels[place], ylabel=AXIS_LABELS[place])
            axes.legend(loc="upper left")


def _draw_map(axes: Axes, reproduced: Reproduction, values: Any, label: str) -> None:
    """Draw a quantity over V_r (to the right) and V_l (up); NaN stays white."""
    motion = reproduced.mapped.motion
    axes.grid(visible=False)
    mesh = axes.pcolormesh(motion.V_r, motion.V_l, values, shading="nearest", cmap="viridis")
    axes.figure.colorbar(mesh, ax=axes, label=label)
    axes.set_aspect("equal")
    axes.set(xlabel="right track speed $V_r$ [m/s]", ylabel="left track speed $V_l$ [m/s]")


def _scatter_icrs(axes: Axes, icrs: icr.Icrs, reproduced: Reproduction) -> None:
    """Draw ICRs of both tracks, the tracks' centrelines and the centre of mass."""
    axes.plot(icrs.x_ICRl, icrs.y_ICR, ".", color=BLUE, markersize=4)
    axes.plot(icrs.x_ICRr, icrs.y_ICR, ".", color=BLUE, markersize=4)
    # Larger dot in the legend, once for both tracks.
    axes.plot([], [], ".", color=BLUE, label="ICRs of the tracks")
    vehicle = reproduced.mapped.vehicle
    axes.axvline(-0.5 * vehicle.gauge, color=GREY, linewidth=1.0, label="track centrelines")
    axes.axvline(0.5 * vehicle.gauge, color=GREY, linewidth=1.0)
    x, y = vehicle.x_CM, vehicle.y_CM
    axes.plot(x, y, "+", color=GREEN, ms=11, mew=2.0, label="centre of mass")
    axes.set(xlabel="x, to the right [m]", ylabel="y, forward [m]")


def _mark_constant(axes: Axes, icrs: ConstantIcr, colour: str, marker: str, label: str) -> None:
    x, y = [icrs.x_ICRl, icrs.x_ICRr], [icrs.y_ICR, icrs.y_ICR]
    axes.plot(x, y, marker, color=colour, ms=11, label=label)
