"""Logs in, estimates out: bags, topic mapping, running the filter over a log, reports."""
