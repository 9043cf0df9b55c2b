"""Export of trajectories, tables and bags for other programs.

Formats: TUM, CSV, Parquet, MCAP and ROS 1. Below: `comparison`, `mapping`, `bags`, `base`.
"""
