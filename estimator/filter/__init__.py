"""The reference filter on filterpy: predict, gate, update, one measurement at a time.

In: admitted measurements in order of their stamps. Out: state, covariance, health. Also stochastic
clones, re-acquisition, and checkpoints. Below: `sensors`, `robot`, `motion`, `log`, `base`.
"""
