"""Tables of pages, for the terminal."""

import re
from string import ascii_lowercase
from typing import Any

from rich.table import Table as RichTable

from icreckon.report.pages import Table

# What follows the first words of a cell, which a narrow table has below it.
_MORE = re.compile(r"[,;:] ")


def rich_table(page_table: Table, *, narrow: bool = False) -> RichTable:
    """Convert a table of a page; columns of text are left-aligned and wrap.

    A narrow table breaks long names and keeps the first words of long texts only, with a letter that
    refers to the remainder below the table.
    """
    table = RichTable(title=page_table.title, title_justify="left", caption_justify="left")
    table.add_column(page_table.head[0], no_wrap=not narrow, overflow="fold")
    cells = page_table.rows[0][1] if page_table.rows else ()
    for place, heading in enumerate(page_table.head[1:]):
        is_text = place < len(cells) and cells[place].kind == "wrap"
        justify: Any = "left" if is_text else "right"
        table.add_column(heading, justify=justify, no_wrap=narrow, overflow="fold")
    letters: dict[str, str] = {}
    for name, row in page_table.rows:
        shortened = (
            _with_letter(cell.text, letters) if narrow and cell.kind == "wrap" else cell.text
            for cell in row
        )
        table.add_row(name, *shortened)
    table.caption = "\n".join(f"{letter}: {more}" for more, letter in letters.items())
    return table


def _with_letter(text: str, letters: dict[str, str]) -> str:
    """Replace all but the first words by a letter; the whole text if letters run out."""
    first, *more = _MORE.split(text, maxsplit=1)
    if not more:
        return text
    if more[0] not in letters:
        if len(letters) == len(ascii_lowercase):
            return text
        letters[more[0]] = ascii_lowercase[len(letters)]
    return f"{first} {letters[more[0]]}"
