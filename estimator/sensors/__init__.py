"""Sensor models of gyro, accelerometer and tracks, and inputs of a step.

Held track speeds, standstill, clock and noise of the IMU. Below: `faults`, `robot`, `motion`, `log`,
`base`.
"""
