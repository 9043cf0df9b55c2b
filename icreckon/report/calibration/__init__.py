"""Table and figure of a calibration."""
