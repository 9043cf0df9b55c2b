"""A live run equals the replay of its bag, however its messages come."""

from collections.abc import Iterable, Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from conftest import simulated
from icreckon import EstimatorError, Log, Robot, Settings, read_log, run
from icreckon.estimator.base.frames import relative, wrap_angle
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.streaming.save import VERSION
from icreckon.replay.live.diagnostic_status import ERROR, OK, STALE, WARN, DiagnosticStatus
from icreckon.replay.live.inputs import Subscription
from icreckon.replay.live.odometry import LiveEstimate, LiveOdometry, live_topics
from icreckon.replay.live.statuses import LiveStatuses

VARIANT = "constant-online"
SETTINGS = Settings()
SECONDS = 8.0
DAY = 86_400


class Arrived(NamedTuple):
    """A message of a bag, as `LiveOdometry.take` wants it."""

    topic: str
    msgtype: str
    message: Any
    arrival: int


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("live") / "bag"
    return simulated(path, SECONDS, seed=4, trajectory="slalom", fix_rate=2.0)


@pytest.fixture(scope="module")
def messages(bag: Path, robot: Robot) -> list[Arrived]:
    topics = {
        one.topic for one in LiveOdometry(robot, VARIANT, settings=SETTINGS).inputs.subscriptions()
    }
    with AnyReader([bag]) as reader:
        wanted = [one for one in reader.connections if one.topic in topics]
        return [
            Arrived(one.topic, one.msgtype, reader.deserialize(raw, one.msgtype), when)
            for one, when, raw in reader.messages(wanted)
        ]


@pytest.fixture(scope="module")
def log(bag: Path, robot: Robot) -> Log:
    return read_log(bag, robot)


@pytest.fixture
def live(robot: Robot) -> LiveOdometry:
    return LiveOdometry(robot, VARIANT, settings=SETTINGS)


def named(statuses: LiveStatuses) -> dict[str, DiagnosticStatus]:
    """Statuses of a report by their names."""
    return {one.name.removeprefix("icreckon: "): one for one in statuses.report()}


def subscriptions(live: LiveOdometry) -> dict[str, Subscription]:
    return {one.topic: one for one in live.inputs.subscriptions()}


def through(live: LiveOdometry, messages: Iterable[Arrived]) -> Iterator[LiveEstimate]:
    topics, when = subscriptions(live), 0
    for topic, msgtype, message, when in messages:
        if topic in topics:
            yield from live.take(topics[topic], msgtype, message, when)
    yield from live.flush(when)


@pytest.fixture(scope="module")
def state_file(robot, messages, tmp_path_factory):
    path = tmp_path_factory.mktemp("state") / "state.json"
    live = LiveOdometry(robot, VARIANT, settings=SETTINGS)
    list(through(live, messages))
    live.save(path)
    return path.read_bytes()


def live_run(robot: Robot, messages: Iterable[Arrived], **options: Any) -> list[LiveEstimate]:
    live = LiveOdometry(robot, VARIANT, settings=SETTINGS, **options)
    return list(through(live, messages))


def shuffled(messages: list[Arrived], seconds: float) -> list[Arrived]:
    """Messages that arrive late by up to some time, each by another."""
    delays = np.random.default_rng(7).uniform(0.0, seconds, len(messages)) * 1e9
    arrivals = np.array([one.arrival for one in messages]) + delays
    return [messages[place] for place in np.argsort(arrivals)]


