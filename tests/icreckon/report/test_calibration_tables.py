"""Numbers and names in the tables of a calibration."""

from __future__ import annotations

import pytest

from icreckon.report.calibration.tables import parameter_table
from icreckon.report.pages import Cell, Table, render
from icreckon.report.terminal import rich_table


@pytest.mark.parametrize(
    ("value", "sigma", "texts"),
    [
        (10.3784, 0.12, ("10.38", "0.12")),
        (-0.00097797, 0.0043, ("-0.001", "0.0043")),
        (-1.1766e-06, 5.4e-06, ("-1.2e-06", "5.4e-06")),
        (-0.31202, 0.01, ("-0.312", "0.010")),
        (300.0, 2000.0, ("300", "2.0e+03")),
        (0.0, 0.17, ("0", "0.17")),
        (1.073456, None, ("1.0735", "")),
    ],
)
def test_values_end_at_the_second_digit_of_their_error(
    value: float, sigma: float | None, texts: tuple[str, str]
) -> None:
    one = {
        "value": value, "sigma": sigma, "status": "shown", "note": "", "unit": "m", "before": None,
        "before_is_default": False, "sigma_other_logs": sigma,
    }  # fmt: skip
    table = parameter_table({"parameters": {"a": one}, "robot": {"name": "r"}})
    (_, cells) = table.rows[0]
    assert tuple(cell.text for cell in cells[:2]) == texts


@pytest.mark.parametrize(
    ("sigma", "other", "wide", "narrow"),
    [
        (0.01, 0.02, ["0.010", "0.020"], ["0.010/0.020"]),
        (0.01, 0.01, ["0.010", "0.010"], ["0.010"]),
        (None, None, ["", ""], [""]),
    ],
)
def test_errors_for_these_logs_and_for_others(
    sigma: float | None, other: float | None, wide: list[str], narrow: list[str]
) -> None:
    one = {
        "value": 1.0, "sigma": sigma, "status": "shown", "note": "", "unit": "m", "before": None,
        "before_is_default": False, "sigma_other_logs": other,
    }  # fmt: skip
    results = {"parameters": {"a": one}, "robot": {"name": "r"}}
    for is_narrow, texts in ((False, wide), (True, narrow)):
        table = parameter_table(results, narrow=is_narrow)
        (_, cells) = table.rows[0]
        assert [cell.text for cell in cells[1 : 1 + len(texts)]] == texts
        assert len(cells) == len(table.head) - 1


def test_long_texts_of_a_narrow_table_stand_below_it_once() -> None:
    """There are 26 letters; what comes later stays whole."""
    texts = [f"shown; reason {number % 27}" for number in range(54)]
    rows = [(f"row {number}", [Cell(text, "wrap")]) for number, text in enumerate(texts)]
    table = rich_table(Table("t", ["name", "status"], rows), narrow=True)
    cells = list(table.columns[1].cells)
    assert cells[0] == cells[27] == "shown a"
    assert cells[25] == cells[52] == "shown z"
    assert cells[26] == cells[53] == "shown; reason 26"
    assert str(table.caption).splitlines()[0] == "a: reason 0"
    assert len(str(table.caption).splitlines()) == 26


def test_names_break_after_dots_and_underscores_and_stay_escaped() -> None:
    table = Table("t", ["name", "value"], [("<b>imu.gyro_bias", [Cell("1")])])
    page = render(
        "calibration.html", title="t", headline="h", pictures=[], tables=[table], notes=[],
        configuration={}, robot={}, origin={},
    )  # fmt: skip
    assert "&lt;b&gt;imu.<wbr>gyro_<wbr>bias" in page
