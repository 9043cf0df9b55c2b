"""A truth without headings from end to end: NavSatFix in a bag, dead headings, one that is late."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymap3d import enu2geodetic

from bag_messages import navsatfix, pose_stamped, write_bag
from command_line import fails, results_in, succeeds
from icreckon import Log, PoseSeries, Scenario, Truth, read_log, simulate, write_log
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, load_robot

ALPHA = load_robot("auriga-alpha")
ORIGIN = (52.0, 13.0, 40.0)
TURNED = 0.8
VARIANT = "constant-online"


def bag_with(log: Log, folder: Path, truth: list[tuple[str, object]]) -> Path:
    """A folder with two bags of a recording: the sensors, and messages that tell the truth."""
    folder.mkdir()
    write_log(replace(log, truth=None, fixes=None), folder / "log.mcap", "mcap", ALPHA)
    made = write_bag(folder / "made", truth)
    next(made.glob("*.mcap")).rename(folder / "truth.mcap")
    shutil.rmtree(made)
    return folder


@pytest.fixture(scope="module")
def log() -> Log:
    how = {"trajectory": "aggressive", "fix_rate": 0.0, "truth": "kinematic"}
    return simulate(Scenario(duration=90.0, seed=5, **how), ALPHA)


def east_north(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and positions of an antenna on the robot in a turned frame, 10 Hz, 1 cm of noise."""
    stamps, poses = log.truth.poses.stamps, log.truth.poses.poses
    places = poses[:, :2] + rotate(np.tile([0.2, 0.0], (len(poses), 1)), poses[:, 2])
    places = rotate(places, np.full(len(places), TURNED)) + np.array([30.0, 12.0])
    places += 0.01 * np.random.default_rng(1).standard_normal(places.shape)
    every = max(1, round(1e8 / np.median(np.diff(stamps))))
    return stamps[::every], places[::every]


def bag_with_gps(log: Log, path: Path) -> Path:
    stamps, places = east_north(log)
    degrees = np.column_stack(enu2geodetic(*places.T, 0.0, *ORIGIN)).tolist()
    truth = [
        ("/truth/gps", navsatfix(stamp, *place, variances=(1e-4, 1e-4)))
        for stamp, place in zip(stamps.tolist(), degrees, strict=True)
    ]
    return bag_with(log, path, truth)


