"""Execution of a study: engines, workers, and the store of finished blocks.

In: a plan of cells. Out: results and tables in a folder; after an interruption, the same call continues.
Below: `study`.
"""
