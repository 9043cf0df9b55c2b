"""Lowest room of replay: errors, output files, units, colours, lag search.

Below: `estimator`.
"""
