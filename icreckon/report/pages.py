"""Pages from templates: Jinja escapes all text that they are given."""

from __future__ import annotations

import base64
import json
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

_TEMPLATES = PackageLoader("icreckon.report")
_PAGES = Environment(
    loader=_TEMPLATES,
    autoescape=True,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
    undefined=StrictUndefined,
)


def _verbatim(name: str) -> Markup:
    """Content of a style sheet or script beside the templates."""
    return Markup(_TEMPLATES.get_source(_PAGES, name)[0])  # noqa: S704 - our own file


def _embedded(data: Any) -> Markup:
    """JSON that cannot close its enclosing element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    text = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return Markup(text)  # noqa: S704 - without characters that HTML knows


_PAGES.globals["verbatim"] = _verbatim
_PAGES.filters["embedded"] = _embedded
_PAGES.filters["as_text"] = lambda data: json.dumps(data, indent=1, ensure_ascii=False)
_PAGES.filters["base64"] = lambda data: base64.b64encode(data).decode()


def render(template: str, **content: Any) -> str:
    """Render a template of `icreckon/report/templates`."""
    return _PAGES.get_template(template).render(content)
