"""Colours of the variants, shared by figures, pages and Foxglove."""

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
}
# The palette's green, which no variant has.
TRUTH_COLOUR = "#009E73"
FIX_COLOUR = "#000000"
OTHER_COLOUR = "#6A3D9A"
# Those that would not be seen on a dark background, and what stands for them there.
DARK = {"#000000": "#858585", "#444444": "#f0f0f0", "#0072B2": "#8c9eff", "#6A3D9A": "#9272b5"}


def colour_of(name: str) -> str:
    """Colour of a variant, smoothed or not, as "#rrggbb"."""
    return COLOURS.get(name.removesuffix(SMOOTHED), OTHER_COLOUR)


def on_dark(colour: str) -> str:
    """Colour on a dark background of one of this file's colours."""
    return DARK.get(colour, colour)
