"""Figure of the effective track over the yaw rate, for `icreckon inspect`."""

from pathlib import Path

from icreckon.replay.inspection.track_by_rate import TrackByRate
from icreckon.report.drawing import drawing
from icreckon.report.printable import printable

SIZE, DOTS = (7.0, 4.6), 140
SIDES = ((1.0, "left", "#0072B2", "o"), (-1.0, "right", "#D55E00", "s"))


def write_track_figure(path: Path, title: str, track: TrackByRate) -> None:
    """Draw the effective track of turns to either side, as PNG."""
    with drawing(SIZE, {"font.size": 11, "text.parse_math": False}) as figure:
        axes = figure.add_subplot()
        for side, name, colour, marker in SIDES:
            bins = [one for one in track.bins if one.rate * side > 0.0]
            if not bins:
                continue
            axes.errorbar(
                [abs(one.rate) for one in bins],
                [one.track for one in bins],
                [2.0 * one.sigma for one in bins],
                label=f"turns to the {name}",
                color=colour,
                marker=marker,
                capsize=3,
            )
        unit = f"[{track.unit}]" if track.unit == "m" else f"\n[{track.unit}]"
        axes.axhline(track.whole, color="0.4", ls="--", label=f"whole log: {track.whole:.3g}")
        axes.set_xlabel("yaw rate by the gyro [rad/s]")
        axes.set_ylabel(f"effective track {unit}")
        axes.set_xlim(0.0, 1.1 * max(abs(one.rate) for one in track.bins))
        axes.set_title(printable(f"{title}: effective track, ± 2σ"), fontsize=11)
        axes.legend(fontsize=10)
        figure.savefig(path, dpi=DOTS, format="png")
