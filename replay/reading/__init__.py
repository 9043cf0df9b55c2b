"""From the messages of a bag, or the rows of a table, to a `Log`.

Streams of rows for each topic, clocks, tf, units, order. Below: `mapping`, `bags`, `base`.
"""
