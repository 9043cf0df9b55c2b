"""Estimation library: motion models, filter, engines, and runs over logs.

Rooms, from the ground up: `base`, `log`, `tracing`, `motion`, `robot`, `sensors`, `filter`,
`engine`, `streaming`, `batch`, `calibration`. Imports run downwards only. The library
needs no ROS and reads only its own robot files.
"""
