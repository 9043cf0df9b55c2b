"""The README's code blocks, for the tests that run them."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent


def code_blocks(language: str, page: str = "README.md") -> list[str]:
    """The fenced blocks of a language in a page of the repository, in order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
