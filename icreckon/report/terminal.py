"""Tables of pages, for the terminal."""

import re
from itertools import zip_longest
from string import ascii_lowercase
from typing import Any

from rich.table import Table as RichTable

from icreckon.report.pages import Table

# Separator between the first words of a cell, which a narrow table keeps, and the rest.
_SEPARATOR = re.compile(r"[,;:] ")


def rich_table(page_table: Table, *, narrow: bool = False) -> RichTable:
    """Convert a table of a page; columns of text are left-aligned and wrap.

    A narrow table breaks long names and keeps the first words of long texts only, with a letter that
    refers to the remainder below the table.
    """
    table = RichTable(title=page_table.title, title_justify="left", caption_justify="left")
    name_heading, *headings = page_table.head
    table.add_column(name_heading, no_wrap=not narrow, overflow="fold")
    # All cells of a column are of one kind: the first row shows it.
    kinds = [cell.kind for _, cells in page_table.rows[:1] for cell in cells]
    for heading, kind in zip_longest(headings, kinds[: len(headings)]):
        justify: Any = "left" if kind == "wrap" else "right"
        table.add_column(heading, justify=justify, no_wrap=narrow, overflow="fold")
    letters: dict[str, str] = {}
    for name, cells in page_table.rows:
        texts = (
            _with_letter(cell.text, letters) if narrow and cell.kind == "wrap" else cell.text
            for cell in cells
        )
        table.add_row(name, *texts)
    table.caption = "\n".join(f"{letter}: {rest}" for rest, letter in letters.items())
    return table


def _with_letter(text: str, letters: dict[str, str]) -> str:
    """Replace all but the first words by a letter of `letters`, while there are any."""
    first_words, *rests = _SEPARATOR.split(text, maxsplit=1)
    if not rests:
        return text
    (rest,) = rests
    if rest not in letters:
        if len(letters) == len(ascii_lowercase):
            return text
        letters[rest] = ascii_lowercase[len(letters)]
    return f"{first_words} {letters[rest]}"
