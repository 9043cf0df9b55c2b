"""Lowest room of replay: errors, output files, units of columns, colours, lag search.

Below: `estimator`.
"""
