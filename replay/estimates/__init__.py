"""Estimates of a robot's and its sensors' values from a log.

In: a `Log`. Out: mounting, latencies, effective geometry, gyro bias, error of fixes. Below: `reading`.
"""
