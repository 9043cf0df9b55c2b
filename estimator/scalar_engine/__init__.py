"""The reference filter's algebra and whole step, compiled by numba for one filter.

In and out: arrays of `filter`, changed in place. Below: `filter`, `tracing`.
"""
