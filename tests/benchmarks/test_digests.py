"""Digest of the sources of a figure: code counts, what people read does not."""

import pytest
from _digests import code_of

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
