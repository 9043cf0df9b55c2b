"""Units of the estimated states: suffixes of column names and labels of axes."""

# (suffix of a column, unit on an axis) -> names of the states. States: docs/explanation/model.md.
NAMES = {
    ("m", "m"): ("zeta0", "epsilon0", "epsilon_F", "half_contact_length", "x_CM", "y_CM", "z_CM"),
    ("m_per_N", "m/N"): ("zeta1", "epsilon1"),
    ("per_N", "1/N"): ("eta1",),
    ("per_N2", "1/N²"): ("eta2",),
    ("per_m", "1/m"): ("turn_l", "turn_r"),
    ("m_s", "m/s"): ("slip_x", "slip_y"),
    ("rad_s", "rad/s"): ("slip_w", "gyro_bias", "gyro_bias_x", "gyro_bias_y"),
    ("m_s2", "m/s²"): ("accelerometer_bias_x", "accelerometer_bias_y", "gravity_x", "gravity_y"),
}
UNITS = {name: units for units, names in NAMES.items() for name in names}
PURE_NUMBER = ("", "-")


def column_name(name: str, *qualifiers: str) -> str:
    """Name of a state's column: state, qualifiers and unit, as "zeta0_sigma_m"."""
    suffix, _ = UNITS.get(name, PURE_NUMBER)
    return "_".join(part for part in (name, *qualifiers, suffix) if part)


def unit(name: str) -> str:
    """Unit of a state on an axis, "-" if dimensionless."""
    _, on_axis = UNITS.get(name, PURE_NUMBER)
    return on_axis
