"""Inspection of logs, and a proposed robot file.

In: an unmapped log. Out: topics, rates, latency, mounting, effective geometry. Below: `reading`.
"""
