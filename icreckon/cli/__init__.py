"""The command line: options of each command, and its body, imported when it is called.

Below: `report`, and everything else.
"""
