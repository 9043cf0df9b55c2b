"""Which topic, field or column is which sensor, in which units.

In: the `[log]` table of a robot file. Out: checked maps. Below: `base`.
"""
