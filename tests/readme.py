"""The code blocks of README and docs, for the tests that run them."""

import ast
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parent.parent
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
RENEWS = "ICRECKON_RENEW" in os.environ
ROUGHLY = 0.05
"""Printed figures may differ by so much [-] from machine to machine, and by one in the last digit."""


def code_blocks(language: str, page: str = "README.md", section: str | None = None) -> list[str]:
    """The fenced blocks of a language in a page of the repository, in order; of a section (##)."""
    return [text for kind, text in blocks(page, section) if kind == language]


def blocks(page: str, section: str | None = None) -> list[tuple[str, str]]:
    """Language and text of all fenced blocks of a page, or of one of its sections (##), in order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    if section is not None:
        _, found, text = text.partition(f"\n## {section}\n")
        assert found, f"{page} has no section «{section}»"
        text = text.partition("\n## ")[0]
    return re.findall(r"^```(\w+)\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def shell(command: str, cwd: Path, **more: str) -> str:
    """What a command prints on standard output; it must end well."""
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in {"VIRTUAL_ENV", "PYTHONPATH", "PYTHONHOME"}
    }
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", command],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=environment | more,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def run_page(
    page: str,
    folder: Path,
    section: str | None = None,
    *,
    programs: Path | None = None,
    before: Callable[[str], None] = lambda _: None,
) -> str:
    """Run the blocks of a page, or of a section of it, in shell and Python, one after the other.

    Each block of the language `text` must be what the shell block before it has printed: line by line,
    in order, other lines between them left out, figures roughly the same. With `ICRECKON_RENEW` in the
    environment today's figures are put into the page.
    """
    paths = [Path(sys.executable).parent, *([] if programs is None else [programs])]
    path = os.pathsep.join([*map(str, paths), os.environ["PATH"]])
    printed: list[str] = []
    for language, text in blocks(page, section):
        if language == "sh":
            before(text)
            more = {"PATH": path, "MPLBACKEND": "agg", "HOME": str(folder)}
            printed.append(shell(text, folder, **more))
        elif language == "python":
            subprocess.run([sys.executable, "-c", text], cwd=folder, check=True)
        elif language == "text":
            rest, shown = printed[-1].splitlines(), text.splitlines()
            for k, line in enumerate(shown):
                fits = (says, alike) if RENEWS else (says,)
                at = next((n for fit in fits for n, one in enumerate(rest) if fit(one, line)), None)
                assert at is not None, f"{line}\nin\n{printed[-1]}"
                shown[k] = rest[at].rstrip()
                del rest[: at + 1]
            if RENEWS:
                whole = (ROOT / page).read_text(encoding="utf-8")
                whole = whole.replace(text, "".join(f"{line}\n" for line in shown), 1)
                (ROOT / page).write_text(whole, encoding="utf-8")
    assert printed, f"{page} has no commands"
    return "".join(printed)


def says(printed: str, shown: str) -> bool:
    """Whether a printed line is the one that is shown, but for spaces and what is within `ROUGHLY`."""
    return alike(printed, shown) and all(
        math.isclose(
            float(is_), float(said), rel_tol=ROUGHLY, abs_tol=1.01 * 10.0 ** -_decimals(said)
        )
        for is_, said in zip(NUMBER.findall(printed), NUMBER.findall(shown), strict=True)
    )


def alike(printed: str, shown: str) -> bool:
    """Whether two lines are the same but for figures and spaces."""
    return NUMBER.sub("#", printed).split() == NUMBER.sub("#", shown).split()


def _decimals(number: str) -> int:
    return len(number.partition(".")[2])


def explained_messages(page: str) -> list[str]:
    """The messages of the table of a page that says what to do; … stands for what is filled in."""
    (table,) = re.findall(
        r"^\| message \| what to do \|\n\| --- \| --- \|\n((?:\|.*\n)+)",
        (ROOT / page).read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    )
    messages = re.findall(r"^\| `(.+?)` \|", table, flags=re.MULTILINE)
    assert len(messages) == len(table.splitlines())
    return messages


def are_said(messages: list[str], said: set[str]) -> bool:
    """Whether each message is among literals of the code."""
    parts = [[part.strip() for part in message.split("…")] for message in messages]
    return all(any(all(part in one for part in each) for one in said) for each in parts)


def literals(*sources: str) -> set[str]:
    """All strings of some files, with … where values are filled in."""
    found: set[str] = set()
    for source in sources:
        nodes = list(ast.walk(ast.parse((ROOT / source).read_text(encoding="utf-8"))))
        inside = {part for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
        for node in nodes:
            if isinstance(node, ast.JoinedStr):
                parts = (
                    str(part.value) if isinstance(part, ast.Constant) else "…"
                    for part in node.values
                )
                found.add("".join(parts))
            elif (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and node not in inside
            ):
                found.add(node.value)
    return found
