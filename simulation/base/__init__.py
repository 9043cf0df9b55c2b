"""Errors, field types, sample times, random streams, and noise kernels.

Below: `estimator`.
"""
