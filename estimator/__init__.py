"""The library: motion models, filter, engines, and what runs them over logs.

Rooms, from the ground up: `base`, `log`, `tracing`, `motion`, `robot`, `sensors`, `filter`,
`scalar_engine`, `engine`, `streaming`, `batch`, `calibration`. Imports run downwards only. Needs no ROS
and reads no files but its own robot files.
"""
