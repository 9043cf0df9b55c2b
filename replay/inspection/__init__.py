"""Inspection of logs, and a proposed robot file.

In: an unmapped log. Out: topics, rates, findings, a robot file. Below: `estimates`, `reading`.
"""
