"""What a log holds, and the robot file that it suggests.

In: a log nobody prepared. Out: topics, rates, latency, mounting, effective geometry. Below: `reading`.
"""
