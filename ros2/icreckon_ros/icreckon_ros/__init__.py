"""Entry point of icreckon's ROS 2 node for `ros2 run` and `ros2 launch`."""
