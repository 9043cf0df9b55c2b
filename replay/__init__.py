"""Replay of recorded logs: reading, mapping, inspection, comparison, export.

In: bags and tables. Out: estimates, scores and files. Rooms, from the lowest: `base`, `bags`,
`mapping`, `reading`, `live`, `estimates`, `inspection`, `comparison`, `checking`, `calibration`,
`export`. Imports `estimator`, never `simulation`.
"""
