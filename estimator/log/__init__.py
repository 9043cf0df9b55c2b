"""Measurements, the log in memory, trajectories, and their scores.

In: single measurements or arrays of them. Out: a `Log` that a filter runs over, and scores of its
estimate. Below: `base`.
"""
