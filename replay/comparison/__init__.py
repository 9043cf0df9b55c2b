"""Comparison of filter variants over one log: runs, scores, intervals.

In: a `Log`. Out: a `Comparison`, and the results for tables and pages. Below: `base`, `estimator`.
"""
