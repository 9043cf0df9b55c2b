"""Checks of a robot file against a log.

In: a `Log` and the `Robot` it was read with. Out: what contradicts, how to correct it, what it costs in
drift. Below: `estimates`, `inspection`, `comparison`.
"""
