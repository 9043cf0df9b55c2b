"""Units of estimated states."""

from icreckon.estimator.base import state as s
from icreckon.replay.base.units import column_name, unit


def test_each_bias_has_its_unit() -> None:
    for name in (name for name in s.STATE_NAMES if "bias" in name):
        assert unit(name) == ("m/s²" if name.startswith("accelerometer") else "rad/s"), name
    assert column_name("gyro_bias_y", "sigma") == "gyro_bias_y_sigma_rad_s"
