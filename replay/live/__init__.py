"""Live odometry: messages in one at a time, estimates out, without a transport.

The mapping and the conversion are those of recorded logs, so that a live run equals the replay of its
bag. `icreckon.ros2` connects it to ROS 2. Below: `reading`, `mapping`, `bags`, `base`.
"""
