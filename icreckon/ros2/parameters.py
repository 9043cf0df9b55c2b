"""Parameters of the node: names, defaults and descriptions."""

import math
from array import array
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, get_args

import msgspec

from icreckon.estimator.base.checks import Bound, check_bounds
from icreckon.estimator.base.config import in_words
from icreckon.estimator.base.errors import EstimatorError, nearest_hint
from icreckon.replay.live.base_frame import CENTRE, Pose

FULL_TURN = 2.0 * math.pi
Reliability = Literal["auto", "reliable", "best_effort"]


class NodeOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Values of the node's parameters; `DESCRIPTIONS` describes each."""

    robot: str = ""
    variant: str = "inertia-online"
    odom_frame: str = "odom"
    base_frame: str = "base_link"
    map_frame: str = "map"
    publish_tf: bool = True
    publish_map_tf: bool = True
    use_fixes: bool = True
    two_d_mode: bool = True
    highest_rate: Annotated[float, Bound("from 0 to 10000", 0.0, 10_000.0)] = 0.0
    reorder: Annotated[float, Bound("from 0 to 10", 0.0, 10.0)] = 0.0
    diagnostics_rate: Annotated[float, Bound("from 0.01 to 100", 0.01, 100.0)] = 1.0
    icr_markers: bool = False
    state_file: str = ""
    save_period: Annotated[float, Bound("from 1 to 86400", 1.0, 86_400.0)] = 60.0
    input_reliability: Reliability = "auto"
    input_depth: Annotated[int, Bound("from 1 to 100000", 1, 100_000)] = 100
    start_pose: tuple[float, ...] = ()
    base_offset: tuple[float, ...] = CENTRE
    mounting_from_tf: bool = False

    def __post_init__(self) -> None:
        if not self.robot:
            raise EstimatorError(
                "parameter robot: give a robot file or the name of a robot that ships with icreckon, "
                "as `icreckon ros2-node --robot robot.toml` or -p robot:=robot.toml"
            )
        check_bounds(self, "parameter {}", EstimatorError)
        if self.start_pose:
            self._pose("start_pose")
        self._pose("base_offset")
        frames = (self.odom_frame, self.base_frame, self.map_frame)
        if not all(frames) or len(set(frames)) < len(frames):
            raise EstimatorError(
                f"parameters odom_frame, base_frame and map_frame must differ, found {frames}"
            )

    @property
    def start(self) -> Pose | None:
        """The parameter start_pose; None if it is not given."""
        return self._pose("start_pose") if self.start_pose else None

    @property
    def base(self) -> Pose:
        """The parameter base_offset."""
        return self._pose("base_offset")

    def _pose(self, name: str) -> Pose:
        """Value of a parameter that is a pose, checked; an EstimatorError if it is none."""
        values = getattr(self, name)
        if len(values) != 3 or not all(map(math.isfinite, values)):
            raise EstimatorError(
                f"parameter {name} must be three numbers, x, y [m] and yaw [rad], found {list(values)!r}"
            )
        x, y, yaw = values
        if abs(yaw) > FULL_TURN:
            raise EstimatorError(
                f"parameter {name}: a yaw of {yaw:g} rad is more than a full turn; is it in degrees? "
                f"That would be {math.radians(yaw):.5g} rad"
            )
        return (x, y, yaw)


