"""Results of a calibration, and the robot file with what was found.

Below: `comparison`, `estimator.calibration`.
"""
