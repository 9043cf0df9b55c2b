"""Files of logs, bags and tables: reading, decoding, recovery, writing.

In: bag files and table files. Out: raw records, decoded messages, tables. It limits what a file may
unpack to, and is the only room that imports rosbags and mcap. Below: `base`.
"""