@pytest.mark.parametrize("fixes", [False, True])
@pytest.mark.parametrize("disorder", [0.0, 0.08])
def test_equals_the_replay(fixes, disorder, robot, log, messages):
    estimates = live_run(robot, shuffled(messages, disorder), reorder=0.1, use_fixes=fixes)
    stamps = [one.stamp for one in estimates]
    assert stamps == sorted(set(stamps))
    rows = {one.stamp: one for one in estimates}
    alone = run(replace(log, fixes=None), robot, VARIANT, settings=SETTINGS)
    assert len(alone.stamps) > 350
    for k, stamp in enumerate(alone.stamps.tolist()):
        one, trajectory = rows[stamp], alone.trajectory
        assert one.pose == pytest.approx(trajectory.poses[k], abs=1e-9)
        assert one.pose_covariance == pytest.approx(
            trajectory.pose_covariances[k], rel=1e-9, abs=1e-12
        )
        assert one.twist == pytest.approx(trajectory.twists[k], abs=1e-9)
        assert one.twist_covariance == pytest.approx(trajectory.twist_covariances[k], rel=1e-9)
    if not fixes:
        assert all(one.map_pose is None for one in estimates)
        return
    fused = run(log, robot, VARIANT, settings=SETTINGS)
    assert np.abs(fused.trajectory.poses[-1] - alone.trajectory.poses[-1]).max() > 0.01
    for k, stamp in enumerate(fused.stamps.tolist()):
        if stamp >= log.fixes.stamps[0]:
            assert rows[stamp].map_pose == pytest.approx(fused.trajectory.poses[k], abs=1e-9)


def test_late_messages_correct_the_estimate_at_once(robot: Robot, messages: list[Arrived]) -> None:
    in_order = live_run(robot, messages, use_fixes=False)
    late = LiveOdometry(robot, VARIANT, settings=SETTINGS, use_fixes=False)
    estimates = list(through(late, shuffled(messages, 0.08)))
    assert late.odom.health.sensors["tracks"].late > 50
    assert late.odom.pose == pytest.approx(in_order[-1].pose, abs=1e-9)
    assert [one.stamp for one in estimates] == sorted({one.stamp for one in estimates})


def test_the_rate_is_limited(robot: Robot, messages: list[Arrived]) -> None:
    estimates = live_run(robot, messages, highest_rate=10.0, use_fixes=False)
    assert len(estimates) == pytest.approx(10.0 * SECONDS, abs=2)


def test_a_restart_begins_at_the_origin_with_the_learnt(live, messages):
    list(through(live, messages))
    learnt = live.odom.parameters | live.odom.biases
    assert np.hypot(*live.odom.pose[:2]) > 0.5
    assert learnt["gyro_bias"] != 0.0
    live.restart()
    assert live.odom.stamp is None
    assert live.odom.parameters | live.odom.biases == learnt
    # The same messages again: the clock went back.
    again = list(through(live, messages))
    assert again[0].stamp < messages[20].arrival
    assert np.hypot(*again[0].pose[:2]) < 0.01


def test_messages_left_over_from_before_the_clock_went_back_are_dropped(live, messages):
    list(through(live, messages))
    begin = messages[0].arrival
    live.restart(begin)
    left_over = [one._replace(arrival=begin) for one in messages[-20:]]
    estimates = list(through(live, [*left_over, *messages[:300]]))
    assert max(one.stamp for one in estimates) < messages[320].arrival
    assert sum(live.inputs.lost.values()) == len(left_over)


def without_stamp(one: Arrived) -> Arrived:
    message = deepcopy(one.message)
    message.header.stamp.sec = message.header.stamp.nanosec = 0
    return one._replace(message=message)


