"""Pages from templates: Jinja escapes all text that they are given.

Figures need matplotlib; results, tables and pages do without it.
"""

import base64
import json
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from icreckon.report.terms import TERMS, term_of

# Forbid all requests, whatever the names and notes of a log contain.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"

_TEMPLATES = PackageLoader("icreckon.report")
_PAGES = Environment(
    loader=_TEMPLATES,
    autoescape=True,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
    undefined=StrictUndefined,
)


class Cell(NamedTuple):
    """Cell of a table: its text, its class, and smaller text beneath."""

    text: str
    kind: str = ""
    beneath: str = ""


class Table(NamedTuple):
    """Table with its title; each row has a name, which stands in the first column."""

    title: str
    head: Sequence[str]
    rows: Sequence[tuple[str, Sequence[Cell]]]


class Picture(NamedTuple):
    """Picture of a page: file name without suffix, caption, PNG, wide or not."""

    name: str
    caption: str
    png: bytes
    wide: bool = False


def _embedded(data: Any) -> Markup:
    """JSON that cannot close its enclosing element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    text = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return Markup(text)  # noqa: S704 - without characters that HTML knows


def _breakable(name: str) -> Markup:
    """Name that may break after its dots and underscores."""
    return Markup(re.sub(r"([._])(?=\w)", r"\1<wbr>", str(escape(name))))  # noqa: S704 - escaped


_PAGES.globals |= {"policy": POLICY, "terms": TERMS}
# Content of a style sheet or script next to the templates, which are our own files.
_PAGES.globals["verbatim"] = lambda name: Markup(_TEMPLATES.get_source(_PAGES, name)[0])  # noqa: S704
# Defaults for templates: a name that is not set is an error (StrictUndefined).
_PAGES.globals |= {"subtitle": "", "failures": (), "remarks": ()}
_PAGES.filters |= {"term_of": term_of, "breakable": _breakable, "embedded": _embedded}
_PAGES.filters["as_text"] = lambda data: json.dumps(data, indent=1, ensure_ascii=False)
_PAGES.filters["base64"] = lambda data: base64.b64encode(data).decode()


def render(template: str, **content: Any) -> str:
    """Render a template of `icreckon/report/templates`."""
    return _PAGES.get_template(template).render(content)


@contextmanager
def unless_missing() -> Iterator[None]:
    """Run code that draws; warn in one line if matplotlib cannot be imported."""
    try:
        yield
    except ImportError as problem:
        if not (problem.name or "").startswith(("matplotlib", "kiwisolver", "contourpy", "PIL")):
            raise
        warnings.warn(
            f"no figures: matplotlib cannot be imported ({problem}); all else is written. "
            "`pip install matplotlib` brings them",
            stacklevel=1,
        )
