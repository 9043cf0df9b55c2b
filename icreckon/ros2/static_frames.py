"""Poses of frames by /tf_static: of the IMU on the robot, and of the fixes."""

import time
from functools import partial
from typing import Any

import msgspec

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.bags.message_types import IMU, TF
from icreckon.replay.live.base_frame import BaseFrame
from icreckon.replay.mapping.topics import topic_map
from icreckon.replay.reading.tf import TransformStream
from icreckon.ros2.topics import message_class

PATIENCE = 5.0  # time after which what is missing is warned of [s]


class StaticFrames:
    """Listener to /tf_static."""

    def __init__(self, node: Any) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        self._node = node
        self._transforms = TransformStream("frames", "tf", source="", time="recording")
        qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        take = partial(self._transforms.add_transforms, "/tf_static", 0)
        node.create_subscription(message_class(TF), "/tf_static", take, qos)

    def pose(self, parent: str, child: str) -> tuple[Floats, Floats] | None:
        """Place (3,) [m] and rotation (3, 3) of a frame in another; None if unknown."""
        self._transforms.frames = parent, child
        return self._transforms.static_pose()

    def mounted(self, robot: Robot, base_frame: str, base: BaseFrame) -> Robot:
        """Robot whose IMU is where the `frame_id` of its messages is.

        Waits until a message of the IMU and the transforms have come.

        Raises:
            EstimatorError: the robot file maps no topic of sensor_msgs/Imu.
        """
        import rclpy
        from rclpy.qos import qos_profile_sensor_data

        mapped, log, seen = topic_map(robot).imu, self._node.get_logger(), list[str]()
        if mapped is None or mapped.names:
            raise EstimatorError("mounting_from_tf needs a topic of sensor_msgs/Imu in [log.imu]")

        def take(message: Any) -> None:
            seen.append(message.header.frame_id)

        kind, began, is_warned = message_class(IMU), time.monotonic(), False
        imu = self._node.create_subscription(kind, mapped.topic, take, qos_profile_sensor_data)
        while not seen or (pose := self.pose(base_frame, seen[-1])) is None:
            rclpy.spin_once(self._node, timeout_sec=0.1)
            if not is_warned and time.monotonic() - began > PATIENCE:
                missing = (
                    f"a transform from {base_frame!r} to {seen[-1]!r}" if seen else mapped.topic
                )
                log.warning(f"mounting_from_tf: still waiting for {missing}")
                is_warned = True
        self._node.destroy_subscription(imu)
        mounted = base.mounted(robot.imu, *pose)
        angles = ", ".join(str(round(angle)) for angle in mounted.rotation_rpy_deg)
        log.info(f"IMU in {seen[-1]!r}: turned by ({angles}) deg, by tf")
        return msgspec.structs.replace(robot, imu=mounted)
