"""A robot without a file: made, changed, and written as one."""

import numpy as np
import pytest

import icreckon
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.robot.robot_file import load_robot, make_robot, robot_names

VEHICLE = {"mass": 30.0, "track_gauge": 0.42, "sprocket_radius": 0.1}


def test_a_robot_is_made_of_what_is_known():
    robot = icreckon.make_robot("mine", vehicle=VEHICLE, imu={"position": (0.1, 0.0, 0.2)})
    assert robot.vehicle.mass == 30.0
    assert robot.imu.position == (0.1, 0.0, 0.2)
    assert robot.imu.gyro_scale == 1.0
    icreckon.PoseEstimator(robot)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({}, "vehicle"),
        ({"vehicle": {**VEHICLE, "track_guage": 1.0}}, "track_gauge"),
        ({"vehicle": {**VEHICLE, "mass": "heavy"}}, "mass"),
        ({"vehicle": VEHICLE, "imu": {"gyro_bias": 5.0}}, "gyro_bias"),
        ({"vehicle": VEHICLE, "imus": {}}, "imu"),
        ({"vehicle": 3}, "vehicle"),
    ],
)
def test_what_is_wrong_is_named_at_once(tables: dict, message: str):
    with pytest.raises(EstimatorError, match=message):
        make_robot("mine", **tables)


def test_values_are_changed_by_their_keys():
    robot = load_robot("warthog")
    changed = icreckon.changed_robot(
        robot, {"vehicle.track_gauge": np.float64(1.2), "imu.position": np.zeros(3), "note": "x"}
    )
    assert changed.vehicle.track_gauge == 1.2
    assert changed.imu.position == (0.0, 0.0, 0.0)
    assert changed.vehicle.mass == robot.vehicle.mass
    assert changed.log == robot.log
    assert robot.imu.position != (0.0, 0.0, 0.0)
    for key in ("vehicle.gauge", "vehicles.mass", "name.first", "vehicle.mass.x"):
        with pytest.raises(EstimatorError):
            icreckon.changed_robot(robot, {key: 1.0})
    with pytest.raises(EstimatorError, match="must be a Robot"):
        icreckon.changed_robot("warthog", {})


@pytest.mark.parametrize("name", robot_names())
def test_its_file_is_the_same_robot(name: str, tmp_path):
    robot = load_robot(name)
    path = tmp_path / "robot.toml"
    path.write_text(icreckon.robot_toml(robot), encoding="utf-8")
    again = load_robot(path)
    # Numbers keep seven digits.
    assert icreckon.robot_toml(again) == icreckon.robot_toml(robot)
    assert again.vehicle.mass == pytest.approx(robot.vehicle.mass)
    assert again.log == robot.log
    assert again.slip.keys() == robot.slip.keys()


def test_a_name_with_quotes_is_a_name(tmp_path):
    robot = make_robot('a "b"\n', vehicle=VEHICLE)
    path = tmp_path / "robot.toml"
    path.write_text(icreckon.robot_toml(robot), encoding="utf-8")
    assert load_robot(path).name == 'a "b"\n'
