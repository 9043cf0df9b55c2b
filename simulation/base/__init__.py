"""Errors, field types, sample times, and random streams.

Below: `estimator`.
"""
