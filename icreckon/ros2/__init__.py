"""ROS 2 node: topics in; odometry, tf and diagnostics out.

The one place that imports rclpy: a thin shell around `icreckon.replay.live`, which holds all that can be
tested without ROS.
"""
