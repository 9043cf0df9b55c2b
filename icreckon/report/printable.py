"""Text that may be shown anywhere, whatever names in a log hold."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f]")


def printable(text: str) -> str:
    """Replace control characters, except for line breaks."""
    return CONTROL.sub("\ufffd", text)


@contextmanager
def any_letters() -> Iterator[None]:
    """Draw letters that matplotlib's font lacks as boxes, without a warning.

    Pages show them as they are; a font that has them can be set in matplotlib's own configuration.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield
