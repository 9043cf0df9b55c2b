"""The filter's step for many filters side by side, traced and compiled.

In: arrays of measurements and the schedule of steps. Out: states, covariances and innovations of
all lanes. Below: `filter`, `tracing`.
"""
