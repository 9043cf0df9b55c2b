"""Digests of the sources that a figure depends on, as short hexadecimal words."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FILTER = ("estimator", "simulation")
"""Packages that every simulated figure depends on."""
KINDS = (".py", ".toml")
LENGTH = 8


def sources(names: Iterable[str]) -> list[Path]:
    """Source files of folders and files, named from the root of the repository."""
    found: set[Path] = set()
    for name in names:
        path = ROOT / name
        if path.is_dir():
            found |= {one for one in path.rglob("*") if one.suffix in KINDS}
        elif path.is_file():
            found.add(path)
    return sorted(found)


@cache
def digest(*names: str) -> str:
    """Digest of all sources of some folders and files, named from the root of the repository."""
    hashed = hashlib.sha256()
    for path in sources(names):
        hashed.update(f"{path.relative_to(ROOT)}\0".encode())
        hashed.update(path.read_bytes())
    return hashed.hexdigest()[:LENGTH]
