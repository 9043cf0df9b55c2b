"""Lowest room of replay: errors, output files, units, colours.

Below: `estimator`.
"""
