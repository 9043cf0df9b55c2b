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
# On a dark background, those that lightening would make like another one.
DARK = {"#444444": "#f0f0f0", "#0072B2": "#8c9eff"}
# Least luminance of a line on a dark background, and share of white that is added until it is reached.
LEAST_LUMINANCE, STEP = 0.2, 0.1


def colour_of(name: str) -> str:
    """Colour of a variant, smoothed or not, as "#rrggbb"."""
    return COLOURS.get(name.removesuffix(SMOOTHED), OTHER_COLOUR)


def on_dark(colour: str) -> str:
    """Lighten a colour "#rrggbb" until it is seen on a dark background."""
    if colour in DARK:
        return DARK[colour]
    rgb = [int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5)]
    while _luminance(rgb) < LEAST_LUMINANCE:
        rgb = [share + STEP * (1.0 - share) for share in rgb]
    return "#" + "".join(f"{round(255.0 * share):02x}" for share in rgb)


def _luminance(rgb: list[float]) -> float:
    """Relative luminance of an sRGB colour, by WCAG."""
    red, green, blue = (x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in rgb)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue
