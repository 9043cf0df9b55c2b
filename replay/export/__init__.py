"""Trajectories, tables and bags for other programs.

TUM, KITTI, CSV, Parquet, MCAP and ROS 1. Below: `comparison`, `mapping`, `bags`, `base`.
"""
