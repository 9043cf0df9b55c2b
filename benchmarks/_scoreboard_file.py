"""File of the scoreboard's results: a row of figures for each cell and variant, under one head a part."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from _digests import digest
from _scoreboard_cells import depends_on

Cells = dict[str, dict[str, dict[str, Any]]]


def read_results(path: Path) -> dict[str, Any]:
    """Part -> `of`, the digest of its sources, and `cells`: cell -> variant -> figures."""
    found = {}
    for part, packed in json.loads(path.read_text(encoding="utf-8")).items():
        cells: Cells = {}
        for name, row in packed["rows"].items():
            cell, _, variant = name.rpartition(" | ")
            one: dict[str, Any] = {}
            for key, value in zip(packed["head"], row, strict=True):
                if value is not None:
                    outer, _, inner = key.rpartition(".")
                    (one.setdefault(outer, {}) if outer else one)[inner] = value
            cells.setdefault(cell, {})[variant] = one
        found[part] = {"of": packed["of"], "cells": cells}
    return found


def write_results(path: Path, results: dict[str, Cells]) -> None:
    """Write results; cells of the file that were not run are kept while their sources are the same."""
    whole = read_results(path) if path.is_file() else {}
    for part, cells in results.items():
        now, before = digest(*depends_on(part)), whole.get(part, {})
        kept = before.get("cells", {}) if before.get("of") == now else {}
        whole[part] = {"of": now, "cells": {**kept, **cells}}
    parts = [f"{json.dumps(part)}:{_packed(**one)}" for part, one in sorted(whole.items())]
    path.write_text("{" + ",\n".join(parts) + "}\n", encoding="utf-8")


def _packed(of: str, cells: Cells) -> str:
    rows = {
        f"{cell} | {variant}": _flat(one)
        for cell, by_variant in cells.items()
        for variant, one in by_variant.items()
    }
    head = sorted({key for one in rows.values() for key in one})
    lines = [
        f"{_json(name)}:{_json([one.get(key) for key in head])}"
        for name, one in sorted(rows.items())
    ]
    return f'{{"head":{_json(head)},"of":"{of}","rows":{{\n' + ",\n".join(lines) + "}}"


def _flat(one: dict[str, Any]) -> dict[str, Any]:
    """Figures of a variant, those of `end` and `later` under joined names."""
    found: dict[str, Any] = {}
    for key, value in one.items():
        if isinstance(value, dict) and key in ("end", "later"):
            found |= {f"{key}.{inner}": figure for inner, figure in value.items()}
        else:
            found[key] = value
    return found


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, sort_keys=True, separators=(",", ":"))
