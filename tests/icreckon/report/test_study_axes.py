"""Units on the axes of a study."""

from typing import Any

import pytest

from icreckon.report.study.figures import INERTIAL, UNITS, with_unit
from icreckon.report.study.text import swept
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.encoders import EncoderErrors
from icreckon.simulation.sensors.fixes import FixErrors
from icreckon.simulation.sensors.imu import InertialErrors

SENSORS: dict[str, Any] = {"encoders": EncoderErrors, "fixes": FixErrors}


def documented(kind: type, name: str) -> str:
    """Text of an attribute in the docstring of a type."""
    text = (kind.__doc__ or "").partition(f"    {name}: ")[2]
    return " ".join(text.partition("\n        ")[0].split()) + " ".join(text.split()[:60])


@pytest.mark.parametrize(("key", "unit"), UNITS.items())
def test_units_are_the_documented_ones(key: str, unit: str) -> None:
    table, _, name = key.rpartition(".")
    if table in ("gyro", "accelerometer"):
        placeholder = INERTIAL[name].format("unit")
        assert f"[{placeholder}]" in documented(InertialErrors, name)
    elif table:
        text = documented(SENSORS[table], name)
        assert f"[{unit}]" in text or (unit == "1/h" and "per hour" in text)
    else:
        assert f"[{unit}]" in documented(Scenario, name)


def test_no_dimensional_key_of_a_sensor_is_forgotten() -> None:
    plain = {"scale_sigma", "scale_difference_sigma", "dropout_reads", "outlier_share"}
    for table, kind in (SENSORS | {"gyro": InertialErrors}).items():
        assert {f"{table}.{name}" for name in set(kind.__struct_fields__) - plain} <= set(UNITS)


def test_an_axis_with_one_value_has_no_column_and_no_figure() -> None:
    effects: list[dict[str, Any]] = [{"groups": [{}]}, {"groups": [{}, {}]}]
    results = {"axes": [{"name": "outage"}, {"name": "noise"}], "effects": effects}
    assert [with_unit(axis["name"]) for axis, _ in swept(results)] == ["noise"]
    assert with_unit("outage") == "outage [s]"