@pytest.mark.parametrize("streams", ["imu joint_states", "imu joint_states fix", "joint_states"])
def test_messages_with_a_stamp_of_zero_go_by_their_arrival(live, robot, messages, streams):
    """A tenth of a second of them under way; the clock of the headers may be another."""
    sent = [one._replace(arrival=one.arrival - 100 * DAY * 10**9) for one in messages]
    sound = live_run(robot, sent)[-1]
    begin = sent[0].arrival + 4 * 10**9
    sent = [
        without_stamp(one)
        if one.topic.split("/")[1] in streams and 0 <= one.arrival - begin <= 10**8
        else one
        for one in sent
    ]
    last = list(through(live, sent))[-1]
    assert live.odom.health.clock_steps == 0
    assert last.stamp == sound.stamp
    assert last.pose == pytest.approx(sound.pose, abs=1e-3)
    assert last.pose_covariance == pytest.approx(sound.pose_covariance, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("late", ["imu", "fix"])
def test_a_stream_that_starts_late_by_another_clock_goes_by_its_arrival(robot, messages, late):
    start = messages[0].arrival + 4 * 10**9
    sent = [one for one in messages if late not in one.topic or one.arrival > start]
    sound = live_run(robot, sent)[-1]
    moved = []
    for one in sent:
        message = deepcopy(one.message)
        if late in one.topic:
            message.header.stamp.sec -= 100 * DAY
        moved.append(one._replace(message=message))
    last = live_run(robot, moved)[-1]
    assert last.pose == pytest.approx(sound.pose, abs=1e-6)
    assert last.map_pose == pytest.approx(sound.map_pose, abs=1e-6)


def test_the_clock_of_messages_without_stamps_may_be_set(robot, messages):
    """That of the system, which stamps their arrival; the steady one goes on."""
    sound = live_run(robot, messages)[-1]
    live, estimates = LiveOdometry(robot, VARIANT, settings=SETTINGS), []
    for one in map(without_stamp, messages):
        ahead = 3 * 10**17 if one.arrival - messages[0].arrival > 4 * 10**9 else 0
        topic, steady = subscriptions(live)[one.topic], one.arrival
        estimates += live.take(topic, one.msgtype, one.message, steady + ahead, steady)
    last = estimates[-1]
    assert live.odom.health.clock_steps == 1
    assert last.pose == pytest.approx(sound.pose, abs=1e-3)
    assert last.pose_covariance == pytest.approx(sound.pose_covariance, rel=1e-2, abs=1e-9)


@pytest.mark.parametrize(
    "ahead",
    [
        lambda at: 0 if at < 4.0 else 3600,
        lambda at: 0 if at < 4.0 else 5,
        lambda at: -1_600_000_000 if at < 3.0 else 0,
        lambda at: -3600 if 3.0 <= at < 6.0 else 0,
    ],
    ids=["an hour", "five seconds", "from the seventies", "back and forth"],
)
def test_the_pose_goes_on_where_a_clock_is_set(ahead, robot, messages):
    def driven(ahead):
        live = LiveOdometry(robot, VARIANT, settings=SETTINGS, use_fixes=False)
        topics = subscriptions(live)
        for one in messages:
            by, message = ahead((one.arrival - messages[0].arrival) * 1e-9), deepcopy(one.message)
            message.header.stamp.sec += by
            if one.topic in topics:
                # The system's clock is set with the stamps; the steady one is not.
                arrival = one.arrival + by * 10**9
                list(live.take(topics[one.topic], one.msgtype, message, arrival, one.arrival))
        list(live.flush(one.arrival))
        return live.odom

    usual, stepped = driven(lambda _: 0), driven(ahead)
    assert stepped.health.clock_steps >= 1 > usual.health.clock_steps
    assert stepped.stamp - usual.stamp == pytest.approx(ahead(SECONDS) * 10**9, abs=10**8)
    assert np.hypot(*(stepped.pose - usual.pose)[:2]) < 0.02
    sigmas = (np.sqrt(np.diagonal(one.pose_covariance)) for one in (stepped, usual))
    assert next(sigmas) == pytest.approx(next(sigmas), rel=1e-6)
    for name, health in usual.parameter_health.items():
        share = stepped.parameter_health[name].share
        assert share == pytest.approx(health.share, abs=0.1, nan_ok=True)


def test_a_saved_run_starts_warm(robot: Robot, messages: list[Arrived], tmp_path: Path) -> None:
    live = LiveOdometry(robot, VARIANT, settings=SETTINGS, saved=tmp_path / "state.json")
    assert not live.warm
    list(through(live, messages))
    live.save(tmp_path / "state.json")
    warm = LiveOdometry(robot, VARIANT, settings=SETTINGS, saved=tmp_path / "state.json")
    assert warm.warm
    assert warm.odom.stamp is None
    assert warm.odom.parameters == live.map.estimator.parameters


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[: len(content) // 2],
        lambda _: b"",
        lambda _: b"\x00\xff{]",
        lambda content: content.replace(b'"version": %d' % VERSION, b'"version": 11'),
        lambda content: content.replace(b"constant-online", b"inertia-online"),
        lambda content: content.replace(b"[", b"[" * 10_000),
    ],
    ids=["truncated", "empty", "garbage", "version", "by hand", "deep"],
)
def test_a_state_file_that_cannot_be_used_is_set_aside(damage, robot, state_file, tmp_path):
    path, earlier = tmp_path / "state.json", tmp_path / "state.json.unusable-1"
    earlier.write_bytes(b"earlier")
    path.write_bytes(damage(state_file))
    live = LiveOdometry(robot, VARIANT, settings=SETTINGS, saved=path)
    assert not live.warm
    aside = tmp_path / "state.json.unusable-2"
    assert f"{path} is set aside as {aside}" in live.set_aside
    assert aside.read_bytes() == damage(state_file)
    assert earlier.read_bytes() == b"earlier"
    assert not path.exists()


