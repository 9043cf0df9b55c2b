"""All figures of two results.json files side by side: which differ, and by how much."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

# What two runs of one command may differ in: where, when and by what they were made.
NO_FIGURES = {"versions", "engine", "inputs", "configuration", "command", "seconds", "created"}


def run_command(arguments: Sequence[str], *, cwd: Path | None = None, **environment: str) -> None:
    """Run `icreckon` in a process of its own; exit with its output if it fails."""
    done = subprocess.run(
        [Path(sys.executable).parent / "icreckon", *arguments],
        env={**os.environ, **environment},
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        sys.exit(f"{' '.join(arguments)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")


class Difference(NamedTuple):
    """A figure that is not the same in both.

    Attributes:
        path: keys on the way to it.
        one: of the first file.
        other: of the second.
        relative: difference over the larger of the two; infinite where they cannot be compared.
    """

    path: str
    one: Any
    other: Any
    relative: float


def differences(one: Any, other: Any, path: str = "") -> Iterator[Difference]:
    """Walk through two values that were read from JSON, and yield what differs."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted({*one, *other}):
            if path or key not in NO_FIGURES:
                yield from differences(one.get(key), other.get(key), f"{path}/{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for place, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from differences(a, b, f"{path}[{place}]")
    elif one != other:
        yield Difference(path, one, other, _relative(one, other))


def _relative(one: Any, other: Any) -> float:
    numbers = [value for value in (one, other) if type(value) in (int, float)]
    if len(numbers) < 2 or not all(map(math.isfinite, numbers)):
        return math.inf
    return abs(one - other) / max(abs(one), abs(other))


def figures(folder: Path) -> Any:
    """What the results.json of a folder holds."""
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def count(value: Any) -> int:
    """Number of numbers in a value that was read from JSON."""
    if isinstance(value, dict):
        return sum(map(count, value.values()))
    if isinstance(value, list):
        return sum(map(count, value))
    return int(type(value) in (int, float))