@pytest.fixture(scope="module")
def bag(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag_with_gps(log, tmp_path_factory.mktemp("truth") / "bag")


def robot_file(folder: Path, truth: str) -> Path:
    text = (ROBOTS_FOLDER / "auriga-alpha.toml").read_text(encoding="utf-8")
    path = folder / "robot.toml"
    path.write_text(text[: text.index("[log.fixes]")] + truth, encoding="utf-8")
    return path


NAVSAT = '[log.truth]\ntopic = "/truth/gps"\norigin = [52.0, 13.0, 40.0]\n'


def test_navsatfix_is_read_as_positions_alone(log: Log, bag: Path, tmp_path: Path) -> None:
    read = read_log(bag, load_robot(robot_file(tmp_path, NAVSAT)))
    assert not read.truth.headings
    assert np.isnan(read.truth.poses.poses[:, 2]).all()
    np.testing.assert_allclose(read.truth.poses.poses[:, :2], east_north(log)[1], atol=1e-4)
    # By its own first position where there is no origin.
    first = read_log(bag, load_robot(robot_file(tmp_path, NAVSAT[: NAVSAT.index("origin")])))
    np.testing.assert_allclose(first.truth.poses.poses[0, :2], 0.0, atol=1e-6)
    assert any("positions of the truth are in metres" in note for note in first.notes)
    assert read.origin == (52.0, 13.0, 40.0)
    assert first.origin == pytest.approx((52.0, 13.0, 40.0), abs=0.01)


def test_replay_scores_positions_and_says_so(bag: Path, tmp_path: Path) -> None:
    words = ("--robot", robot_file(tmp_path, NAVSAT), "--variants", VARIANT)
    words = (*words, "--formats", "geojson", "--out", tmp_path / "out")
    done = succeeds("replay", bag, *words, cwd=tmp_path)
    assert (tmp_path / "out" / "paths.geojson").is_file()
    assert "the truth has no headings: scored are positions" in " ".join(done.stdout.split())
    assert "NEES position" in done.stdout
    assert "RMSE" not in done.stdout
    results = results_in(tmp_path / "out")
    scores = results["variants"][VARIANT]
    assert results["truth"]["headings"] is False
    for name in ("yaw_drift_deg_per_m", "final_yaw_error_deg", "nees_pose_mean", "rmse_v_y_m_s"):
        assert scores[name] is None
    assert set(results["series"]["variants"][VARIANT]["yaw_error_rad"]) == {None}
    assert scores["nees_position_mean"] is not None
    assert scores["lever_arm_m"][0] == pytest.approx(0.2, abs=0.06)
    page = (tmp_path / "out" / "page.html").read_text(encoding="utf-8")
    titles = ("Position error", "Yaw", "Yaw error")
    assert [f'"{title}"' in page for title in titles] == [True, True, False]
    shown = succeeds("inspect", bag, cwd=tmp_path).stdout
    assert "truth: headings are missing: a replay scores positions alone" in shown
    assert '[log.truth]\ntopic = "/truth/gps"' in shown  # by its name


def test_dead_headings_are_not_scored(log: Log, tmp_path: Path) -> None:
    """Many drivers leave in the quaternion what was in memory."""
    stamps, places = east_north(log)
    half = np.random.default_rng(2).uniform(-1.5, 1.5, len(stamps))
    rows = np.column_stack([places, np.sin(half), np.cos(half)]).tolist()
    truth = [
        ("/pose", pose_stamped(stamp, x=x, y=y, q=(0.0, 0.0, sin, cos)))
        for stamp, (x, y, sin, cos) in zip(stamps.tolist(), rows, strict=True)
    ]
    bag = bag_with(log, tmp_path / "bag", truth)
    words = ("--robot", robot_file(tmp_path, '[log.truth]\ntopic = "/pose"\n'))
    done = succeeds("replay", bag, *words, "--variants", VARIANT, "--json", cwd=tmp_path)
    results = json.loads(done.stdout)
    scores, notes = results["variants"][VARIANT], " ".join(results["log"]["notes"])
    assert "do not follow its path" in notes
    assert "scored are positions" in notes
    assert scores["yaw_drift_deg_per_m"] is None
    assert scores["drift_percent_30s_mean"] < 5.0


def test_a_robot_that_stands_has_a_truth_that_is_not_used(tmp_path: Path) -> None:
    # Its first three seconds are a standstill.
    still = simulate(Scenario(duration=3.5, fix_rate=0.0), ALPHA)
    bag = bag_with_gps(still, tmp_path / "bag")
    words = ("--robot", robot_file(tmp_path, NAVSAT))
    done = succeeds("replay", bag, *words, "--variants", VARIANT, "--json", cwd=tmp_path)
    results = json.loads(done.stdout)
    assert results["truth"] is None
    assert any("too little to find them from its path" in note for note in results["log"]["notes"])
    assert "moves too little to find them" in fails("calibrate", bag, *words, cwd=tmp_path)


def test_all_commands_find_the_same_lag(log: Log, tmp_path: Path) -> None:
    """A truth at 10 Hz that is 0.35 s late, with noise, and a yaw that is zero."""
    poses = log.truth.poses.rows(slice(None, None, 5))
    noise = np.random.default_rng(4).normal(0.0, 0.01, poses.poses.shape) * [1.0, 1.0, 0.0]
    late = PoseSeries(poses.stamps + 350_000_000, poses.poses * [1.0, 1.0, 0.0] + noise)
    bag = write_log(replace(log, truth=Truth(late)), tmp_path / "bag", "mcap", ALPHA)
    words = (bag, "--robot", "auriga-alpha")
    done = succeeds("replay", *words, "--variants", VARIANT, "--json", cwd=tmp_path)
    truth = json.loads(done.stdout)["truth"]
    done = succeeds("calibrate", *words, "--models", "constant", "--json", cwd=tmp_path)
    (of_log,) = json.loads(done.stdout)["logs"]
    text = " ".join(succeeds("inspect", bag, cwd=tmp_path).stdout.split())
    text = text.split("truth: stamps lag ")[1].split(" by ", 1)[1]
    for seconds, sigma in (
        (truth["lag_s"], truth["lag_sigma_s"]),
        (of_log["truth_lag_s"], of_log["truth_lag_sigma_s"]),
        (float(text.split()[0]), float(text.split("(± ")[1].split(")")[0])),
    ):
        assert sigma < 0.05
        # Positions are late against the tracks, too, which the body follows 0.045 s later.
        assert seconds == pytest.approx(0.395, abs=0.015)
