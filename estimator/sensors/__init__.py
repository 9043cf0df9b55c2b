"""Sensor models: what gyro, accelerometer and tracks should read, and when a sensor cannot be trusted.

Held and stuck track speeds, standstill, the clock of the IMU. Below: `robot`, `motion`, `log`, `base`.
"""
