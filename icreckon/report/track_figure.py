"""Figure of the effective track over the yaw rate, for `icreckon inspect`."""

from pathlib import Path
from typing import Any

from icreckon.replay.estimates.track_by_rate import TrackByRate
from icreckon.report.drawing import drawing
from icreckon.report.printable import printable

SIZE, DOTS = (7.0, 4.6), 140
# Sign of the yaw rate, name, colour and marker.
SIDES = ((1.0, "left", "#0072B2", "o"), (-1.0, "right", "#D55E00", "s"))


def write_track_figure(path: Path, title: str, track: TrackByRate) -> None:
    """Draw the effective track of turns to either side, as PNG."""
    with drawing(SIZE, {"font.size": 11, "text.parse_math": False}) as figure:
        axes = figure.add_subplot()
        for sign, side, colour, marker in SIDES:
            bins = [rate_bin for rate_bin in track.bins if rate_bin.rate * sign > 0.0]
            if not bins:
                continue
            rates = [abs(rate_bin.rate) for rate_bin in bins]
            tracks = [rate_bin.track for rate_bin in bins]
            errors = [2.0 * rate_bin.sigma for rate_bin in bins]
            style: Any = {"color": colour, "marker": marker, "capsize": 3}
            axes.errorbar(rates, tracks, errors, label=f"turns to the {side}", **style)
        # Units other than metres are long and have a line of their own.
        unit = f"[{track.unit}]" if track.unit == "m" else f"\n[{track.unit}]"
        axes.axhline(
            track.whole, color="0.4", ls="--", label=f"all turns, steady or not: {track.whole:.3g}"
        )
        axes.set(xlabel="yaw rate by the gyro [rad/s]", ylabel=f"effective track {unit}")
        axes.set_xlim(0.0, 1.1 * max(abs(rate_bin.rate) for rate_bin in track.bins))
        axes.set_title(printable(f"{title}: effective track, ± 2σ"), fontsize=11)
        axes.legend(fontsize=10)
        figure.savefig(path, dpi=DOTS, format="png")
