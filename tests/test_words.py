"""The words of the house: first lines of docstrings that a reader from the field need not translate."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("estimator", "simulation", "replay", "icreckon")
LONGEST = 80
# A first line begins with a verb or a noun of the field, not with these.
OPENINGS = re.compile(
    r"(What|How|Whether|Of|The same|Those|All that|Everything|Itself|See|Where|When|Which|Who|That)\b"
)
# Code and data do not speak, know, believe or ask.
PERSON_VERBS = re.compile(
    r"\b(told|tells?|says|said|knows?|believes?|believed|foretold|goes by|go by)\b"
)


def docstrings(source: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each docstring of a file."""
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        text = ast.get_docstring(node) if isinstance(node, kinds) else None
        if text is not None:
            yield getattr(node, "lineno", 1), text


def sources(package: str) -> list[Path]:
    found = sorted((ROOT / package).rglob("*.py"))
    return [path for path in found if not any(parent.is_symlink() for parent in path.parents)]


@pytest.mark.parametrize("package", PACKAGES)
def test_first_lines_are_plain(package: str) -> None:
    wrong = [
        f"{source.relative_to(ROOT)}:{line}: {first!r}"
        for source in sources(package)
        for line, text in docstrings(source)
        if (first := text.splitlines()[0])
        and (len(first) > LONGEST or OPENINGS.match(first) or PERSON_VERBS.search(first))
    ]
    assert not wrong, "\n".join(wrong)
