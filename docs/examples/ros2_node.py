"""A ROS 2 node: JointState and Imu in, Odometry out, of an icreckon pose estimator.

    python3 ros2_node.py --ros-args -p robot:=robot.toml -r joint_states:=/joint_states -r imu:=/imu/data

The robot file names the joints of each side and the sprocket radius ([log.tracks], [vehicle]). It needs
a ROS 2 whose Python is 3.11 or later: Jazzy, or a newer one. Frames
are those of REP-105: the pose is that of `base_link` in `odom`, the twist is in `base_link` (REP-103: x
forward, y left, z up). Everything above `main` works without ROS.
"""

import math

import icreckon

NANOSECONDS = 1_000_000_000
# A planar estimate says nothing of z, roll and pitch; finite, for those who invert the matrix.
UNKNOWN = 1e6
# Where x, y and yaw stand among x, y, z, roll, pitch, yaw.
PLANAR = (0, 1, 5)
# Element 0 of a covariance in sensor_msgs/Imu: the sensor does not measure that.
ABSENT = -1.0


def stamp_of(message):
    """The stamp of a message's header in nanoseconds."""
    return message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec


def joints_of(robot):
    """Names of the left and of the right joints, from the robot file.

    Raises:
        icreckon.EstimatorError: the robot file does not name them.
    """
    tracks = robot.log.get("tracks", {})
    sides = tracks.get("left"), tracks.get("right")
    for side, names in zip(("left", "right"), sides, strict=True):
        if not (names and isinstance(names, list) and all(isinstance(name, str) for name in names)):
            raise icreckon.EstimatorError(
                f"the robot file of {robot.name!r} names no joints of the {side} side: add the table "
                '[log.tracks] with topic = "/joint_states", left = ["..."] and right = ["..."]'
            )
    return sides


def track_speeds_of(message, left, right, sprocket_radius):
    """TrackSpeeds of a sensor_msgs/JointState; None if it is about other joints.

    Args:
        message: the message; velocities in rad/s.
        left: names of the left joints, whose rates are averaged.
        right: names of the right joints.
        sprocket_radius: [m].
    """
    rates = dict(zip(message.name, message.velocity, strict=False))
    if not rates.keys() >= {*left, *right}:
        return None
    left_rate = sum(rates[name] for name in left) / len(left)
    right_rate = sum(rates[name] for name in right) / len(right)
    return icreckon.TrackSpeeds(
        stamp_of(message), left_rate * sprocket_radius, right_rate * sprocket_radius
    )


def imu_sample_of(message):
    """ImuSample of a sensor_msgs/Imu, in the IMU's axes; None if it has no gyroscopes."""
    if message.angular_velocity_covariance[0] == ABSENT:
        return None
    rate, force = message.angular_velocity, message.linear_acceleration
    has_force = message.linear_acceleration_covariance[0] != ABSENT
    return icreckon.ImuSample(
        stamp_of(message),
        (rate.x, rate.y, rate.z),
        (force.x, force.y, force.z) if has_force else None,
    )


def covariance_36(covariance):
    """A (3, 3) covariance of x, y, yaw as the 36 numbers of a ROS message."""
    full = [UNKNOWN if row == column else 0.0 for row in range(6) for column in range(6)]
    for i, row in enumerate(PLANAR):
        for j, column in enumerate(PLANAR):
            full[6 * row + column] = float(covariance[i, j])
    return full


def fill_odometry(message, estimator):
    """Write an estimate into an empty nav_msgs/Odometry."""
    message.header.frame_id, message.child_frame_id = "odom", "base_link"
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(estimator.stamp, NANOSECONDS)
    x, y, yaw = (float(value) for value in estimator.pose)
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z = math.sin(0.5 * yaw)
    message.pose.pose.orientation.w = math.cos(0.5 * yaw)
    message.pose.covariance = covariance_36(estimator.pose_covariance)
    v_x, v_y, w = (float(value) for value in estimator.twist)
    message.twist.twist.linear.x, message.twist.twist.linear.y = v_x, v_y
    message.twist.twist.angular.z = w
    message.twist.covariance = covariance_36(estimator.twist_covariance)
    return message


def main():
    """Run the node."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Imu, JointState

    class Reckoner(Node):
        """One thread, one estimator: callbacks of one node take turns under `rclpy.spin`."""

        def __init__(self):
            super().__init__("icreckon")
            self.declare_parameter("robot", "")
            self.declare_parameter("variant", "inertia-online")
            robot = icreckon.load_robot(self.get_parameter("robot").value)
            self.estimator = icreckon.PoseEstimator(robot, self.get_parameter("variant").value)
            self.left, self.right = joints_of(robot)
            self.radius = robot.vehicle.sprocket_radius
            self.odometry = self.create_publisher(Odometry, "odom", 10)
            self.create_subscription(
                JointState, "joint_states", self.on_joints, qos_profile_sensor_data
            )
            self.create_subscription(Imu, "imu", self.on_imu, qos_profile_sensor_data)
            self.create_timer(60.0, self.report)

        def on_joints(self, message):
            self.feed(track_speeds_of(message, self.left, self.right, self.radius))

        def on_imu(self, message):
            if self.feed(imu_sample_of(message)):
                self.odometry.publish(fill_odometry(Odometry(), self.estimator))

        def feed(self, measurement):
            return measurement is not None and self.estimator.feed(measurement)

        def report(self):
            refused = self.estimator.health.rejections()
            if refused:
                self.get_logger().warning(f"refused so far: {refused}")

    rclpy.init()
    try:
        node = Reckoner()
    except icreckon.IcreckonError as problem:  # of the robot file, say
        rclpy.try_shutdown()
        raise SystemExit(f"ros2_node: {problem}") from None
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
