"""Ground floor: errors, output files, units of columns, colours, and lag search.

Below: `estimator`.
"""
