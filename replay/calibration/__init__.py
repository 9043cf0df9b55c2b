"""Calibration outputs: results as plain data, and the identified robot file.

Below: `comparison`, `estimator.calibration`.
"""
