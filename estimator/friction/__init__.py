"""Friction motion model: forces at the contact points, integrated in time.

The same traced code is compiled for one filter and for many in lanes. Symbols and axes are the paper's.
Below: `motion`, `tracing`, `base`.
"""
