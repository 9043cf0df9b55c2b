"""ROS 2 node: subscriptions, publishers, services around `LiveOdometry`."""

import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import msgspec

from icreckon.estimator.base.errors import EstimatorError, IcreckonError
from icreckon.estimator.base.frames import matrix_to_rpy
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.streaming.outputs import IcrPoints, icr_points
from icreckon.replay.bags import message_types as ros
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.live.base_frame import CENTRE, BaseFrame, Pose
from icreckon.replay.live.diagnostic_status import DiagnosticStatus
from icreckon.replay.live.inputs import Subscription
from icreckon.replay.live.odometry import LiveEstimate, LiveOdometry, live_topics
from icreckon.replay.live.silence import silent_topic
from icreckon.replay.live.slip import SlipWatch
from icreckon.replay.live.statuses import LiveStatuses, parameter_statuses
from icreckon.ros2 import parameters
from icreckon.ros2.inbox import NO_TIMES, Inbox, Queue, Received
from icreckon.ros2.messages import (
    fill_diagnostics,
    fill_icr_markers,
    fill_odometry,
    fill_pose,
    fill_transform,
    pose_of,
)
from icreckon.ros2.static_frames import StaticFrames
from icreckon.ros2.topics import find_topic, input_qos, message_class, overridable

NODE_NAME = "icreckon"
OUTPUTS = ("odom", "pose_in_map", "/tf", "icrs", "slip", "learnt_parameters", "/diagnostics")
DISCOVERY_PERIOD = 0.1  # time between two looks for input topics that nobody published before [s]
QUIET = 0.2  # time without messages after which everything that is held is processed [s]
SILENCE = 5.0  # time after which topics without messages are warned of [s]
PERIOD = 0.2  # shortest time between two messages of ICR markers, or of slip [s]
NO_ROS = (
    "rclpy cannot be imported ({}): source your ROS 2 (as /opt/ros/jazzy/setup.bash) and use a virtual "
    "environment made with --system-site-packages, see docs/tutorials/live.md"
)


