"""Settings for ROS: odometry made with them turns and drives as the robot does."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as with_values
from ruamel.yaml import YAML
from scipy.integrate import trapezoid

from command_line import icreckon, succeeds
from icreckon import Log, Robot, Scenario, TrackSpeedSeries, load_robot, simulate, write_log
from icreckon.estimator.robot.robot_file import changed_robot
from icreckon.replay.checking.ros_settings import ros_settings, twist_errors

ALPHA = load_robot("auriga-alpha")


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(Scenario(duration=90.0, seed=5, trajectory="random", fix_rate=0.0), ALPHA)


def parsed(log: Log, robot: Robot) -> dict:
    return YAML(typ="safe").load(ros_settings([log], robot))


def controller(log: Log, robot: Robot = ALPHA) -> dict:
    return parsed(log, robot)["diff_drive_controller"]["ros__parameters"]


def radii_of(log: Log, robot: Robot) -> list[float]:
    settings = controller(log, robot)
    return [settings[f"{side}_wheel_radius_multiplier"] for side in ("left", "right")]


def parameters_of(file: Path) -> dict:
    found = YAML(typ="safe").load(file.read_text(encoding="utf-8"))
    return found["diff_drive_controller"]["ros__parameters"]


def with_track_of_the_log(log: Log) -> Robot:
    """Robot with the effective track that the gyro shows."""
    text = ros_settings([log], ALPHA)
    shown = float(text.partition("by the gyro of this log ")[2].split()[0])
    return changed_robot(
        ALPHA, {"constant_icr": None, "indices.eta0": shown, "indices.epsilon0": 0.0}
    )


def odometry(log: Log, settings: dict) -> tuple[np.ndarray, np.ndarray]:
    """Speed and yaw rate that a diff_drive_controller computes from wheel rates."""
    rates = log.tracks.speeds / ALPHA.vehicle.sprocket_radius
    left = rates[:, 0] * settings["wheel_radius"] * settings["left_wheel_radius_multiplier"]
    right = rates[:, 1] * settings["wheel_radius"] * settings["right_wheel_radius_multiplier"]
    separation = settings["wheel_separation"] * settings["wheel_separation_multiplier"]
    return 0.5 * (left + right), (right - left) / separation


def test_the_scale_of_speeds_is_in_the_radii(log: Log) -> None:
    """Speeds in m/s have no radius here: their scale is that of the controller's."""
    mapped = {"tracks": {"topic": "/odom", "scale": 0.97, "gauge": 0.6}}
    robot = with_values(ALPHA, log=mapped)
    assert radii_of(log, robot) == pytest.approx([0.97, 0.97])
    # Of a controller whose gauge is known, the multiplier is no factor on another one.
    assert "times that of the controller" not in ros_settings([log], robot)


def test_odometry_with_them_turns_as_the_robot(log: Log):
    settings = controller(log, with_track_of_the_log(log))
    speed, rate = odometry(log, settings)
    seconds = (log.tracks.stamps - log.start) * 1e-9
    turned = trapezoid(np.abs(rate), seconds)
    gyro = (log.imu.stamps - log.start) * 1e-9
    bias = log.imu.angular_velocity[:50, 2].mean()
    truly = trapezoid(np.abs(log.imu.angular_velocity[:, 2] - bias), gyro)
    assert turned == pytest.approx(truly, rel=0.03)
    truth = log.truth.twists.twists
    true_speed = np.interp(log.tracks.stamps, log.truth.twists.stamps, truth[:, 0])
    assert np.std(speed - true_speed) < 0.1 * np.std(true_speed)


def test_numbers_are_floats_for_ros_and_yaml(log: Log):
    """ROS 2 refuses a whole number for a real one, and YAML 1.1 takes 1e3 for a text."""
    robot = changed_robot(ALPHA, {"vehicle.track_gauge": 1.0})
    text = ros_settings([log], robot)
    lines = [line.partition("#")[0] for line in text.splitlines()]
    values = re.findall(r"(?<![\w.])-?\d[\w.+-]*", " ".join(line for line in lines if ":" in line))
    assert len(values) > 10
    assert all(re.fullmatch(r"-?\d+\.\d+", value) for value in values)
    assert "1000.0" in values
    assert "wheel_separation: 1.0 " in text


def test_a_contradicted_multiplier_is_that_of_the_log(log: Log):
    right = controller(log)["wheel_separation_multiplier"]
    assert right == pytest.approx(ALPHA.constant_indices.eta0, rel=1e-3)
    wrong = with_values(ALPHA, constant_icr=None, indices=with_values(ALPHA.indices, eta0=1.0))
    assert controller(log, wrong)["wheel_separation_multiplier"] == pytest.approx(right, rel=0.1)
    assert "which contradicts 1 of the robot file" in ros_settings([log], wrong)