@pytest.mark.parametrize("entry", [1e9, np.nan])
def test_a_lost_filter_is_an_error_and_is_not_saved(entry, robot, messages, state_file, tmp_path):
    path = tmp_path / "state.json"
    path.write_bytes(state_file)
    live = LiveOdometry(robot, VARIANT, settings=SETTINGS, saved=path, use_fixes=False)
    list(through(live, messages[:300]))
    live.odom._reckoning.ekf.P[0, 0] = entry
    pose = named(LiveStatuses(live))["pose in odom"]
    assert pose.level == ERROR
    assert "~/reset" in pose.message
    with pytest.raises(EstimatorError, match="not written, the filter is lost"):
        live.save(path)
    assert path.read_bytes() == state_file
    live.restart()
    assert live.warm
    last = list(through(live, messages))[-1]
    assert np.sqrt(last.pose_covariance[0, 0]) < 1.0
    live.save(path)


def test_a_map_that_is_turned_about_the_start_waits_for_its_heading(robot, messages, log):
    """The first fix is at the origin, as it would be in a map with the axes of odom."""

    def turned(one: Arrived) -> Arrived:
        if "pose" not in one.topic:
            return one
        message = deepcopy(one.message)
        place = message.pose.pose.position
        place.x, place.y = -place.y, place.x
        message.header.frame_id = "map"
        return one._replace(message=message)

    estimates = live_run(robot, [turned(one) for one in messages], reorder=0.05)
    in_map = [one for one in estimates if one.map_pose is not None]
    truth = log.truth
    assert in_map[0].stamp > estimates[0].stamp + 1_000_000_000
    for one in (in_map[0], in_map[-1]):
        yaw = interpolate_poses(truth.poses, np.array([one.stamp]))[0, 2]
        off = wrap_angle(one.map_pose[2] - yaw - np.pi / 2)
        assert abs(off) < 3.0 * np.sqrt(one.map_covariance[2, 2]) < 0.9


def test_a_pose_that_is_given_starts_the_map_anew(robot: Robot, messages: list[Arrived]) -> None:
    live = LiveOdometry(robot, VARIANT, settings=SETTINGS, reorder=0.1)
    half = len(messages) // 2
    before = list(through(live, messages[:half]))[-1]
    covariance = np.diag([0.04, 0.09, 0.01])
    assert live.place((50.0, 20.0, 1.0), covariance)
    # Fixes would draw it back.
    after = list(through(live, [one for one in messages[half:] if "fix" not in one.topic]))
    assert np.hypot(*(after[0].pose - before.pose)[:2]) < 0.1
    first = next(one for one in after if one.map_pose is not None)
    assert first.map_pose == pytest.approx((50.0, 20.0, 1.0), abs=0.1)
    assert np.diagonal(first.map_covariance) == pytest.approx([0.04, 0.09, 0.01], rel=0.05)
    last = after[-1]
    moved = relative(first.pose, last.pose)
    assert relative(first.map_pose, last.map_pose) == pytest.approx(moved, abs=0.03)
    assert live.map.estimator is not None


