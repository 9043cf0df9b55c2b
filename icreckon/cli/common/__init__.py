"""Shared by commands: options, consoles, signals, and the comparison of variants."""
