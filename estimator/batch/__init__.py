"""Many logs by one filter variant, or one log by many variants, in one pass.

In: logs. Out: the same runs and scores as the streaming estimator's, to rounding. Below: `engine`,
`streaming`.
"""
