"""Reproduction of the paper's dynamic simulation; identification of its contact.

In: the published figures. Out: published and reproduced numbers, side by side. Below: `base`,
`estimator`.
"""
