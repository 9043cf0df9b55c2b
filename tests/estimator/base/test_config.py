"""Configuration from TOML: what is wrong is refused, and the message says what would be right."""

from typing import Literal

import msgspec
import pytest

from icreckon.estimator.base.config import convert, read_toml
from icreckon.estimator.base.errors import EstimatorError, nearest_hint


class Inner(msgspec.Struct, forbid_unknown_fields=True):
    speed: float = 1.0
    name: str = ""
    unit: Literal["s", "ms"] | None = None
    axes: tuple[Literal["x", "y"], ...] = ()


class Outer(msgspec.Struct, forbid_unknown_fields=True):
    title: str
    inner: Inner = msgspec.field(default_factory=Inner)
    several: list[Inner] = []
    maybe: Inner | None = None
    by_name: dict[str, Inner] = {}
    anything: dict[str, object] = {}


def refused(data):
    with pytest.raises(EstimatorError) as caught:
        convert(data, Outer, "file.toml", EstimatorError)
    message = str(caught.value)
    assert message.startswith("file.toml: ")
    assert "\n" not in message
    return message


def test_good_data_is_converted():
    data = {"title": "t", "inner": {"speed": 2}, "by_name": {"a": {"name": "b"}}}
    made = convert(data, Outer, "file.toml", EstimatorError)
    assert made.inner.speed == 2.0
    assert made.by_name["a"].name == "b"


@pytest.mark.parametrize(
    ("data", "found", "table", "right"),
    [
        ({"titel": "t"}, "titel", None, "title"),
        ({"title": "t", "inner": {"sped": 1.0}}, "sped", "inner", "speed"),
        ({"title": "t", "maybe": {"nam": "x"}}, "nam", "maybe", "name"),
        ({"title": "t", "several": [{}, {"spead": 1.0}]}, "spead", "several", "speed"),
        ({"title": "t", "by_name": {"a": {"speeed": 1.0}}}, "speeed", "by_name.a", "speed"),
    ],
)
def test_misspelt_key_is_refused_with_the_nearest_right_one(data, found, table, right):
    message = refused(data)
    assert f"unknown key {found!r}" in message
    assert f"did you mean {right!r}?" in message
    assert table is None or f"[{table}]" in message


def test_wrong_type_names_the_place():
    speed = refused({"title": "t", "inner": {"speed": "fast"}})
    assert speed.endswith("[inner] speed: expected a number, found text")
    inner = refused({"title": "t", "inner": 3})
    assert inner.endswith("inner: expected a table, found a whole number")
    several = refused({"title": "t", "several": [{}, {"speed": "fast"}]})
    assert "[several] speed number 2: expected a number, found text" in several


def test_a_text_that_is_no_choice_names_the_choices():
    unit = refused({"title": "t", "maybe": {"unit": "sec"}})
    assert unit.endswith("[maybe] unit: expected one of 's', 'ms', found 'sec'")
    axes = refused({"title": "t", "several": [{"axes": ["x", "z"]}]})
    assert axes.endswith("expected one of 'x', 'y', found 'z'")


def test_missing_key_is_named():
    assert "`title`" in refused({})


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(EstimatorError, match=r"none\.toml: no such file"):
        read_toml(tmp_path / "none.toml", EstimatorError)
    with pytest.raises(EstimatorError, match="cannot be read"):
        read_toml(tmp_path, EstimatorError)
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe9"')
    with pytest.raises(EstimatorError, match=r"latin\.toml: cannot be read"):
        read_toml(tmp_path / "latin.toml", EstimatorError)
    (tmp_path / "marked.toml").write_bytes(b"\xef\xbb\xbfname = 1")
    assert read_toml(tmp_path / "marked.toml", EstimatorError) == {"name": 1}
    for text in ("a = " + "[" * 100_000, "a = " + "9" * 10_000, "a = [1,"):
        (tmp_path / "broken.toml").write_text(text)
        with pytest.raises(EstimatorError, match=r"broken\.toml: not a valid TOML file"):
            read_toml(tmp_path / "broken.toml", EstimatorError)


def test_hint_names_the_nearest_or_all():
    assert nearest_hint("zet0", ["zeta0", "eta0"]) == "; did you mean 'zeta0'?"
    assert nearest_hint("xyz", ["b", "a"]) == "; there is 'a', 'b'"
