"""Command line: options and bodies of the commands, imported when called.

Below: `report`, and all other rooms.
"""
