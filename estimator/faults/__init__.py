"""Faults that track speeds and IMU show: of each other, and of themselves.

Tracks that stick or spin free, wheels of one side that disagree, a robot that slides as a whole, a gyro
that fails. Each is a record and a function that adds a sample to it. Below: `base`.
"""
