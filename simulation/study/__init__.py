"""Studies: sweeps, cells and their runs, statistics and results.

In: a study file (some ship in `studies/`). Out: cells to run, and results from their scores.
Below: `scenario`, `sensors`, `truth`.
"""
