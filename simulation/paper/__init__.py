"""Reproduction of the paper's dynamic simulation.

In: the published figures. Out: published and reproduced numbers, side by side. Below: `base`,
`estimator`.
"""
