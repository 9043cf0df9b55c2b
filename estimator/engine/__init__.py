"""The filter's step traced and compiled: one lane for a stream, many side by side.

In: a filter and its inputs, or arrays of measurements and the schedule of steps. Out: states, covariances
and innovations of all lanes. Below: `filter`, `tracing`.
"""
