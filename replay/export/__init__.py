"""Export of trajectories, tables and bags for other programs.

Formats: TUM, KITTI, CSV, Parquet, MCAP and ROS 1. Below: `comparison`, `mapping`, `bags`, `base`.
"""
