"""Friction at the contact points: loads, forces, and stationary motions.

In: a robot and the ground. Out: forces and twists. Symbols and axes are the paper's. Below: `base`.
"""
