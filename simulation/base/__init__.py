"""Ground floor: errors, types of fields, sample times, random streams, and kernels of noise.

Below: `estimator`.
"""
