"""Numbers and names in the tables of a calibration."""

import pytest

from icreckon.report.calibration.tables import parameter_table


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
def test_values_end_at_the_second_digit_of_their_error(value, sigma, texts):
    one = {
        "value": value, "sigma": sigma, "status": "shown", "note": "", "unit": "m", "before": None,
        "before_is_default": False, "sigma_other_logs": sigma,
    }  # fmt: skip
    table = parameter_table({"parameters": {"a": one}, "robot": {"name": "r"}})
    (_, cells) = table.rows[0]
    assert tuple(cell.text for cell in cells[:2]) == texts
