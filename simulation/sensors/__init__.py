"""Simulated sensors: readings of encoders, IMU and fixes from a true motion.

In: true motion, specifications as in data sheets. Out: series for a log. Below: `truth`, `base`.
"""
