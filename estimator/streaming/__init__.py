"""The pose estimator: measurements one at a time, as late as they come; and runs over a log.

`PoseEstimator` admits, orders and re-runs; `run` feeds it a log, `smooth` looks back from the end.
Below: `engine`, `filter`.
"""
