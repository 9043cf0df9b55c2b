"""Reference filter: predict, gate, update, record.

In: admitted measurements, one at a time in the order of their stamps. Out: state, covariance, health.
Also stochastic clones, re-acquisition, and checkpoints. Below: `sensors`, `robot`, `motion`,
`log`, `base`.
"""
