"""Bag files: records in and out, message types, decoding, recovery of damaged files.

The only room that imports rosbags and mcap. Below: `base`.
"""
