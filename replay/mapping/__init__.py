"""Mapping from topics, fields and columns to sensors and units.

In: the `[log]` table of a robot file. Out: checked maps. Below: `base`.
"""
