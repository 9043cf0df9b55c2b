"""Units of the estimated states: suffixes of column names and labels of axes."""

# Name of the state -> (suffix of its column, unit on an axis). States: docs/explanation/model.md.
UNITS: dict[str, tuple[str, str]] = {
    "zeta0": ("m", "m"),
    "zeta1": ("m_per_N", "m/N"),
    "epsilon0": ("m", "m"),
    "epsilon1": ("m_per_N", "m/N"),
    "eta1": ("per_N", "1/N"),
    "eta2": ("per_N2", "1/N²"),
    "epsilon_F": ("m", "m"),
    "turn_l": ("per_m", "1/m"),
    "turn_r": ("per_m", "1/m"),
    "half_contact_length": ("m", "m"),
    "x_CM": ("m", "m"),
    "y_CM": ("m", "m"),
    "z_CM": ("m", "m"),
    "slip_x": ("m_s", "m/s"),
    "slip_y": ("m_s", "m/s"),
    "slip_w": ("rad_s", "rad/s"),
    "gyro_bias": ("rad_s", "rad/s"),
    "accelerometer_bias_x": ("m_s2", "m/s²"),
    "accelerometer_bias_y": ("m_s2", "m/s²"),
    "gravity_x": ("m_s2", "m/s²"),
    "gravity_y": ("m_s2", "m/s²"),
}
PURE_NUMBER = ("", "-")


def column_name(name: str, *qualifiers: str) -> str:
    """Name of a state's column: state, qualifiers and unit, as "zeta0_sigma_m"."""
    suffix, _ = UNITS.get(name, PURE_NUMBER)
    return "_".join(part for part in (name, *qualifiers, suffix) if part)


def unit(name: str) -> str:
    """Unit of a state on an axis, "-" if dimensionless."""
    _, on_axis = UNITS.get(name, PURE_NUMBER)
    return on_axis
