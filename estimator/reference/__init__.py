"""Textbook of the filter, on filterpy.

`ekf` has the propagation and the scalar update, `imu` the sensors of the IMU, `filter` the order of
events.
Below: `engine`, `filter`, `sensors`, `motion`, `log`, `robot`, `base`.
"""
