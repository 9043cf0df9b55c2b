"""Running a study: engines, workers, and the store of finished blocks.

In: a plan of cells. Out: results and tables in a folder; interrupted, the same call continues.
Below: `study`.
"""
