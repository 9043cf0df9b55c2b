"""The robot file: defaults, and everything that is refused."""

import msgspec
import numpy as np
import pytest

import icreckon
from icreckon import EstimatorError, Indices, load_robot, make_robot, robot_names

SMALLEST = """
name = "mine"
[vehicle]
mass = 100.0
track_gauge = 0.5
sprocket_radius = 0.1
"""


def write(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


def test_smallest_file_is_an_ideal_differential_drive(tmp_path):
    robot = load_robot(write(tmp_path, SMALLEST))
    assert robot.indices == Indices(H=1.0, eta0=1.0)
    assert robot.constant_indices == robot.indices
    assert robot.centre_of_mass_paper == (0.0, 0.0)
    assert robot.imu_rotation == pytest.approx(np.eye(3))
    assert robot.slip == {}


def test_unknown_robot_names_the_nearest():
    with pytest.raises(
        EstimatorError, match="no robot named 'auriga-alfa'; did you mean 'auriga-a"
    ):
        load_robot("auriga-alfa")
    with pytest.raises(EstimatorError, match=r"there is 'auriga-alpha', .*path of a \.toml file"):
        load_robot("zzzzzz")


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("[indices]\nzeta_0 = 0.1", "unknown key 'zeta_0' in [indices]; did you mean 'zeta0'"),
        ("[imu]\ngyro_axes = 'y'", "[imu] gyro_axes"),
        ("[indices]\neta0 = 0.9", "eta0 must be at least 1"),
        ("[constant_icr]\nx_ICRl = 0.3\nx_ICRr = 0.5", "x_ICRl < 0 < x_ICRr must hold"),
        ("[constant_icr]\nx_ICRl = -0.1\nx_ICRr = 0.1", "at least track_gauge = 0.5 m apart"),
        ("[imu]\ngyro_axes = 'z'\nrotation_rpy_deg = [90.0, 0.0, 0.0]", "rotation_rpy_deg"),
        ("contact_points = 1", "contact_points must be from 2 to 1000, found 1"),
    ],
)
def test_bad_value_is_refused_and_named(tmp_path, more, told):
    path = write(tmp_path, SMALLEST + more)
    with pytest.raises(EstimatorError) as caught:
        load_robot(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_format_of_another_version_is_refused(tmp_path):
    with pytest.raises(EstimatorError, match="format 2 is not known; this version reads 1"):
        load_robot(write(tmp_path, "format = 2\n" + SMALLEST))


def test_constant_icrs_default_to_the_indices_at_no_inertia(tmp_path):
    text = SMALLEST + "[indices]\nzeta0 = 0.04\nepsilon0 = 0.1\neta0 = 2.0\neta1 = 0.01\nH = 0.6"
    constant = load_robot(write(tmp_path, text)).constant_indices
    assert constant == Indices(H=0.6, zeta0=0.04, epsilon0=0.1, eta0=2.0)


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
        ({"vehicle": VEHICLE, "imu": {"gyro_bias": 5.0}}, "gyro_bias"),
        (
            {"vehicle": VEHICLE, "imu": {"gyro_bias_sigma": 35.0}},
            "gyro_bias_sigma must be in radians",
        ),
        ({"vehicle": VEHICLE, "tracks": {"scale_sigma": 5.0}}, "scale_sigma must be from 0 to 1"),
        ({"vehicle": VEHICLE, "imu": {"position": (120.0, 0.0, 9.0)}}, "position.* in millimetres"),
        (
            {"vehicle": {**VEHICLE, "centre_of_mass": (0.0, 0.0, 150.0)}},
            "centre_of_mass .* in millimetres",
        ),
        ({"vehicle": {**VEHICLE, "max_track_speed": 1500.0}}, "max_track_speed .* in mm/s"),
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


def test_the_offset_of_a_clock_keeps_all_digits(tmp_path):
    columns = {"time": "t", "tracks": {"left": ["l"], "clock_offset": 1759999925.766}}
    robot = msgspec.structs.replace(load_robot("husky"), log={"columns": columns})
    (tmp_path / "robot.toml").write_text(icreckon.robot_toml(robot), encoding="utf-8")
    assert load_robot(tmp_path / "robot.toml").log == robot.log


@pytest.mark.parametrize("name", robot_names())
def test_its_file_is_the_same_robot(name: str, tmp_path):
    robot = load_robot(name)
    path = tmp_path / "robot.toml"
    path.write_text(icreckon.robot_toml(robot), encoding="utf-8")
    again = load_robot(path)
    # Numbers keep seven digits, and those of [log] all.
    assert icreckon.robot_toml(again) == icreckon.robot_toml(robot)
    assert again.vehicle.mass == pytest.approx(robot.vehicle.mass)
    assert again.log == robot.log
    assert again.slip.keys() == robot.slip.keys()


@pytest.mark.parametrize(("mass", "gauge"), [(30_000.0, 0.5), (30.0, 0.05)])
def test_a_mass_in_grams_or_a_gauge_in_other_units_is_refused(mass: float, gauge: float) -> None:
    vehicle = {"mass": mass, "track_gauge": gauge, "sprocket_radius": 0.1}
    with pytest.raises(EstimatorError, match=r"does not fit track_gauge = .* in grams"):
        make_robot("heavy", vehicle=vehicle)
