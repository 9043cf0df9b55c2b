"""Text that may be shown anywhere, whatever names in a log hold."""

from __future__ import annotations

import re

CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f]")


def printable(text: str) -> str:
    """Replace control characters, except for line breaks."""
    return CONTROL.sub("\ufffd", text)
