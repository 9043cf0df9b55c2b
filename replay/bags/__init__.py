"""Bag files: reading, decoding, recovery of damaged files, writing.

In: bag files. Out: raw records and decoded messages. The only room that imports rosbags and mcap.
Below: `base`.
"""
