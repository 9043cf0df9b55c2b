"""Calibration outputs: results as plain data, and the calibrated robot's file.

Below: `comparison`, `icreckon.estimator.calibration`.
"""
