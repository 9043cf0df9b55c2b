"""Log reading: from the messages of bags and the rows of tables to a `Log`.

Streams of rows for each topic, clocks, tf, units, order. Below: `mapping`, `bags`, `base`.
"""
