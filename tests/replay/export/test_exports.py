"""What a comparison is written as, read back by what others read it with."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from rosbags.rosbag1 import Reader as Ros1Reader

from bag_messages import mcap_messages
from command_line import fails, succeeds
from icreckon import IndexValues, PoseSeries, ReplayError, Robot, Scenario, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.base.frames import quaternion_to_yaw, wrap_angle
from icreckon.estimator.streaming.outputs import Run, icr_points
from icreckon.replay.bags.writer import write_bag
from icreckon.replay.base.outputs import written_beside
from icreckon.replay.comparison.compare import Comparison, compare
from icreckon.replay.export.folder import write_exports, write_tum
from icreckon.replay.export.formats import DEFAULT_FORMATS, FORMATS, parse_formats
from icreckon.replay.export.log_bag import pose_messages
from icreckon.replay.export.replay_bag import write_replay_bag
from icreckon.replay.export.tables import run_columns, write_table
from tum import read_tum

VARIANTS = ["constant-online", "inertia-online"]


@pytest.fixture(scope="module")
def comparison(robot: Robot) -> Comparison:
    scenario = Scenario(duration=20.0, seed=4, trajectory="slalom", outages=((8.0, 20.0),))
    log = simulate(scenario, robot)
    return compare(log, robot, VARIANTS, smooth=True)


@pytest.fixture(scope="module")
def one(comparison: Comparison) -> Run:
    return comparison.runs["inertia-online"]


def test_the_truth_is_written_as_the_best_variant_is_scored_by(
    tmp_path: Path, robot: Robot
) -> None:
    """A variant without zeta0 has its base_link elsewhere: its truth is another one."""
    log = simulate(Scenario(duration=60.0, trajectory="aggressive", truth="kinematic"), robot)
    log = replace(log, fixes=None, truth=replace(log.truth, twists=None, tracks=None))
    found = compare(log, robot, ("gyro", "inertia-online"))
    write_exports(tmp_path, found, robot, ("tum",), {"best": "inertia-online"})
    expected = found.truths["inertia-online"].truth.poses.poses
    written = read_tum(tmp_path / "ground_truth.tum").poses
    np.testing.assert_allclose(written[:, :2], expected[:, :2], atol=1e-8)
    assert np.abs(written[:, :2] - found.log.truth.poses.poses[:, :2]).max() > 0.01


def test_formats_are_named_in_any_order_and_case() -> None:
    assert parse_formats(None) == DEFAULT_FORMATS == ("tum", "mcap")
    assert parse_formats(" ROS1 ,tum,tum") == ("tum", "ros1")
    assert parse_formats("none") == ()
    assert parse_formats(",".join(FORMATS)) == tuple(FORMATS)


def test_the_command_writes_what_is_asked_for_and_refuses_what_it_does_not_know(tmp_path):
    words = ("--duration", 20, "--outage", "5:20", "--seed", 3)
    succeeds("simulate", "--out", "run", *words, cwd=tmp_path)
    words = ("--robot", "auriga-alpha", "--variants", "constant-online", "--out", "a")
    words = ("replay", "run", *words)
    assert "did you mean 'parquet'" in fails(*words, "--formats", "tum,parket", cwd=tmp_path)
    assert not (tmp_path / "a").exists()
    done = succeeds(*words, "--formats", "ros1,tum,csv", cwd=tmp_path)
    assert "the page to open is a/page.html" in done.stderr.replace("\n", "")
    names = {path.name for path in (tmp_path / "a").iterdir()}
    assert names == {
        *(".icreckon-files", "page.html", "figure.png", "results.json", "odometry.bag"),
        *(f"{n}.{form}" for n in ("constant-online", "ground_truth") for form in ("tum", "csv")),
    }


def test_parquet_holds_all_of_a_run(tmp_path: Path, one: Run, robot: Robot) -> None:
    path = write_table(tmp_path / "a.parquet", "parquet", run_columns(one, robot))
    table = pyarrow.parquet.read_table(path)
    columns = {name: table[name].to_numpy() for name in table.column_names}
    np.testing.assert_array_equal(columns["stamp_ns"], one.stamps)
    assert columns["t_s"][-1] == pytest.approx((one.stamps[-1] - one.stamps[0]) * 1e-9)
    innovations = one.innovations[:, one.innovation_names.index("position_x")]
    for name, expected in {
        "x_m": one.trajectory.poses[:, 0],
        "yaw_rad": one.trajectory.poses[:, 2],
        "w_rad_s": one.trajectory.twists[:, 2],
        "cov_y_yaw_m_rad": one.trajectory.pose_covariances[:, 1, 2],
        "cov_v_y_w_m_rad_s2": one.trajectory.twist_covariances[:, 1, 2],
        "epsilon_m": one.indices[:, 1],
        "epsilon1_m_per_N": one.states[:, s.EPSILON1],
        "epsilon1_sigma_m_per_N": one.state_sigmas[:, s.EPSILON1],
        "gyro_bias_rad_s": one.states[:, s.GYRO_BIAS],
        "innovation_position_x": innovations,
    }.items():
        np.testing.assert_allclose(columns[name], expected, rtol=1e-6, atol=1e-30, err_msg=name)
    assert table["innovation_position_x"].null_count == np.isnan(innovations).sum() > 0


def test_csv_says_the_same_as_parquet(tmp_path: Path, one: Run, robot: Robot) -> None:
    columns = run_columns(one, robot, int(one.stamps[0]))
    table = pyarrow.parquet.read_table(write_table(tmp_path / "a.parquet", "parquet", columns))
    path = write_table(tmp_path / "a.csv", "csv", columns)
    options = pyarrow.csv.ConvertOptions(column_types=table.schema)
    assert pyarrow.csv.read_csv(path, convert_options=options).equals(table)


# --- bags ----------------------------------------------------------------------------------------


def test_odometry_holds_the_estimate(one: Run, messages) -> None:
    path, places = one.trajectory, one.trajectory.pose_series
    for row in (0, 1, 500, len(one.stamps) - 1):
        _, stamp, found = messages["/inertia_online/odom"][row]
        assert stamp == found.header.stamp.sec * 10**9 + found.header.stamp.nanosec
        assert found.header.frame_id == "odom"
        assert found.child_frame_id == "inertia_online/base_link"
        yaw, at = path.poses[row, 2], found.pose.pose.position
        assert (at.x, at.y, at.z) == tuple(places.positions[row])
        q = found.pose.pose.orientation
        assert (q.x, q.y, q.z, q.w) == tuple(places.quaternions[row])
        assert np.cos(quaternion_to_yaw([q.x, q.y, q.z, q.w]) - yaw) == pytest.approx(1.0)
        for told, expected in (
            (found.pose.covariance, one.trajectory.pose_covariances[row]),
            (found.twist.covariance, one.trajectory.twist_covariances[row]),
        ):
            matrix = np.reshape(told, (6, 6))
            np.testing.assert_array_equal(matrix[np.ix_([0, 1, 5], [0, 1, 5])], expected)
        spatial = np.diag(np.reshape(found.pose.covariance, (6, 6)))[2:5]
        np.testing.assert_allclose(spatial, path.spatial_sigmas[row].astype(float) ** 2)
        assert (spatial[1:] > 0.0).all()
        assert (spatial < 1.0).all()
        np.testing.assert_array_equal(np.diag(np.reshape(found.twist.covariance, (6, 6)))[2:5], 1e6)
        assert found.twist.twist.angular.z == one.trajectory.twists[row, 2]


@pytest.fixture(scope="module")
def mcap_bag(tmp_path_factory, comparison, robot):
    return write_replay_bag(tmp_path_factory.mktemp("mcap") / "o.mcap", "mcap", comparison, robot)


@pytest.fixture(scope="module")
def messages(mcap_bag: Path) -> dict[str, list]:
    return mcap_messages(mcap_bag)


def test_the_official_decoder_reads_the_mcap(messages, comparison):
    found = messages
    smoothed = [f"{name}-smoothed" for name in VARIANTS]
    names = [name.replace("-", "_") for name in (*VARIANTS, *smoothed)]
    assert set(found) == {
        *(f"/{name}/{topic}" for name in names for topic in ("odom", "pose", "path", "icrs")),
        *("/tf", "/fixes", "/ground_truth/pose", "/ground_truth/path"),
    }
    assert {topic: rows[0][0] for topic, rows in found.items() if "_online" not in topic} == {
        "/tf": "tf2_msgs/msg/TFMessage",
        "/fixes": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "/ground_truth/pose": "geometry_msgs/msg/PoseStamped",
        "/ground_truth/path": "nav_msgs/msg/Path",
    }
    one, truth = comparison.runs["inertia-online"], comparison.log.truth
    rows = found["/inertia_online/odom"]
    assert [logged for _, logged, _ in rows] == one.stamps.tolist()
    assert len(found["/ground_truth/pose"]) == len(truth.poses.stamps)
    assert len(found["/fixes"]) == len(comparison.log.fixes.stamps)
    path = found["/inertia_online/path"][0][2]
    assert len(found["/inertia_online/path"]) == 1
    assert path.poses[-1].pose.position.x == one.trajectory.poses[-1, 0]
    assert len(path.poses) <= 1000


def test_fixes_have_the_covariance_of_the_log(messages, comparison):
    fixes = comparison.log.fixes
    for (_, logged, message), variances in zip(
        messages["/fixes"], fixes.variances.tolist(), strict=True
    ):
        assert logged in fixes.stamps
        covariance = np.reshape(message.pose.covariance, (6, 6))
        assert covariance[0, 0] == covariance[1, 1] == variances[0]


def test_each_frame_has_one_parent_and_base_link_goes_with_the_last_filter(messages, comparison):
    parents, newest = {}, {}
    for _, _, decoded in messages["/tf"]:
        for one in decoded.transforms:
            parents.setdefault(one.child_frame_id, set()).add(one.header.frame_id)
            newest[one.child_frame_id] = one.transform.translation
    names = [*comparison.runs, "ground_truth"]
    frames = {f"{name.replace('-', '_')}/base_link" for name in names} | {"base_link"}
    assert parents == {frame: {"odom"} for frame in frames}
    assert newest["base_link"] == newest["inertia_online/base_link"]
    assert newest["base_link"] != newest["constant_online/base_link"]


def test_icr_markers_lie_in_the_frame_of_their_variant(messages, comparison, robot):
    one = comparison.runs["constant-online"]
    rows = messages["/constant_online/icrs"]
    assert len(rows) == pytest.approx(5 * 20, abs=2)
    for _, stamp, decoded in rows:
        row = np.flatnonzero(one.stamps == stamp)
        of_left, of_right = icr_points(IndexValues(*one.indices[row][0]), robot.vehicle.track_gauge)
        assert [(each.id, each.type) for each in decoded.markers] == [(0, 7), (1, 4)]
        for marker in decoded.markers:
            left, right = marker.points
            assert marker.header.frame_id == "constant_online/base_link"
            assert ((left.x, left.y), (right.x, right.y)) == (of_left, of_right)
            assert marker.color.a > 0.0 < marker.scale.x
            assert marker.pose.orientation.w == 1.0


def test_a_bag_without_truth_fixes_and_imu(tmp_path: Path, robot: Robot) -> None:
    log = simulate(Scenario(duration=4.0, seed=4), robot)
    bare = compare(replace(log, truth=None, fixes=None, imu=None), robot, ["differential"])
    found = mcap_messages(write_replay_bag(tmp_path / "o.mcap", "mcap", bare, robot))
    topics = {f"/differential/{topic}" for topic in ("odom", "pose", "path", "icrs")}
    assert set(found) == topics | {"/tf"}


def test_what_cannot_be_stamped_is_refused(tmp_path: Path) -> None:
    early = PoseSeries(np.array([-5], dtype=np.int64), np.zeros((1, 3)))
    with pytest.raises(ReplayError, match="the stamp -5 ns cannot be written"):
        write_bag(tmp_path / "o.mcap", "mcap", [pose_messages("/p", early)], overwrite=False)
    assert not list(tmp_path.iterdir())


def test_rosbags_reads_the_ros1_bag(tmp_path: Path, comparison: Comparison, robot: Robot) -> None:
    path = write_replay_bag(tmp_path / "o.bag", "ros1", comparison, robot)
    with Ros1Reader(path) as reader:
        digests = {connection.msgtype: connection.digest for connection in reader.connections}
    # As `rosmsg md5` says them.
    assert digests["tf2_msgs/msg/TFMessage"] == "94810edda583a504dfda3829e70d7eec"
    assert digests["visualization_msgs/msg/MarkerArray"] == "d155b9ce5188fbaf89745847fd5882d7"


def test_a_trajectory_comes_back(tmp_path: Path) -> None:
    stamps = np.array([-1_500_000_001, 0, 1, 1_700_000_000_123_456_789, 2**62], dtype=np.int64)
    written = PoseSeries(stamps, np.random.default_rng(5).normal(size=(5, 3)) * [9, 9, 2])
    found = read_tum(write_tum(tmp_path / "t.tum", written))
    np.testing.assert_array_equal(found.stamps, stamps)
    np.testing.assert_allclose(found.poses[:, :2], written.poses[:, :2], atol=1e-9)
    assert np.abs(wrap_angle(found.poses[:, 2] - written.poses[:, 2])).max() < 1e-8


def test_the_text(tmp_path: Path) -> None:
    series = PoseSeries(np.array([1_700_000_000_000_000_007]), np.array([[1.5, -2.0, 0.0]]))
    path = write_tum(tmp_path / "t.tum", series)
    assert path.read_text() == (
        "1700000000.000000007 1.500000000 -2.000000000 0.000000000 "
        "0.000000000 0.000000000 0.000000000 1.000000000\n"
    )


def test_an_interrupted_write_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "out.txt"

    def fail(**options: bool) -> None:
        with written_beside(path, **options) as new:
            new.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert list(path.parent.iterdir()) == []
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        fail(overwrite=True)
    assert [one.read_text() for one in path.parent.iterdir()] == ["old"]