def test_statuses_name_what_is_wrong(live, messages):
    statuses = LiveStatuses(live)
    before = named(statuses)
    assert before["pose in odom"].level == ERROR
    assert "/joint_states" in before["pose in odom"].message
    assert before["clocks"].level == STALE
    half = len(messages) // 2
    list(through(live, messages[:half]))
    running = named(statuses)
    for name in ("pose in odom", "pose in map", "gyro", "tracks", "position", "clocks"):
        assert running[name].level == OK, running[name]
    assert set(live.odom.parameters) <= set(running["parameters"].values)
    assert "shown by the present motion" in running["parameters"].message
    assert live.newest is live.map.estimator
    assert abs(live.tracks.stamp - live.odom.stamp) < 1e8
    silent = named(statuses)
    assert silent["gyro"].level == STALE
    wild = [
        one._replace(message=_nan_rates(one.message)) if "imu" in one.topic else one
        for one in messages[half : half + 200]
    ]
    list(through(live, wild))
    after = named(statuses)
    assert after["imu"].level == WARN
    assert "not finite" in after["imu"].message


def _nan_rates(message: Any) -> Any:
    broken = deepcopy(message)
    broken.angular_velocity.z = float("nan")
    return broken


def test_a_robot_without_topics_listens_to_those_of_the_simulator(robot: Robot) -> None:
    bare = msgspec.structs.replace(robot, log={})
    assert LiveOdometry(bare, VARIANT, settings=SETTINGS).assumed_topics
    mapping = live_topics(bare)
    assert mapping.tracks.topic == "/joint_states"


def test_an_imu_that_never_comes_is_an_error(live, robot, messages):
    statuses = LiveStatuses(live)
    list(through(live, [one for one in messages if one.topic != robot.log["imu"]["topic"]]))
    found = named(statuses)
    assert live.odom.stamp is not None
    assert found["imu"].level == ERROR
    assert "nothing has come on" in found["imu"].message
    assert "gyro faults" not in found
    # Nothing more comes: the estimate is old.
    assert named(statuses)["pose in odom"].level == STALE


def test_a_gap_in_the_track_speeds_is_reported_once(live, robot, messages):
    statuses = LiveStatuses(live)
    start, tracks = messages[0].arrival, robot.log["tracks"]["topic"]
    kept = [one for one in messages if one.topic != tracks or not 3e9 < one.arrival - start < 5e9]
    list(through(live, kept))
    pose = named(statuses)["pose in odom"]
    assert pose.level == WARN
    assert "a gap in the track speeds was bridged" in pose.message


def test_a_start_pose_places_the_map_without_fixes_and_after_a_reset(robot, messages) -> None:
    start, how = (10.0, -5.0, 2.0), {"settings": SETTINGS, "use_fixes": False, "reorder": 0.1}
    live = LiveOdometry(robot, VARIANT, start_pose=start, **how)
    estimates = list(through(live, messages))
    alone = list(through(LiveOdometry(robot, VARIANT, **how), messages))
    placed = [one for one in estimates if one.map_pose is not None]
    assert len(placed) > len(estimates) - 30
    for one, other in zip(estimates, alone, strict=True):
        assert np.array_equal(one.pose, other.pose)
    last = placed[-1]
    assert relative(start, last.map_pose) == pytest.approx(last.pose, abs=0.02)
    # AMCL's, and the drift.
    assert last.map_covariance[0, 0] > 0.25
    live.restart()
    again = [one for one in through(live, messages) if one.map_pose is not None]
    assert again[0].map_pose == pytest.approx(start, abs=0.05)
