"""Figures in one style, as files or as pictures of a page."""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

SIZE = (6.4, 4.2)  # size of a picture of a page [in], legible also on a telephone
DOTS_PER_INCH = 150


@contextmanager
def drawing(size: tuple[float, float], style: dict[str, Any]) -> Iterator[Figure]:
    """Figure of a size [in]; letters that the font lacks are boxes, without a warning.

    Pages contain these letters as they are; matplotlib's configuration can set a font that has them.
    """
    common: Any = {"axes.grid": True, "grid.alpha": 0.3}
    with mpl.rc_context(common | style), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield Figure(figsize=size, layout="constrained")


def png(figure: Figure, metadata: dict[str, Any] | None = None) -> bytes:
    """Encode a picture of a page."""
    sink = io.BytesIO()
    figure.savefig(sink, dpi=DOTS_PER_INCH, metadata=metadata)
    return sink.getvalue()
