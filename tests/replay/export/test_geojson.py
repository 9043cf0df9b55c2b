"""Paths on the globe: GeoJSON and NavSatFix, where the log has an origin."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bag_messages import mcap_messages
from icreckon import Comparison, ReplayError, Scenario, compare, load_robot, simulate
from icreckon.replay.export.formats import check_formats
from icreckon.replay.export.geojson import write_geojson
from icreckon.replay.export.replay_bag import write_replay_bag
from icreckon.replay.mapping.geodesy import east_north

ORIGIN = (52.0, 13.0, 40.0)


@pytest.fixture(scope="module")
def local() -> Comparison:
    scenario = Scenario(duration=10.0, seed=4, trajectory="slalom")
    robot = load_robot("auriga-alpha")
    return compare(simulate(scenario, robot), robot, ["gyro", "constant-online"])


@pytest.fixture(scope="module")
def on_globe(local: Comparison) -> Comparison:
    return replace(local, log=replace(local.log, origin=ORIGIN))


def test_each_path_is_a_line_in_its_colour(on_globe: Comparison, tmp_path: Path) -> None:
    path = write_geojson(tmp_path / "paths.geojson", on_globe)
    found = json.loads(path.read_text("utf-8"))
    assert found["type"] == "FeatureCollection"
    features = {one["properties"]["name"]: one for one in found["features"]}
    assert list(features) == ["gyro", "constant-online", "ground_truth", "fixes"]
    assert len({one["properties"].get("stroke") for one in features.values()}) == 4
    for name, run in on_globe.runs.items():
        line = features[name]
        assert line["geometry"]["type"] == "LineString"
        longitude, latitude, altitude = np.array(line["geometry"]["coordinates"]).T
        level = np.full(len(latitude), ORIGIN[2])
        places = east_north(np.column_stack([latitude, longitude, level]), ORIGIN)
        assert altitude[-1] == pytest.approx(ORIGIN[2] + run.trajectory.spatial[-1, 0], abs=0.1)
        # Five points a second of a drive of ten seconds.
        assert len(places) == pytest.approx(50, abs=1)
        np.testing.assert_allclose(places[0], run.trajectory.poses[0, :2], atol=2e-3)
        every = np.linalg.norm(places[:, None] - run.trajectory.poses[None, :, :2], axis=2)
        assert every.min(axis=1).max() < 2e-3
        assert line["properties"]["start_ns"] == run.stamps[0]
    points = features["fixes"]["geometry"]
    assert points["type"] == "MultiPoint"
    assert len(points["coordinates"]) == len(on_globe.log.fixes.stamps)
    with pytest.raises(ReplayError, match="--overwrite"):
        write_geojson(path, on_globe)


def test_a_bag_has_the_paths_as_fixes_of_a_receiver(on_globe: Comparison, tmp_path: Path) -> None:
    bag = write_replay_bag(tmp_path / "o.mcap", "mcap", on_globe, load_robot("auriga-alpha"))
    found = [message for *_, message in mcap_messages(bag)["/constant_online/fix"]]
    trajectory = on_globe.runs["constant-online"].trajectory
    assert len(found) == pytest.approx(50, abs=1)
    for message in (found[0], found[-1]):
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        row = int(np.searchsorted(trajectory.stamps, stamp))
        assert trajectory.stamps[row] == stamp
        there = np.array([[message.latitude, message.longitude, message.altitude]])
        place = trajectory.poses[row, :2]
        np.testing.assert_allclose(east_north(there, ORIGIN)[0], place, atol=1e-4)
        covariance = np.reshape(message.position_covariance, (3, 3))
        np.testing.assert_array_equal(covariance[:2, :2], trajectory.pose_covariances[row, :2, :2])
        height, sigma = trajectory.spatial[row, 0], trajectory.spatial_sigmas[row, 0]
        assert message.altitude == pytest.approx(ORIGIN[2] + height)
        assert covariance[2, 2] == pytest.approx(sigma**2, rel=1e-6)
        assert message.position_covariance_type == 3
        assert message.header.frame_id == "constant_online/base_link"


def test_without_an_origin_there_is_one_clear_error(local: Comparison, tmp_path: Path) -> None:
    check_formats(("tum", "mcap"), local.log)
    with pytest.raises(ReplayError, match=r"geojson needs places on the globe.*NavSatFix"):
        check_formats(("tum", "geojson"), local.log)
    with pytest.raises(ReplayError, match="has none"):
        write_geojson(tmp_path / "paths.geojson", local)
    assert not list(tmp_path.iterdir())
