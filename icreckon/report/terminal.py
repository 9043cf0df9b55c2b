"""Tables of pages, for the terminal."""

from __future__ import annotations

from rich.table import Table as RichTable

from icreckon.report.pages import Table


def rich_table(of: Table) -> RichTable:
    """Convert a table of a page; columns of text are left-aligned and wrap."""
    table = RichTable(title=of.title, title_justify="left")
    table.add_column(of.head[0], no_wrap=True)
    cells = of.rows[0][1] if of.rows else ()
    for place, heading in enumerate(of.head[1:]):
        words = place < len(cells) and cells[place].kind == "wrap"
        table.add_column(heading, justify="left" if words else "right")
    for name, row in of.rows:
        table.add_row(name, *(cell.text for cell in row))
    return table
