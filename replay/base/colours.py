"""Colours of the variants, shared by figures, pages and Foxglove."""

from __future__ import annotations

from icreckon.estimator.streaming.smoother import SMOOTHED

# Okabe-Ito palette, distinguishable with any colour vision; the last is a dark shade of the one before.
COLOURS = {
    "gyro": "#444444",
    "differential": "#999999",
    "constant-fixed": "#E69F00",
    "constant-online": "#D55E00",
    "full-linear": "#B8A800",
    "inertia-fixed": "#56B4E9",
    "inertia-online": "#0072B2",
    "friction-fixed": "#CC79A7",
    "friction-online": "#882255",
}
TRUTH_COLOUR = "#000000"
OTHER_COLOUR = "#009E73"


def colour_of(name: str) -> str:
    """Colour of a variant, smoothed or not, as "#rrggbb"."""
    return COLOURS.get(name.removesuffix(SMOOTHED), OTHER_COLOUR)
