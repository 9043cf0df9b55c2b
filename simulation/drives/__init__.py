"""Commanded track speeds over time, from a name and a seed, or from a recording.

In: options and random numbers. Out: a `Command`. Below: `base`.
"""
