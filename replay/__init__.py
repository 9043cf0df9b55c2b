"""Logs in, estimates out: bags and tables, topic mapping, inspection, comparison, export.

Rooms, from the ground up: `base`, `bags`, `mapping`, `reading`, `inspection`, `comparison`,
`calibration`, `export`. Imports `estimator`, never `simulation`.
"""
