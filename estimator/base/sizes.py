"""Message of compiled code for an array of the wrong size.

Compiled code reads and writes by index without bounds checks, so each entry compares sizes first.
"""

from __future__ import annotations

from typing import Final

# A constant, since compiled code cannot format text.
WRONG_SIZE: Final = (
    "compiled code was given an array of the wrong size and has not touched it; this is a defect of "
    "icreckon, please report it with the whole traceback"
)
