"""Words of code, messages and pages: standard verbs and nouns, which a reader need not translate."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# What to write: again; rarely; entirely; next to, with; separately, alone; gains; this many; correct;
# remove; include; align; assume; indicate.
FORBIDDEN = re.compile(
    r"\b(anew|seldom|wholly|beside|by itself|(is|are) worth|that of the other|so (much|many)|laid over"
    r"|mend(s|ed|ing)?|(take|takes|taken|took) out|give[sn]? in|teach(es)?|believe[sd]?|den(y|ies|ied)"
    r"|says? (nothing|little)|tells? of)\b",
    re.IGNORECASE,
)
MOST_WORDS = 55_000  # of README.md and docs/, generated tables included
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def texts(source: Path) -> Iterator[tuple[int, str]]:
    """Strings and comments of a file, with their lines; names are not text."""
    text = source.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def found_in(source: Path) -> list[str]:
    pairs = [(1, source.read_text(encoding="utf-8"))] if source.suffix == ".md" else texts(source)
    # A line may have names of variables: those in backquotes and arguments of a docstring.
    names = re.compile(r"`[^`]*`|^ +\w+: ", re.MULTILINE)
    return [
        f"{source.relative_to(ROOT)}:{line}: {match.group()!r}"
        for line, text in pairs
        for match in FORBIDDEN.finditer(names.sub("", text))
    ]


@pytest.mark.parametrize("folder", ["estimator", "simulation", "replay", "icreckon", "ros2"])
def test_code_and_messages_use_standard_words(folder: str) -> None:
    sources = sorted(one for one in (ROOT / folder).rglob("*.py") if "build" not in one.parts)
    assert [one for source in sources for one in found_in(source)] == []


def test_pages_use_standard_words() -> None:
    assert [one for page in PAGES for one in found_in(page)] == []


def test_pages_are_a_budget() -> None:
    pages = (page.read_text(encoding="utf-8") for page in PAGES if page.name != "CONTRIBUTING.md")
    more = sum(len(page.split()) for page in pages) - MOST_WORDS
    assert more <= 0, f"{more} words too many: delete as many, or see CONTRIBUTING.md"
