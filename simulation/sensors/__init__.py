"""Simulated sensors: what encoders, IMU and fixes read of a true motion.

In: true motion, specifications as in data sheets. Out: series for a log. Below: `truth`, `base`.
"""
