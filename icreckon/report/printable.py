"""Text that may be shown anywhere, whatever names in a log hold."""

import re
from collections.abc import Sequence

CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f]")


def printable(text: str) -> str:
    """Replace control characters, except for line breaks."""
    return CONTROL.sub("\ufffd", text)


def change(ratio: float) -> str:
    """Format a ratio as a change: 0.13 as "87 % less"."""
    percent = 100.0 * abs(ratio - 1.0)
    size = f"{percent:.0f}" if percent >= 1.0 else f"{percent:.1f}"
    return f"{size} % {'less' if ratio < 1.0 else 'more'}"


def change_range(interval: Sequence[float] | None, remark: str = "") -> str:
    """Format the 95 % interval of a ratio as changes in brackets; nothing for none.

    Both ends less: " (95 %: 5 to 13 % less)"; otherwise " (95 %: 5 % less to 3 % more)".
    """
    if interval is None:
        return ""
    low, high = interval
    start, end = (change(high), change(low)) if high < 1.0 else (change(low), change(high))
    if high < 1.0 or low > 1.0:
        # Both ends have the same words, which are written once: without " % less" or " % more".
        start = start.rpartition(" ")[0].removesuffix(" %")
    return f" (95 %: {start} to {end}{remark})"
