"""What broken messages do to a replay: the end pose against that of the same log unbroken.

    python benchmarks/broken_input.py [LOG --robot ROBOT] [--variants ...]

A log (a simulated drive of Auriga-alpha of two minutes, unless another is given) is written as a bag,
message by message, with one fault each time, in track speeds and IMU, and replayed from its start without
fixes. Told are how far apart the end poses are, in metres and degrees and as the largest share of the 3
sigma that the broken run reports of itself, and what the report counts. "Headers" have the fault in the
stamps of the headers alone, as where a driver's clock is at fault; "clock" in the times of recording too,
as where the computer's is. Last, how far 60 s of standstill drift.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from _study import script_parser, table
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.run import run
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

SECOND = 1_000_000_000
SEED = 6
# Of the robot that stands: what it has is to be found out [rad/s].
GYRO_BIAS = np.array([0.0, 0.0, 0.003])
TOPICS = {"tracks": "/joint_states", "imu": "/imu/data_raw"}


@dataclass(frozen=True)
class Messages:
    """Messages of one topic in the order in which they were recorded.

    Attributes:
        header: (n,) stamps of the headers [ns].
        recorded: (n,) times of recording [ns].
        values: (n, 2) track speeds in rad/s, or (n, 6) angular velocity and specific force.
    """

    header: Any
    recorded: Any
    values: Any

    @property
    def middle(self) -> int:
        """Place of the message in the middle."""
        return len(self.header) // 2

    def with_stamp(self, place: int, stamp: int) -> Messages:
        """One header stamp replaced."""
        header = self.header.copy()
        header[place] = stamp
        return replace(self, header=header)

    def with_value(self, place: int, value: float) -> Messages:
        """All numbers of one message replaced."""
        values = self.values.copy()
        values[place] = value
        return replace(self, values=values)

    def shifted_from(self, place: int, by: int, *, recorded: bool) -> Messages:
        """All stamps from one message on moved by `by` [ns]."""
        header, times = self.header.copy(), self.recorded.copy()
        header[place:] += by
        if recorded:
            times[place:] += by
        return replace(self, header=header, recorded=times)

    def taken(self, places: Any) -> Messages:
        """Messages at these places."""
        return Messages(self.header[places], self.recorded[places], self.values[places])


Fault = Callable[[Messages], Messages]


def _one_value(value: float) -> Fault:
    return lambda given: given.with_value(given.middle, value)


def _one_stamp(seconds: float) -> Fault:
    def hurt(given: Messages) -> Messages:
        stamp = given.header[given.middle] + int(seconds * SECOND)
        return given.with_stamp(given.middle, stamp)

    return hurt


def _step(seconds: float, *, recorded: bool) -> Fault:
    def hurt(given: Messages) -> Messages:
        # At one time for all topics.
        place = int(
            np.searchsorted(given.recorded, given.recorded[given.middle] // SECOND * SECOND)
        )
        return given.shifted_from(place, int(seconds * SECOND), recorded=recorded)

    return hurt


def _twice(given: Messages) -> Messages:
    return given.taken(np.repeat(np.arange(len(given.header)), 2))


def _other_value(given: Messages) -> Messages:
    places = np.arange(len(given.header))
    doubled = given.taken(np.insert(places, given.middle + 1, given.middle))
    return doubled.with_value(given.middle + 1, 0.3)


def _gap(after_middle: float) -> Fault:
    def hurt(given: Messages) -> Messages:
        middle = given.recorded[0] + (given.recorded[-1] - given.recorded[0]) // 2
        begin = middle + int(after_middle * SECOND)
        return given.taken((given.recorded < begin) | (given.recorded > begin + 2 * SECOND))

    return hurt


def spike(robot: Robot) -> dict[str, Fault]:
    """30 m/s of both tracks, 20 rad/s about all axes, in a single message."""
    speed = 30.0 / robot.vehicle.sprocket_radius
    return {"tracks": _one_value(speed), "imu": _one_value(20.0)}


FAULTS: dict[str, Fault] = {
    "one NaN": _one_value(np.nan),
    "one infinite value": _one_value(np.inf),
    "one stamp 0.1 s in the past": _one_stamp(-0.1),
    "one stamp 1 s in the past": _one_stamp(-1.0),
    "one stamp 30 s in the past": _one_stamp(-30.0),
    "headers step back 5 s for good": _step(-5.0, recorded=False),
    "clock steps back 5 s for good": _step(-5.0, recorded=True),
    "headers step an hour forward": _step(3600.0, recorded=False),
    "clock steps an hour forward": _step(3600.0, recorded=True),
    "every message twice": _twice,
    "same stamp, another value": _other_value,
    "gap of 2 s": _gap(0.0),
    "gap of 2 s in a turn": _gap(11.3),
}


def messages_of(log: Log, robot: Robot) -> dict[str, Messages]:
    """Track speeds and IMU samples of a log as messages, recorded 5 ms after they were measured."""
    imu = log.imu
    if imu is None or imu.linear_acceleration is None:
        raise ValueError(f"{log.name} has no IMU with accelerometers")
    rates = log.tracks.speeds / robot.vehicle.sprocket_radius
    readings = np.hstack([imu.angular_velocity, imu.linear_acceleration])
    late = 5_000_000
    return {
        "tracks": Messages(log.tracks.stamps, log.tracks.stamps + late, rates),
        "imu": Messages(imu.stamps, imu.stamps + late, readings),
    }


def write_bag(folder: Path, streams: dict[str, Messages]) -> Path:
    """An MCAP bag of these messages, in the order of recording."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    header_of, time_of = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    names = {"tracks": "sensor_msgs/msg/JointState", "imu": "sensor_msgs/msg/Imu"}
    none = np.zeros(0)

    def made(kind: str, stamp: int, values: Any) -> Any:
        header = header_of(time_of(stamp // SECOND, stamp % SECOND), "base_link")
        if kind == "tracks":
            return kinds[names[kind]](header, ["left", "right"], none, values, none)
        vector = kinds["geometry_msgs/msg/Vector3"]
        absent = np.array([-1.0, *np.zeros(8)])
        return kinds[names[kind]](
            header,
            kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            absent,
            vector(*values[:3]),
            np.zeros(9),
            vector(*values[3:]),
            np.zeros(9),
        )

    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            kind: writer.add_connection(TOPICS[kind], names[kind], typestore=store)
            for kind in streams
        }
        # Each topic in its own order, topics merged by how far they are.
        order = sorted(
            (place / len(given.header), kind, place)
            for kind, given in streams.items()
            for place in range(len(given.header))
        )
        for _, kind, place in order:
            given = streams[kind]
            message = made(kind, int(given.header[place]), given.values[place])
            raw = store.serialize_cdr(message, names[kind])
            writer.write(connections[kind], int(given.recorded[place]), raw)
    return folder


def mapped(robot: Robot) -> Robot:
    """The robot with the topics of `write_bag`."""
    tracks = {"topic": TOPICS["tracks"], "left": ["left"], "right": ["right"]}
    return msgspec.structs.replace(robot, log={"tracks": tracks, "imu": {"topic": TOPICS["imu"]}})


@dataclass(frozen=True)
class Outcome:
    """A broken run against the unbroken one.

    Attributes:
        metres: how far apart they end [m].
        degrees: difference of their yaw [deg].
        share: the largest error of x, y and yaw over 3 sigma of the broken run [-].
        told: what was counted and noted.
    """

    metres: float
    degrees: float
    share: float
    told: tuple[str, ...]


def outcome(log: Log, broken: Run, whole: Run) -> Outcome:
    """How the ends of two runs differ, and what the log and its run say of it."""
    apart = broken.trajectory.poses[-1] - whole.trajectory.poses[-1]
    apart[2] = wrap_angle(apart[2])
    sigma = np.sqrt(np.diagonal(broken.trajectory.pose_covariances[-1]))
    counted = {**log.dropped, **broken.health.rejections()}
    told = [f"{count} x {what}" for what, count in counted.items()] + list(log.notes)
    if broken.health.track_gaps:
        told.append(f"{broken.health.track_gaps} gaps of the tracks bridged")
    return Outcome(
        float(np.hypot(*apart[:2])),
        float(np.degrees(abs(apart[2]))),
        float(np.max(np.abs(apart) / (3.0 * sigma))),
        tuple(told),
    )


def broken_runs(
    log: Log, robot: Robot, variant: str, folder: Path, names: list[str] | None = None
) -> dict[str, Outcome]:
    """Replays of a log with each fault; by fault and stream."""
    streams, robot = messages_of(log, robot), mapped(robot)
    whole = run(read_log(write_bag(folder / "whole", streams), robot), robot, variant)
    cases: dict[str, dict[str, Fault]] = {
        name: {"tracks": fault, "imu": fault} for name, fault in FAULTS.items()
    }
    cases["spike of 30 m/s and 20 rad/s"] = spike(robot)
    found = {}
    for name, faults in cases.items():
        if names is not None and name not in names:
            continue
        hurt = {kind: faults[kind](given) for kind, given in streams.items()}
        path = write_bag(folder / name.replace(" ", "-"), hurt)
        broken = read_log(path, robot)
        found[name] = outcome(broken, run(broken, robot, variant), whole)
    return found


def standstill_drift(robot: Robot, variant: str, seconds: float = 60.0) -> tuple[float, float]:
    """Drift of a robot that has driven and stands: metres, and degrees of yaw."""
    driving = simulate(Scenario(duration=30.0, seed=SEED), robot)
    imu, rng = driving.imu, np.random.default_rng(SEED)
    if imu is None or imu.linear_acceleration is None:
        raise ValueError("the simulated log has no IMU")
    count, step = int(seconds * 100), SECOND // 100
    stamps = driving.end + step * np.arange(1, count + 1)
    noise = 10.0 * robot.imu.gyro_noise_density * rng.standard_normal((count, 3))
    forces = np.tile([0.0, 0.0, 9.81], (count, 1)) + 0.02 * rng.standard_normal((count, 3))
    stopped = replace(
        driving,
        tracks=TrackSpeedSeries(
            np.concatenate([driving.tracks.stamps, stamps[::2]]),
            np.concatenate([driving.tracks.speeds, np.zeros((len(stamps[::2]), 2))]),
        ),
        imu=ImuSeries(
            np.concatenate([imu.stamps, stamps]),
            np.concatenate([imu.angular_velocity, noise + GYRO_BIAS]),
            np.concatenate([imu.linear_acceleration, forces]),
        ),
    )
    found = run(stopped, robot, variant).trajectory
    # From when it has come to rest.
    stood = int(np.searchsorted(found.stamps, driving.end + 2 * SECOND))
    moved = found.poses[-1] - found.poses[stood]
    return float(np.hypot(*moved[:2])), float(abs(np.degrees(moved[2])))


def main() -> None:
    """Print the table."""
    parser = script_parser(__doc__)
    parser.add_argument("log", type=Path, nargs="?")
    parser.add_argument("--robot", default="auriga-alpha")
    parser.add_argument("--variants", nargs="+", default=["inertia-online"], choices=VARIANTS)
    arguments = parser.parse_args()
    robot = load_robot(arguments.robot)
    if arguments.log is None:
        log = replace(simulate(Scenario(duration=120.0, seed=SEED), robot), fixes=None)
    else:
        log = read_log(arguments.log, robot)
    for variant in arguments.variants:
        print(f"{variant}, {log.name}, {log.duration:.0f} s", file=sys.stderr)
        with tempfile.TemporaryDirectory() as folder:
            found = broken_runs(log, robot, variant, Path(folder))
        rows = [
            [
                name,
                f"{one.metres:.3f}",
                f"{one.degrees:.2f}",
                f"{one.share:.2f}",
                "; ".join(one.told),
            ]
            for name, one in found.items()
        ]
        table(["fault", "m", "deg", "of 3 sigma", "told"], rows)
        metres, degrees = standstill_drift(load_robot("auriga-alpha"), variant)
        print(f"\nstanding for 58 s: {1e3 * metres:.3f} mm, {degrees:.4f} deg")


if __name__ == "__main__":
    main()
