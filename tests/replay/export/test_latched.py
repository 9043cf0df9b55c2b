"""Topics with one message for all of a bag are latched: a viewer that starts late gets it, too."""

from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

import icreckon
from icreckon.replay.bags.writer import Format
from icreckon.replay.export.log_bag import write_log
from icreckon.replay.export.replay_bag import write_replay_bag

ROBOT = icreckon.load_robot("jackal")
ONCE = {"/icreckon/topics", "/ground_truth/source", "/gyro/path", "/ground_truth/path"}


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_they_are(kind: Format, tmp_path: Path) -> None:
    log = icreckon.simulate(icreckon.Scenario(duration=3.0), ROBOT)
    bags = [write_log(log, tmp_path / "log", kind, ROBOT)]
    if kind != "sqlite3":
        bags.append(tmp_path / ("odometry.mcap" if kind == "mcap" else "odometry.bag"))
        write_replay_bag(bags[1], kind, icreckon.compare(log, ROBOT, "gyro"), ROBOT)
    latched, others = set(), set()
    for bag in bags:
        with AnyReader([bag]) as reader:
            for one in reader.connections:
                if kind == "ros1":
                    is_latched = bool(one.ext.latching)
                else:
                    profiles = one.ext.offered_qos_profiles
                    durabilities = {profile.durability for profile in profiles}
                    is_latched = durabilities == {QosDurability.TRANSIENT_LOCAL}
                (latched if is_latched else others).add(one.topic)
    assert latched == {topic for topic in ONCE if kind != "sqlite3" or "path" not in topic}
    assert {"/imu/data", "/joint_states"} <= others
