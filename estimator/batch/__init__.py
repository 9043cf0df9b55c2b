"""Many logs by one filter variant in one pass; samples as arrays.

In: logs. Out: the same scores as the streaming estimator's, to rounding. Below: `engine`, `streaming`.
"""
