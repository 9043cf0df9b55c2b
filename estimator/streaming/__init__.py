"""Pose estimator: one measurement at a time, in any order; runs over a log.

In: measurements or a log. Out: estimates, or the run of one variant. `PoseEstimator` checks measurements,
orders them and re-runs the filter after late ones; `run` feeds it a log, `smooth` smooths the run. Below:
`engine`, `filter`.
"""
