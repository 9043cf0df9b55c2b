"""Sensor models of gyro, accelerometer and tracks, and detection of sensor faults.

Held and stuck track speeds, standstill, the clock of the IMU. Below: `robot`, `motion`, `log`, `base`.
"""
