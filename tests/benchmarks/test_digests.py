"""Digest of the sources of a figure: code counts, what people read does not."""

import json
from pathlib import Path

import pytest
from _digests import code_of, digest

CODE = '''"""A room."""

FASTEST = 0.2  # rad/s
TEXT = """# no
comment"""


def half(x: float) -> float:
    """Half of it.

    Returns: half.
    """
    # Not a third.
    return x / 2.0
'''
BARE = '''FASTEST = 0.2
TEXT = """# no
comment"""
def half(x: float) -> float:
    return x / 2.0'''


def test_comments_docstrings_and_empty_lines_do_not_count() -> None:
    assert code_of(CODE) == code_of(BARE) == BARE


@pytest.mark.parametrize("other", ["0.3", "0.20"])
def test_code_counts(other: str) -> None:
    assert code_of(CODE.replace("0.2", other)) != BARE


def test_only_the_named_runs_of_a_file_count(tmp_path: Path) -> None:
    found = []
    for number, (healthy, faulty) in enumerate([(1.0, 2.0), (1.0, 3.0), (1.5, 2.0)]):
        file = tmp_path / f"{number}.json"
        file.write_text(json.dumps({"healthy | level": [healthy], "faults | moving": [faulty]}))
        found.append(digest(f"{file}#healthy,real"))
    assert found[0] == found[1] != found[2]
