"""Names of the supported message types."""

from __future__ import annotations

JOINT_STATE = "sensor_msgs/msg/JointState"


IMU = "sensor_msgs/msg/Imu"


ODOMETRY = "nav_msgs/msg/Odometry"


TWIST = "geometry_msgs/msg/TwistStamped"


STRING = "std_msgs/msg/String"


POSE = "geometry_msgs/msg/PoseStamped"


POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"


QUATERNION = "geometry_msgs/msg/QuaternionStamped"


NAVSATFIX = "sensor_msgs/msg/NavSatFix"


TRANSFORM = "geometry_msgs/msg/TransformStamped"


TF = "tf2_msgs/msg/TFMessage"


TF_ROS1 = "tf/msg/tfMessage"
