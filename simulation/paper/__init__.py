"""The paper's dynamic simulation: published numbers, stationary motions, and the contact that fits best.

In: nothing but published figures. Out: the reproduction, side by side. Below: `base`, `estimator`.
"""