DESCRIPTIONS: Mapping[str, str] = {
    "robot": "Robot file, or name of a robot that ships with icreckon; its [log] names the topics.",
    "variant": "Filter variant, see `icreckon replay --help`.",
    "odom_frame": "Frame of the odometry.",
    "base_frame": "Frame of the robot.",
    "map_frame": "Frame of the fixes.",
    "publish_tf": "Publish the transform from odom_frame to base_frame.",
    "publish_map_tf": "Publish the transform from map_frame to odom_frame once there are fixes.",
    "use_fixes": "Use the robot file's [log.fixes] and [log.heading] for the pose in map_frame.",
    "two_d_mode": "Publish planar poses and twists; false adds height, roll and pitch.",
    "highest_rate": "Highest rate of the odometry [Hz]; 0 for one at each IMU sample.",
    "reorder": "Time for which measurements are held to be put in order [s]; 0 for none.",
    "diagnostics_rate": "Rate of /diagnostics [Hz].",
    "icr_markers": "Publish the ICRs of both tracks as markers.",
    "state_file": "File of learnt parameters: read at the start, written while running and at the end.",
    "save_period": "Time between two writings of state_file [s].",
    "input_reliability": "QoS of the inputs: reliable, best_effort, or auto, that of the publishers.",
    "input_depth": "Length of the queue of each input.",
    "start_pose": "Pose of the base frame in map_frame at the start, [x, y, yaw] in m, rad; [] for none.",
    "base_offset": "Base frame on the robot, [forward, left, yaw] from the tracks' centre [m, rad].",
    "mounting_from_tf": "Take the IMU's mounting from its frame_id and /tf_static, not the robot file.",
}

OF_ROS = ("use_sim_time", "start_type_description_service")  # parameters that each node has
OF_QOS = "qos_overrides."  # beginning of parameters that set the QoS of topics
QOS_POLICIES: Mapping[str, tuple[str, ...]] = {
    "history": ("keep_last", "keep_all", "system_default"),
    "depth": (),
    "reliability": ("reliable", "best_effort", "system_default"),
    "durability": ("volatile", "transient_local", "system_default"),
}
"""Policies that can be set, and their values; a depth is a whole number."""


def constraints(name: str) -> str:
    """Values that a parameter may have, as `ros2 param describe` shows; empty for any."""
    parts = get_args(NodeOptions.__annotations__[name])
    choices = ", ".join(part for part in parts if isinstance(part, str))
    return next((part.wanted for part in parts if isinstance(part, Bound)), choices)


def unknown_parameters(given: Iterable[str]) -> list[str]:
    """Text on each parameter that the node does not have."""
    known = list(DESCRIPTIONS)
    return [_unknown(name, known) for name in sorted(given) if name not in (*known, *OF_ROS)]


def check_qos(given: Mapping[str, Any], endpoints: Iterable[str]) -> list[str]:
    """Check the values of parameters that set the QoS of topics.

    `endpoints` are the topics of the node, as "/odom.publisher". Returns a text on each parameter that
    the node does not have.

    Raises:
        EstimatorError: a value is invalid.
    """
    policies = {
        f"{OF_QOS}{endpoint}.{policy}": policy for endpoint in endpoints for policy in QOS_POLICIES
    }
    for name, value in given.items():
        policy = policies.get(name)  # None for a parameter without effect, which is reported below
        if policy == "depth" and (type(value) is not int or value < 0):  # True is an int, too
            raise EstimatorError(f"parameter {name} must be a whole number, found {value!r}")
        if (names := QOS_POLICIES.get(policy or "")) and value not in names:
            raise EstimatorError(
                f"parameter {name} {value!r}{nearest_hint(str(value), list(names))}"
            )
    return [_unknown(name, list(policies)) for name in sorted(given) if name not in policies]


def _unknown(name: str, known: list[str]) -> str:
    return f"parameter {name!r} is unknown and has no effect{nearest_hint(name, known)}"


def options_from(values: Mapping[str, Any]) -> NodeOptions:
    """Check and convert the values of the parameters.

    Raises:
        EstimatorError: a value is invalid.
    """
    # Arrays of ROS are no sequences for msgspec.
    plain = {
        name: list(value) if isinstance(value, array) else value for name, value in values.items()
    }
    try:
        return msgspec.convert(plain, NodeOptions)
    except msgspec.ValidationError as problem:
        text = in_words(str(problem), plain, NodeOptions)
        raise EstimatorError(f"parameters of the node: {text}") from None