def test_radii_that_differ_are_in_the_multipliers(log: Log):
    robot = with_values(ALPHA, tracks=with_values(ALPHA.tracks, difference=0.02))
    assert radii_of(log, robot) == [0.99, 1.01]


def test_speeds_that_are_no_rates_need_no_radius(log: Log):
    tracks = {"topic": "/speeds", "left": ["data[0]"], "right": ["data[1]"], "unit": "m/s"}
    robot = with_values(ALPHA, log={"tracks": {**tracks, "latency": 0.2}})
    assert "wheel_radius" not in controller(log, robot)
    assert "stamped 0.2 s late" in ros_settings([log], robot)


def test_without_truth_and_imu_the_errors_are_said_to_be_defaults(log: Log):
    bare = replace(log, truth=None, imu=None)
    assert all(error.value > 0.0 for error in twist_errors([bare], ALPHA))
    text = ros_settings([bare], ALPHA)
    assert text.count("with nothing to compare with") == 2
    assert "imu_driver" not in text


def test_names_stay_comments(log: Log):
    named = replace(log, name="a\nwheel_radius: 7")
    assert parsed(named, ALPHA).keys() == {"diff_drive_controller", "imu_driver"}


def test_the_command_writes_them_and_replaces_only_its_own(log: Log, tmp_path: Path):
    write_log(log, tmp_path / "drive", "mcap", ALPHA)
    words = ("check", "drive", "--robot", "auriga-alpha", "--ros", "ros.yaml")
    succeeds(*words, "--json", cwd=tmp_path)
    assert "wheel_separation_multiplier" in (tmp_path / "ros.yaml").read_text(encoding="utf-8")
    assert "exists already" in icreckon(*words, cwd=tmp_path).stderr
    (tmp_path / "ros.yaml").write_text("mine: 1\n", encoding="utf-8")
    assert icreckon(*words, "--overwrite", cwd=tmp_path).returncode == 1
    assert (tmp_path / "ros.yaml").read_text(encoding="utf-8") == "mine: 1\n"


def test_inspect_writes_them_without_a_robot_file(log: Log, tmp_path: Path):
    """The effective separation needs no gauge, the radius a truth: nobody has measured either."""
    write_log(log, tmp_path / "drive", "mcap", ALPHA)
    succeeds("inspect", "drive", "--ros", "ros.yaml", cwd=tmp_path)
    settings = parameters_of(tmp_path / "ros.yaml")
    separation = settings["wheel_separation"] * settings["wheel_separation_multiplier"]
    by_the_log = controller(log, with_track_of_the_log(log))["wheel_separation_multiplier"]
    assert separation == pytest.approx(by_the_log * ALPHA.vehicle.track_gauge, rel=0.03)
    assert settings["wheel_radius"] == pytest.approx(ALPHA.vehicle.sprocket_radius, rel=0.03)

    # A gauge that was filled in is that of the controller.
    succeeds("inspect", "drive", "--write", "robot.toml", cwd=tmp_path)
    file = tmp_path / "robot.toml"
    text = re.sub(r"track_gauge = [\d.]+", "track_gauge = 0.42", file.read_text(encoding="utf-8"))
    file.write_text(text, encoding="utf-8")
    words = ("--write", "robot.toml", "--ros", "ros.yaml", "--overwrite")
    succeeds("inspect", "drive", *words, cwd=tmp_path)
    assert parameters_of(tmp_path / "ros.yaml")["wheel_separation"] == 0.42

    without_truth = replace(log, truth=None)
    write_log(without_truth, tmp_path / "drive-2", "mcap", ALPHA)
    done = icreckon("inspect", "drive-2", "--ros", "ros-2.yaml", cwd=tmp_path)
    assert done.returncode == 1
    assert "fill in sprocket_radius" in done.stderr
    assert not (tmp_path / "ros-2.yaml").exists()


def test_odometry_from_a_twist_gets_a_factor_of_its_controllers(log: Log):
    """Its speeds are those of a controller whose own multiplier no log shows."""
    robot = with_values(ALPHA, log={"tracks": {"topic": "/odom"}})
    assert "times that of the controller" in ros_settings([log], robot)
    proposed = ros_settings([log], robot, proposed=True)
    assert re.search(r"made this odometry, times 2\.\d+ ± 0\.0\d+", proposed)
    assert "wheel_separation:" not in proposed


def test_without_track_speeds_there_is_only_the_imu(log: Log):
    none = np.zeros(0, dtype=np.int64)
    empty = replace(log, tracks=TrackSpeedSeries(none, np.zeros((0, 2))))
    assert parsed(empty, ALPHA).keys() == {"imu_driver"}
