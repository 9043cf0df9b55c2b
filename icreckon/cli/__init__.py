"""Command line: a file for each command, with its options and its body.

Below: `report`, and all other rooms.
"""
