"""Tables of pages, for the terminal."""

import re
from string import ascii_lowercase

from rich.table import Table as RichTable

from icreckon.report.pages import Table

# What follows the first words of a cell, which a narrow table has below it.
_MORE = re.compile(r"[,;:] ")


def rich_table(of: Table, *, narrow: bool = False) -> RichTable:
    """Convert a table of a page; columns of text are left-aligned and wrap.

    Args:
        of: the table.
        narrow: whether to keep the first words of long texts only, with a letter that says the rest
            below the table, and to break long names.
    """
    table = RichTable(title=of.title, title_justify="left", caption_justify="left")
    table.add_column(of.head[0], no_wrap=not narrow, overflow="fold")
    cells = of.rows[0][1] if of.rows else ()
    for place, heading in enumerate(of.head[1:]):
        words = place < len(cells) and cells[place].kind == "wrap"
        table.add_column(
            heading, justify="left" if words else "right", no_wrap=narrow, overflow="fold"
        )
    letters: dict[str, str] = {}
    for name, row in of.rows:
        shortened = (
            _with_letter(cell.text, letters) if narrow and cell.kind == "wrap" else cell.text
            for cell in row
        )
        table.add_row(name, *shortened)
    table.caption = "\n".join(f"{letter}: {more}" for more, letter in letters.items())
    return table


def _with_letter(text: str, letters: dict[str, str]) -> str:
    """Keep the first words of a text, and a letter for the rest of it."""
    first, *more = _MORE.split(text, maxsplit=1)
    if not more:
        return text
    if more[0] not in letters:
        if len(letters) == len(ascii_lowercase):
            return text
        letters[more[0]] = ascii_lowercase[len(letters)]
    return f"{first} {letters[more[0]]}"
