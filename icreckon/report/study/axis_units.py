"""Units of what a study sweeps, for axis labels."""

from __future__ import annotations

from icreckon.simulation.study.cells import OUTAGE

INERTIAL = {
    "noise_density": "{}/√Hz",
    "bias_sigma": "{}",
    "bias_instability": "{}",
    "bias_instability_time": "s",
    "bias_walk": "{}/√s",
    "misalignment_sigma": "rad",
    "range": "{}",
}
UNITS = {
    **{f"gyro.{name}": unit.format("rad/s") for name, unit in INERTIAL.items()},
    **{f"accelerometer.{name}": unit.format("m/s²") for name, unit in INERTIAL.items()},
    "encoders.speed_noise_density": "m/s/√Hz",
    "encoders.resolution": "m",
    "encoders.dropouts_per_hour": "1/h",
    "encoders.dropout_duration": "s",
    "fixes.sigma": "m",
    "fixes.heading_sigma": "rad",
    "fixes.outlier_sigma": "m",
    "fixes.latency": "s",
    "fixes.wander_sigma": "m",
    "fixes.wander_time": "s",
    "duration": "s",
    "track_lag": "s",
    "track_rate": "Hz",
    "imu_rate": "Hz",
    "truth_rate": "Hz",
    "fix_rate": "Hz",
}
"""Unit by the key of a scenario."""
OF_STUDIES = {OUTAGE: "s"}
"""Unit by a key that only studies have."""


def with_unit(axis: str) -> str:
    """Name of an axis with its unit, if it is a key that has one."""
    unit = (UNITS | OF_STUDIES).get(axis)
    return axis if unit is None else f"{axis} [{unit}]"