def run_node(robot: str | None, variant: str | None, arguments: list[str]) -> None:
    """Run the node until it is interrupted.

    Raises:
        EstimatorError: no ROS 2, an argument that is not for ROS, or an invalid parameter.
        IcreckonError: a robot file or saved state that cannot be used.
    """
    if arguments and arguments[0] != "--ros-args":
        raise EstimatorError(
            f"unknown argument {arguments[0]!r}: arguments of the command are --robot and --variant, "
            "those of ROS come after --ros-args"
        )
    try:
        import rclpy
        from rclpy.executors import ExternalShutdownException
    except ImportError as problem:
        raise EstimatorError(NO_ROS.format(problem)) from None
    try:
        rclpy.init(args=[NODE_NAME, *arguments])
    except RuntimeError as problem:
        # Without the places in rcl's own code.
        reason = str(problem).partition(", at /")[0].removeprefix("failed to initialize rcl: ")
        raise EstimatorError(f"arguments for ROS: {reason}") from None
    node = None
    try:
        node = OdometryNode(robot, variant)
        rclpy.spin(node.node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        # A signal that comes before the first wait leaves no valid context to wait in.
        if node is None or rclpy.ok():
            raise
    finally:
        if node is not None:
            node.close()
        rclpy.try_shutdown()


class OdometryNode:
    """Node that feeds a `LiveOdometry` and publishes what it estimates.

    Raises:
        IcreckonError: an invalid parameter, robot file or saved state.
    """

    def __init__(self, robot: str | None = None, variant: str | None = None) -> None:
        import rclpy
        from rclpy.exceptions import ParameterException

        try:
            self.node = rclpy.create_node(NODE_NAME)
        except ParameterException as problem:
            raise EstimatorError(f"parameters of the node: {problem}") from None
        self._log = self.node.get_logger()
        self._problems: set[str] = set()  # those that are logged
        self.options = self._declared(robot, variant)
        options = self.options
        self._log.info("loading the filter; `icreckon prepare` ahead makes this quick")
        self._state_file = Path(options.state_file).expanduser() if options.state_file else None
        loaded = load_robot(options.robot and str(Path(options.robot).expanduser()))
        has_fixes = options.use_fixes and live_topics(loaded).fixes is not None
        if has_fixes or options.mounting_from_tf:
            self._frames = StaticFrames(self.node)
        if options.mounting_from_tf:
            loaded = self._frames.mounted(loaded, options.base_frame, BaseFrame(options.base))
        self.live = LiveOdometry(
            loaded,
            options.variant,
            reorder=options.reorder,
            use_fixes=options.use_fixes,
            highest_rate=options.highest_rate,
            saved=self._state_file,
            start_pose=options.start,
            base_offset=options.base,
            odom_frame=options.odom_frame,
        )
        self.live.inputs.place_of_frame = self._place_of_frame
        self._warn(self.live.set_aside)
        self._statuses = LiveStatuses(self.live)
        self._slip_watch = SlipWatch(self.live.robot.vehicle.track_gauge)
        # Inputs that nobody publishes yet, and those on which nothing has come.
        self._missing = list(self.live.inputs.subscriptions())
        self._silent = list(self._missing)
        self._inbox = Inbox()
        self._last_message = self._started = time.monotonic()  # [s]
        self._last_slow = 0  # stamp of the last slip and markers [ns]
        self._check_qos()
        self._make_publishers()
        self._check_topics()
        self._make_services()
        self._make_timers()
        self._check_state_file()
        started = f"warm start from {self._state_file}" if self.live.warm else "cold start"
        topics = ", ".join(
            f"{subscription.purpose} on {subscription.topic}" for subscription in self._missing
        )
        if self.live.assumed_topics:
            self._warn(
                f"the robot file has no [log.tracks]; assuming {topics}, as simulated bags have"
            )
        no_map = "" if self.live.map else "; no [log.fixes]: no pose in map"
        self._log.info(f"ready: {options.variant}, {started}; waiting for {topics}{no_map}")

    def close(self) -> None:
        """Save what was learnt and destroy the node."""
        self._save_learnt()
        self.node.destroy_node()

    # --- construction ----------------------------------------------------------------------------

    def _declared(self, robot: str | None, variant: str | None) -> parameters.NodeOptions:
        """Declare all parameters; values of the command line win over those of ROS."""
        from rcl_interfaces.msg import ParameterDescriptor

        # Declaring them all instead would refuse empty lists.
        overrides = getattr(self.node, "_parameter_overrides", {})
        self._qos = {
            name: parameter.value
            for name, parameter in overrides.items()
            if name.startswith(parameters.OF_QOS) and not self.node.has_parameter(name)
        }
        for text in parameters.unknown_parameters(
            name for name in overrides if not name.startswith(parameters.OF_QOS)
        ):
            self._warn(text)
        values: dict[str, Any] = {}
        for option in msgspec.structs.fields(parameters.NodeOptions):
            name, default = option.name, option.default
            # Any type is taken here: `options_from` converts 2 to 2.0 and has the better messages.
            descriptor = ParameterDescriptor(
                description=parameters.DESCRIPTIONS[name],
                additional_constraints=parameters.constraints(name),
                read_only=True,
                dynamic_typing=True,
            )
            parameter = self.node.declare_parameter(name, default, descriptor)
            # An empty list has no value.
            values[name] = default if parameter.value is None else parameter.value
        given = {"robot": robot, "variant": variant}
        values |= {name: value for name, value in given.items() if value is not None}
        return parameters.options_from(values)

    def _check_qos(self) -> None:
        """Refuse an invalid override of a topic's QoS, and warn of one of no topic."""
        resolve = self.node.resolve_topic_name
        topics = [f"{resolve(subscription.topic)}.subscription" for subscription in self._missing]
        topics += [f"{resolve('initialpose')}.subscription"]
        topics += [f"{resolve(output)}.publisher" for output in OUTPUTS]
        for text in parameters.check_qos(self._qos, topics):
            self._warn(text)

    def _make_publishers(self) -> None:
        options, has_map = self.options, self.live.map is not None
        has_tf = options.publish_tf or (options.publish_map_tf and has_map)
        marker_types = (ros.MARKERS, ros.MARKER, ros.POINT)
        new = self._publisher
        self._odometry = new("odom", 100, ros.ODOMETRY)
        self._map_pose = new("pose_in_map", 10, ros.POSE_WITH_COVARIANCE) if has_map else None
        self._tf = new("/tf", 100, ros.TF, ros.TRANSFORM) if has_tf else None
        self._markers = new("icrs", 10, *marker_types) if options.icr_markers else None
        self._slip, self._learnt, self._diagnostics = (
            new(topic, 10, ros.DIAGNOSTICS, ros.STATUS, ros.KEY_VALUE)
            for topic in ("slip", "learnt_parameters", "/diagnostics")
        )

    def _check_topics(self) -> None:
        """Refuse to listen to the node's own poses."""
        publishers = filter(None, (self._odometry, self._map_pose))
        own_topics = [publisher.topic_name for publisher in publishers]
        for subscription in self._missing:
            topic = self.node.resolve_topic_name(subscription.topic)
            if topic in own_topics:
                raise EstimatorError(
                    f"topic {topic} is an input ({subscription.purpose}) and the node's own output: "
                    "give it a namespace, as --ros-args -r __ns:=/icreckon"
                )

    def _check_state_file(self) -> None:
        """Warn at the start, and not after an hour, if nothing learnt can be kept."""
        if self._state_file is None:
            return
        folder = self._state_file.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
            TemporaryFile(dir=folder).close()
        except OSError as problem:
            self._warn(
                f"state_file {self._state_file} cannot be written, so nothing is kept: {problem}"
            )

    def _publisher(self, topic: str, depth: int, msgtype: str, *parts: str) -> Any:
        """Make a publisher; import the classes of its messages and of their parts."""
        kind, *_ = [message_class(name) for name in (msgtype, *parts)]
        return self.node.create_publisher(kind, topic, depth, qos_overriding_options=overridable())

    def _new(self, msgtype: str) -> Any:
        return message_class(msgtype)()

    def _make_services(self) -> None:
        """Offer to save and to reset, and to take initial poses if there is a map."""
        from std_srvs.srv import Trigger

        self.node.create_service(Trigger, "~/save", self._on_save)
        self.node.create_service(Trigger, "~/reset", self._on_reset)
        if self.live.map is not None:
            kind = message_class(ros.POSE_WITH_COVARIANCE)
            self.node.create_subscription(
                kind, "initialpose", self._on_initial_pose, 1, qos_overriding_options=overridable()
            )

    def _make_timers(self) -> None:
        from rclpy.clock import Clock, JumpThreshold
        from rclpy.clock_type import ClockType
        from rclpy.duration import Duration

        timer = partial(self.node.create_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._discovery = timer(DISCOVERY_PERIOD, self._discover)
        timer(1.0 / self.options.diagnostics_rate, self._report)
        timer(0.5 * QUIET, self._flush_if_quiet)
        if self._state_file is not None:
            timer(self.options.save_period, self._save_learnt)
        threshold = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        # The handle must be kept: the callback ends with it.
        clock = self.node.get_clock()
        self._jump = clock.create_jump_callback(threshold, post_callback=self._on_jump)

    # --- inputs ------------------------------------------------------------------------------------

    def _discover(self) -> None:
        """Subscribe to the inputs that have a publisher by now, until all have one."""
        for subscription in list(self._missing):
            try:
                published = find_topic(self.node, subscription)
                if published is not None:
                    self._subscribe(subscription, *published)
                    self._missing.remove(subscription)
            except ReplayError as problem:
                self._warn(str(problem))
        if not self._missing:
            self._discovery.cancel()

    def _subscribe(self, subscription: Subscription, msgtype: str, reliability: str) -> None:
        """Subscribe to an input of a type; `reliability` is that of its publishers."""
        from rclpy import subscription as rclpy_subscription

        depth, wanted = self.options.input_depth, self.options.input_reliability
        qos = input_qos(subscription, depth, reliability if wanted == "auto" else wanted)
        callback = partial(self._on_message, subscription, msgtype)
        if not hasattr(rclpy_subscription, "MessageInfo"):
            callback = partial(callback, info=NO_TIMES)
        kind = message_class(msgtype)
        created = self.node.create_subscription(
            kind, subscription.topic, callback, qos, qos_overriding_options=overridable()
        )
        self._inbox.add(Queue(subscription, msgtype, created, depth))
        self._log.info(f"{subscription.purpose}: {subscription.topic} ({msgtype})")

    def _on_initial_pose(self, message: Any) -> None:
        frame, wanted = message.header.frame_id, self.options.map_frame
        if frame.removeprefix("/") != wanted:
            self._log.warning(f"initialpose is in frame {frame!r}, not in {wanted!r}: not used")
            return
        try:
            pose, covariance = pose_of(message)
            self.live.place(pose, covariance)
        except IcreckonError as problem:
            self._log.warning(f"initialpose: {problem}")
            return
        x, y, yaw = pose
        self._log.info(f"{wanted} starts again at x {x:.2f} m, y {y:.2f} m, yaw {yaw:.2f} rad")

    def _on_message(
        self, subscription: Subscription, msgtype: str, message: Any, info: Mapping[str, Any]
    ) -> None:
        self._inbox.put(Received(subscription, msgtype, message, info))
        self._take_messages()

    def _take_messages(self) -> None:
        """Feed the waiting messages and publish; what cannot be used is warned of."""
        is_simulated = self.node.get_clock().ros_time_is_active
        for received in self._inbox.take():
            self._last_message = time.monotonic()
            subscription, msgtype, message, _ = received
            arrival = received.arrival(self._now())
            try:
                steady = None if is_simulated else time.monotonic_ns()
                estimates = self.live.take(subscription, msgtype, message, arrival, steady)
            except IcreckonError as problem:
                self._warn(str(problem))
            else:
                self._publish(estimates)
            self._inbox.worked()

    def _flush_if_quiet(self) -> None:
        """Feed what is held for later messages, if these no longer come."""
        self._take_messages()
        if self._inbox.settling:
            return
        if time.monotonic() - self._last_message > max(QUIET, self.options.reorder):
            self._publish(self.live.flush(self._now()))

    def _on_jump(self, jump: Any) -> None:
        self._log.warning(
            f"the clock went back by {-jump.delta.nanoseconds * 1e-9:.3f} s: starting again at the "
            "origin, with the learnt parameters"
        )
        self.live.restart(self._now())

    def _now(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    # --- outputs -----------------------------------------------------------------------------------

    def _publish(self, estimates: list[LiveEstimate]) -> None:
        options = self.options
        for estimate in estimates:
            odometry = self._new(ros.ODOMETRY)
            planar = options.two_d_mode
            fill_odometry(odometry, estimate, options.odom_frame, options.base_frame, planar=planar)
            self._odometry.publish(odometry)
            if self._tf is not None and (transforms := self._transforms(estimate)):
                message = self._new(ros.TF)
                message.transforms = transforms
                self._tf.publish(message)
            in_map = estimate.in_map(planar=planar)
            if self._map_pose is not None and in_map is not None:
                pose = self._new(ros.POSE_WITH_COVARIANCE)
                self._map_pose.publish(fill_pose(pose, estimate.stamp, options.map_frame, in_map))
            if abs(estimate.stamp - self._last_slow) >= PERIOD * 1e9:
                self._last_slow = estimate.stamp
                self._publish_slowly(estimate)

    def _transforms(self, estimate: LiveEstimate) -> list[Any]:
        """Transforms from odom to base and, once there are fixes, from map to odom."""
        options, planar = self.options, self.options.two_d_mode
        links = []
        if options.publish_tf:
            pose = estimate.in_odom(planar=planar)
            links.append((options.odom_frame, options.base_frame, pose))
        if options.publish_map_tf and (odom := estimate.odom_in_map(planar=planar)) is not None:
            links.append((options.map_frame, options.odom_frame, odom))
        return [fill_transform(self._new(ros.TRANSFORM), estimate.stamp, *link) for link in links]

    def _publish_slowly(self, estimate: LiveEstimate) -> None:
        """Publish slip and ICR markers."""
        live = self.live
        if live.tracks is not None:
            statuses = self._slip_watch.look(live.newest, live.tracks)
            self._publish_statuses(self._slip, estimate.stamp, statuses)
        if self._markers is not None:
            points = icr_points(estimate.indices, live.robot.vehicle.track_gauge)
            icrs = IcrPoints(*(live.base.point(x, y) for x, y in points))
            array = self._new(ros.MARKERS)
            fill_icr_markers(array, estimate.stamp, self.options.base_frame, icrs, self._new)
            self._markers.publish(array)

    def _publish_statuses(
        self, publisher: Any, stamp: int, statuses: list[DiagnosticStatus]
    ) -> None:
        array, name = self._new(ros.DIAGNOSTICS), self.live.robot.name
        publisher.publish(fill_diagnostics(array, stamp, statuses, name, self._new))

    def _report(self) -> None:
        self._warn_of_silence()
        now = self._now()
        self._publish_statuses(self._diagnostics, now, self._statuses.report())
        if self.live.odom.stamp is not None:
            self._publish_statuses(self._learnt, now, parameter_statuses(self.live.newest))

    def _place_of_frame(self, frame: str) -> Pose:
        """Pose of a frame of fixes in map: level, that of /tf_static if known."""
        options = self.options
        if frame in ("", options.map_frame, options.odom_frame):
            return CENTRE
        if (pose := self._frames.pose(options.map_frame, frame)) is not None:
            (x, y, _), rotation = pose
            return (float(x), float(y), float(matrix_to_rpy(rotation)[2]))
        self._warn(
            f"fixes are in frame {frame!r}, and are taken as poses in {options.map_frame!r}: set "
            f"map_frame to {frame!r}, or publish their transform on /tf_static"
        )
        return CENTRE

    def _warn_of_silence(self) -> None:
        """Warn of topics on which nothing comes, and of joints that are in no message."""
        waited, inputs = time.monotonic() - self._started, self.live.inputs
        if text := inputs.missing_joints(self._now()):
            self._warn(text)
        if waited < SILENCE:
            return
        for subscription in self._silent:
            # A robot may have no static transforms.
            if subscription.topic in inputs.heard or subscription.latched:
                continue
            own = {publisher.topic_name for publisher in self.node.publishers}
            others = {
                name: types
                for name, types in self.node.get_topic_names_and_types()
                if name not in own and self.node.count_publishers(name)
            }
            topic = self.node.resolve_topic_name(subscription.topic)
            fitting = inputs.fitting_types(subscription)
            self._warn(silent_topic(subscription.purpose, topic, fitting, others, waited))
        self._silent.clear()

    # --- services ----------------------------------------------------------------------------------

    def _on_save(self, _: Any, response: Any) -> Any:
        problem: str | None = "give the parameter state_file"
        if self._state_file is not None:
            problem = self._save_learnt()
        response.success = problem is None
        response.message = problem or f"saved to {self._state_file}"
        return response

    def _on_reset(self, _: Any, response: Any) -> Any:
        self.live.restart()
        self._warn(self.live.set_aside)
        response.success = True
        response.message = "started again at the origin, with the learnt parameters"
        return response

    def _save_learnt(self) -> str | None:
        """Write the state file; return the problem if it cannot be written, else None."""
        if self._state_file is None:
            return None  # nothing is to be saved
        if self.live.odom.stamp is None:
            return "nothing learnt yet"
        try:
            self._state_file.parent.mkdir(parents=True, exist_ok=True)
            self.live.save(self._state_file)
        except (IcreckonError, OSError) as problem:
            self._warn(f"learnt parameters not saved: {problem}")
            return str(problem)
        return None

    def _warn(self, problem: str) -> None:
        """Log a problem, if there is one, once."""
        if problem and problem not in self._problems:
            self._problems.add(problem)
            self._log.warning(problem)
